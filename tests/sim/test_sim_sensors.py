"""The simulator's sensors: `realistic` by known answers, `clean` to the last bit, and how one is chosen."""

import dataclasses
import math
from functools import cache

import numpy as np
import pytest
from pydantic import ValidationError

from turtlebag.datasets.seeds import stream
from turtlebag.datasets.types import Twist
from turtlebag.sim.lidar import Lidar, LidarConfig
from turtlebag.sim.robots import LidarErrors, load_robot
from turtlebag.sim.shapes import box, cylinder
from turtlebag.sim.simulator import SimConfig, Simulator
from turtlebag.sim.wheels import OdometryConfig, Slip
from turtlebag.sim.worlds import load_world

WORLD, BURGER = load_world("turtlebot3_world"), load_robot("burger")
LDS = BURGER.lidar.errors
QUIET = {name: 0.0 for name in LidarErrors.model_fields} | {"stamp_delay": (0.0, 0.0)}
HERE = np.array([[0.032, 0.0, 0.0]])
"""The base pose that puts a burger's lidar into the origin."""
CURVE = Twist(0.1, 0.5)


def lidar(solids, seed=0, **errors):
    config = LidarConfig(noise="sensor", errors=LidarErrors(**(QUIET | errors)))
    return Lidar(solids, BURGER, config, np.random.default_rng(seed))


@cache
def ring(radius):
    """Walls all round the origin, nearly at the same distance everywhere."""
    angles = np.linspace(0.0, 2.0 * np.pi, 721)
    return [
        box(str(k), ((radius + 0.05) * math.cos(a), (radius + 0.05) * math.sin(a)), (0.1, 0.1), a, (0.0, 1.0))
        for k, a in enumerate(angles[:-1])
    ]


def turns(sensor, n):
    """Ranges of n turns on the spot, (n, n_beams)."""
    rows = []
    for _ in range(n):
        sensor.turn()
        rows.append(sensor.measure(HERE))
    return np.array(rows, dtype=np.float64)


def drive(config, steps, command=CURVE, seed=1, world=WORLD, robot=BURGER):
    """Observations, and the true base pose at each control step, (steps + 1, 3)."""
    with Simulator(world, robot, config, seed) as simulator:
        seen, true = [simulator.reset()], [simulator.truth.T_world_base.xyt]
        at_stamps = []
        for _ in range(steps):
            seen.append(simulator.step(command))
            true.append(simulator.truth.T_world_base.xyt)
            if seen[-1].scan is not None:
                at_stamps.append(simulator.scan_truth.xyt)
    return seen, np.array(true), np.array(at_stamps)


def scans_of(seen):
    return [o.scan for o in seen if o.scan is not None]


@pytest.mark.parametrize("distance", [0.5, 3.0])
def test_the_noise_of_a_beam_grows_with_the_square_of_its_range(distance):
    errors = turns(lidar(ring(distance), sigma=0.004, sigma_square=0.002), 60) - distance
    assert errors.std() == pytest.approx(math.hypot(0.004, 0.002 * distance**2), rel=0.03)
    assert abs(errors.mean()) < 0.001
    # Nothing of it is common to a turn or to a beam.
    assert errors.mean(axis=1).std() < 0.15 * errors.std() > errors.mean(axis=0).std() / 1.3


def test_a_turn_is_too_long_or_too_short_as_a_whole():
    errors = turns(lidar(ring(2.0), turn_scale=0.01), 300) - 2.0
    assert errors.mean(axis=1).std() == pytest.approx(0.02, rel=0.15)
    assert errors.std(axis=1).max() < 1e-4


@pytest.mark.slow
def test_a_unit_keeps_its_own_errors_and_each_seed_is_another_unit():
    units = [
        [turns(lidar(ring(r), seed, offset=0.01, scale=0.02, square=0.005), 3) - r for r in (0.5, 2.0)]
        for seed in range(60)
    ]
    near, far = (np.array([unit[k].mean() for unit in units]) for k in (0, 1))
    assert max(unit[k].std() for unit in units for k in (0, 1)) < 1e-4
    assert near.std() == pytest.approx(math.sqrt(0.01**2 + 0.01**2 + 0.00125**2), rel=0.25)
    assert far.std() == pytest.approx(math.sqrt(0.01**2 + 0.04**2 + 0.02**2), rel=0.25)


def test_beams_point_a_little_aside():
    # A wall seen at a slant: its range changes by r tan(slant) with the angle.
    wall = [box("wall", (1.05, 0.0), (0.1, 20.0), 0.0, (0.0, 1.0))]
    at_60 = turns(lidar(wall, angle_deg=0.2), 400)[:, 60]
    assert at_60.std() == pytest.approx(2.0 * math.tan(math.radians(60.0)) * math.radians(0.2), rel=0.15)


def test_readings_are_whole_steps_of_the_resolution():
    read = turns(lidar(ring(1.0), sigma=0.01, resolution=0.001), 2) * 1000.0
    assert np.abs(read - np.round(read)).max() < 1e-3


def test_beams_are_lost_anywhere_and_more_of_them_where_they_graze():
    wall = [box("wall", (0.55, 0.0), (0.1, 20.0), 0.0, (0.0, 1.0))]
    back = np.isfinite(turns(lidar(wall, lost=0.05, grazing=0.2), 400))
    for degrees in (0, 60, 75):
        expected = 0.95 * (1.0 - math.exp(-math.cos(math.radians(degrees)) / 0.2))
        assert back[:, degrees].mean() == pytest.approx(expected, abs=0.04)
    post = [cylinder("post", (1.0, 0.0), 0.5, (0.0, 1.0))]
    edge = np.isfinite(turns(lidar(post, grazing=0.2), 200)).mean(axis=0)
    assert edge[0] > 0.98 > 0.9 > edge[29] > 0.4  # 29 degrees: a degree from passing by


@pytest.mark.slow
def test_turns_take_the_time_of_the_unit_and_jitter_and_are_stamped_late():
    errors = QUIET | {"speed": 0.03, "jitter": 0.002, "stamp_delay": (0.004, 0.006)}
    seen, _, _ = drive(SimConfig(lidar={"errors": errors}), 900)
    stamps = np.array([scan.stamp_ns for scan in scans_of(seen)]) * 1e-9
    assert 0.004 <= stamps[0] <= 0.006
    times = np.diff(stamps)
    speeds = 0.2 / times.mean() - 1.0
    assert 0.001 < abs(speeds) <= 0.09
    stamped = 0.002 / math.sqrt(12.0)  # evenly spread over 2 ms, at both ends
    assert times.std() == pytest.approx(math.hypot(0.2 * 0.002, math.sqrt(2.0) * stamped), rel=0.25)
    # A scan is delivered in the step in which its last beam was taken.
    ends = [o.stamp_ns * 1e-9 - o.scan.stamp_ns * 1e-9 for o in seen if o.scan is not None]
    assert times.mean() - 0.008 < min(ends) <= max(ends) < times.mean() + 1.0 / 30.0


def test_each_beam_is_taken_at_its_instant_of_a_turn_that_begins_between_two_steps():
    errors = QUIET | {"speed": 0.02}
    seen, true, _ = drive(SimConfig(lidar={"errors": errors}), 60, Twist(0.15, 1.2), seed=4)
    scans = scans_of(seen)
    period = (scans[-1].stamp_ns - scans[0].stamp_ns) * 1e-9 / (len(scans) - 1)
    assert abs(period - 0.2) > 5e-4
    still = lidar(WORLD.shapes)
    steps = np.arange(len(true)) / 30.0
    yaws = np.unwrap(true[:, 2])
    for number in (3, 7):
        instants = (number + np.arange(360) / 360.0) * period
        poses = np.stack([np.interp(instants, steps, axis) for axis in (true[:, 0], true[:, 1], yaws)], -1)
        for beam in (0, 90, 200, 359):
            expected = still.true_ranges(poses[beam : beam + 1])[0][beam]
            if np.isfinite(expected):
                assert scans[number].ranges[beam] == pytest.approx(expected, abs=1e-4)


def test_the_truth_of_a_scan_is_where_the_robot_was_at_its_stamp():
    seen, true, at_stamps = drive(SimConfig(), 90, Twist(0.2, 1.0))
    stamps = np.array([scan.stamp_ns for scan in scans_of(seen)]) * 1e-9
    steps = np.arange(len(true)) / 30.0
    yaws = np.interp(stamps, steps, np.unwrap(true[:, 2]))
    expected = np.stack([np.interp(stamps, steps, true[:, 0]), np.interp(stamps, steps, true[:, 1])], -1)
    assert np.abs(at_stamps[:, :2] - expected).max() < 1e-9
    assert np.abs(np.angle(np.exp(1j * (at_stamps[:, 2] - yaws)))).max() < 1e-9
    assert len(set(stamps * 30.0 % 1.0)) > 5


def test_a_wheel_slips_by_the_stated_deviation_after_a_metre_and_a_turn():
    config = OdometryConfig(slip=0.004, turn_slip=0.02)
    radius, track = BURGER.wheels.radius, 2.0 * BURGER.wheels.joint_y
    straight, spun = [], []
    for seed in range(300):
        slip = Slip(BURGER, config, np.random.default_rng(seed))
        for k in range(31):
            a = slip.encoders(k / 30.0 / radius, k / 30.0 / radius)
        straight.append((np.array(a) * radius - 1.0).tolist())
        slip = Slip(BURGER, OdometryConfig(slip=0.0, turn_slip=0.02), np.random.default_rng(seed))
        for k in range(31):
            half = 0.5 * track * k / 30.0
            b = slip.encoders(-half / radius, half / radius)
        spun.append((b[1] - b[0]) * radius / track - 1.0)
    assert np.std(straight) == pytest.approx(0.004, rel=0.1)
    assert np.std(spun) == pytest.approx(0.02, rel=0.1)


def test_clean_sensors_are_white_noise_of_a_centimetre_and_nothing_else():
    seen, true, at_stamps = drive(SimConfig(sensors="clean"), 6, Twist())
    (scan,) = scans_of(seen)
    assert scan.stamp_ns == 0
    assert at_stamps[0].tolist() == true[0].tolist()
    exact, _ = lidar(WORLD.shapes).true_ranges(true)
    noisy = exact + 0.01 * stream(1, "lidar").standard_normal(360)
    ok = np.isfinite(exact) & (exact > 0.2) & (exact < 3.4)
    assert np.array_equal(scan.ranges[ok], noisy[ok].astype(np.float32))
    assert np.array_equal(np.isfinite(scan.ranges), np.isfinite(exact))


def test_the_sensors_change_nothing_but_what_they_say():
    clean, true_a, _ = drive(SimConfig(sensors="clean"), 60)
    real, true_b, _ = drive(SimConfig(), 60)
    assert np.array_equal(true_a, true_b)
    assert all(
        np.array_equal(a.angular_velocity, b.angular_velocity)
        for x, y in zip(clean, real, strict=True)
        for a, b in zip(x.imu, y.imu, strict=True)
    )
    a, b = clean[-1], real[-1]
    assert a.odometry.T_odom_base.xyt.tolist() != b.odometry.T_odom_base.xyt.tolist()
    # What the encoders say and what odometry says are one thing.
    assert a.joints.position != b.joints.position
    again, _, _ = drive(SimConfig(), 60)
    assert np.array_equal(again[-1].odometry.T_odom_base.xyt, b.odometry.T_odom_base.xyt)
    assert all(
        x.stamp_ns == y.stamp_ns and np.array_equal(x.ranges, y.ranges)
        for x, y in zip(scans_of(again), scans_of(real), strict=True)
    )


def test_the_scan_states_the_geometry_of_the_data_sheet_whatever_its_motor_does():
    seen, _, _ = drive(SimConfig(), 30)
    for scan in scans_of(seen):
        spec = dataclasses.asdict(scan.lidar)
        assert spec["angle_increment"] == pytest.approx(math.pi / 180.0)
        assert spec["time_increment"] == pytest.approx(1.0 / 1800.0)
        assert (spec["n_beams"], spec["angle_min"], spec["scan_time"]) == (360, 0.0, pytest.approx(0.2))


def test_realistic_is_the_default_and_single_settings_take_precedence():
    config = SimConfig().resolved(BURGER)
    assert (config.lidar.noise, config.lidar.errors) == ("sensor", LDS)
    assert config.odometry.slip > 0.0 < config.odometry.turn_slip
    config = SimConfig(lidar={"errors": {"lost": 0.5}}, odometry={"slip": 0.02}).resolved(BURGER)
    assert config.lidar.errors == LDS.model_copy(update={"lost": 0.5})
    assert config.odometry.slip == 0.02
    louder = SimConfig(lidar={"sigma": 0.05}).resolved(BURGER)
    assert louder.lidar.errors == LDS.model_copy(update={"sigma": 0.05})
    clean = SimConfig(sensors="clean").resolved(BURGER)
    assert (clean.lidar.noise, clean.lidar.errors) == ("gazebo", None)
    assert clean.odometry.slip == clean.odometry.turn_slip == 0.0
    mixed = SimConfig(sensors="clean", lidar={"noise": "sensor"}, odometry={"turn_slip": 0.1})
    resolved = mixed.resolved(BURGER)
    assert (resolved.lidar.errors, resolved.odometry.turn_slip) == (LDS, 0.1)


@pytest.mark.parametrize("sensors", ["realistic", "clean"])
def test_the_resolved_settings_resolve_to_themselves(sensors):
    config = SimConfig(sensors=sensors, lidar={"turning": True}).resolved(BURGER)
    saved = SimConfig.model_validate(config.model_dump(mode="json"))
    assert saved == config == saved.resolved(BURGER)


def test_the_numbers_belong_to_the_lidar_that_the_robot_carries():
    assert all(load_robot(name).lidar.errors == LDS for name in ("waffle_pi", "waffle_pi_3d"))
    hokuyo = SimConfig().resolved(load_robot("jackal")).lidar.errors
    assert (hokuyo.sigma, hokuyo.sigma_square, hokuyo.scale) == (0.01, 0.0, 0.0)
    # A robot's file that says nothing: white noise of a centimetre.
    assert LidarErrors().model_dump() == QUIET | {"sigma": 0.01}


@pytest.mark.parametrize(
    "lidar",
    [
        {"noise": "gazebo", "errors": {"lost": 0.1}},
        {"errors": {"stamp_delay": [0.02, 0.01]}},
        {"errors": {"lost": 1.5}},
        {"errors": {"dropout": 0.1}},
    ],
)
def test_settings_that_cannot_be_are_refused(lidar):
    with pytest.raises(ValidationError):
        SimConfig(lidar=lidar)


def test_a_jackal_takes_thirty_scans_a_second_with_its_own_lidar():
    world = load_world("empty")
    robot = load_robot("jackal")
    seen, _, _ = drive(SimConfig(), 30, Twist(), world=world, robot=robot)
    assert [scan.stamp_ns for scan in scans_of(seen)] == [round(k * 1e9 / 30) for k in range(30)]
