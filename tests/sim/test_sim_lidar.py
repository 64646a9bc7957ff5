"""The lidar: exact distances, each beam at its own instant, noise, and REP-117 values."""

from contextlib import closing

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist
from turtlebag.sim import bullet
from turtlebag.sim.lidar import Lidar, LidarConfig
from turtlebag.sim.physics import Physics, PhysicsConfig
from turtlebag.sim.raycast import beam_rays, cast, distance_to_outlines, distance_to_point
from turtlebag.sim.robots import load_robot
from turtlebag.sim.shapes import box, contains, cylinder, prism, sections
from turtlebag.sim.simulator import SimConfig, Simulator
from turtlebag.sim.worlds import load_world

WORLD, BURGER = load_world("turtlebot3_world"), load_robot("burger")
QUIET = LidarConfig(noise="none")


def lidar(config=QUIET, solids=WORLD.shapes, seed=0):
    return Lidar(solids, BURGER, config, np.random.default_rng(seed))


def test_ranges_at_the_spawn_are_the_analytic_ones():
    ranges, _ = lidar().true_ranges(np.array([[-2.0, 0.0, 0.0]]))
    x = -2.0 - 0.032
    # Ahead: pillar one_two at (-1.1, 0), radius 0.15.
    assert ranges[0] == pytest.approx(-1.1 - 0.15 - x, abs=1e-9)
    # To the left, 90 degrees: the foot's lower face y = 2.0015 is not above x = -2.032, the slanted wall is.
    slope = (2.54 - 0.0) / (-1.4665 + 2.9329)
    assert ranges[90] == pytest.approx(slope * (x + 2.9329), abs=1e-3)
    assert ranges[180] == pytest.approx(x + 2.9329, abs=1e-9)


@pytest.fixture(scope="module")
def arena():
    with closing(Physics(WORLD.shapes, [], BURGER, PhysicsConfig())) as physics:
        physics.reset(WORLD.spawn)
        yield physics


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@example(x=1.8984375, y=1.84375, yaw=0.0)
@example(x=1.8984375, y=1.75, yaw=0.0)
@given(x=st.floats(-2.0, 2.0), y=st.floats(-1.9, 1.9), yaw=st.floats(-3.2, 3.2))
def test_the_ray_caster_agrees_with_bullets_rays(arena, x, y, yaw):
    pose = np.array([[x, y, yaw]])
    sensor = lidar()
    ranges, _ = sensor.true_ranges(pose)
    when = np.zeros(len(ranges))
    origins, directions, _ = beam_rays(pose, when, BURGER.T_base_lidar.xyt, sensor.spec.angles)
    outlines = sections(WORLD.crossing(BURGER.lidar_height), BURGER.lidar_height)
    near = distance_to_point(*origins[0], outlines.segments, outlines.circles)
    # From inside a solid, or its 1 mm of padding, Bullet reports nothing sensible; the housing's own
    # radius keeps a lidar 5.5 cm from everything.
    assume(near > 0.055 and not contains(WORLD.shapes, 0.182, origins[:1])[0])
    z = np.full((len(origins), 1), BURGER.lidar_height)
    start = np.hstack([origins, z])
    end = np.hstack([origins + 3.5 * directions, z])
    # The robot itself stands in the world too, at the spawn.
    bullet.setCollisionFilterGroupMask(arena.body, -1, 0, 0, physicsClientId=arena.client)
    hits = bullet.rayTestBatch(start.tolist(), end.tolist(), physicsClientId=arena.client)
    reference = np.array([hit[2] * 3.5 if hit[0] >= 0 else np.inf for hit in hits])
    # A beam that grazes a padded hull may hit it and miss the exact outline.
    both = np.isfinite(ranges) & np.isfinite(reference)
    assert np.mean(both == np.isfinite(ranges)) > 0.97
    differences = np.abs(ranges[both] - reference[both])
    assert np.quantile(differences, 0.9, method="higher") < 0.006
    assert np.median(differences) < 0.0015


def reference_cast(origin, direction, segments, circles, limit):
    """Ray against outlines by solving 2 x 2 systems and quadratics with NumPy."""
    best = np.inf
    for x0, y0, x1, y1 in segments:
        matrix = np.array([[direction[0], x0 - x1], [direction[1], y0 - y1]])
        if abs(np.linalg.det(matrix)) < 1e-14:
            continue
        t, u = np.linalg.solve(matrix, np.array([x0, y0]) - origin)
        if t >= 0.0 and 0.0 <= u <= 1.0:
            best = min(best, t)
    for x, y, r in circles:
        offset = origin - np.array([x, y])
        roots = np.roots([1.0, 2.0 * direction @ offset, offset @ offset - r * r])
        real = roots[np.abs(roots.imag) < 1e-12].real
        best = min([best, *real[real >= 0.0]])
    return best if best <= limit else np.inf


def test_cast_matches_a_plain_reference():
    rng = np.random.default_rng(4)
    segments = rng.uniform(-3.0, 3.0, (12, 4))
    circles = np.hstack([rng.uniform(-3.0, 3.0, (6, 2)), rng.uniform(0.1, 0.6, (6, 1))])
    origins = rng.uniform(-3.0, 3.0, (200, 2))
    angles = rng.uniform(-np.pi, np.pi, 200)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    ranges, hits = cast(origins, directions, angles, (segments, circles), 2.5)
    expected = [
        reference_cast(o, d, segments, circles, 2.5) for o, d in zip(origins, directions, strict=True)
    ]
    np.testing.assert_allclose(ranges, expected, atol=1e-9)
    assert np.array_equal(hits >= 0, np.isfinite(ranges))


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    turn=st.floats(-1.5, 1.5),
    step=st.floats(0.0, 0.4),
    first=st.floats(-3.2, 0.0),
    fan=st.floats(0.5, 6.28),
)
def test_a_sweep_sees_exactly_what_single_rays_see(seed, turn, step, first, fan):
    rng = np.random.default_rng(seed)
    segments = rng.uniform(-3.0, 3.0, (25, 4))
    circles = np.hstack([rng.uniform(-3.0, 3.0, (15, 2)), rng.uniform(0.05, 0.8, (15, 1))])
    poses = np.stack(
        [np.linspace(0.0, step, 4), np.zeros(4), rng.uniform(-3, 3) + np.linspace(0.0, turn, 4)], -1
    )
    poses[:, 2] = (poses[:, 2] + np.pi) % (2 * np.pi) - np.pi
    angles = first + np.linspace(0.0, fan, 180)
    rays = beam_rays(poses, np.linspace(0.0, 3.0, 180), np.array([-0.03, 0.0, 0.0]), angles)
    origins, directions, bearings = rays
    assume(np.all(np.diff(bearings) > 0.0))
    for order in (np.arange(180), rng.permutation(180)):
        rays = origins[order], directions[order], bearings[order]
        got = cast(*rays, (segments, circles), 2.5)
        alone = [cast(*(part[k : k + 1] for part in rays), (segments, circles), 2.5) for k in range(180)]
        np.testing.assert_array_equal(got[0], np.concatenate([ranges for ranges, _ in alone]))
        np.testing.assert_array_equal(got[1], np.concatenate([hits for _, hits in alone]))


def along(polygon, n):
    """Points along the edges of a polygon, n an edge."""
    fractions = np.linspace(0.0, 1.0, n)[:, None]
    return np.vstack([a + fractions * (b - a) for a, b in zip(polygon, np.roll(polygon, -1, 0), strict=True)])


def circle(solid):
    angles = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    return np.array(solid.center) + solid.radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)


@pytest.mark.slow
def test_footprint_distance_matches_dense_sampling():
    rng = np.random.default_rng(2)
    solids = [
        box("b", (1.0, 0.3), (0.5, 0.8), 0.4, (0.0, 1.0)),
        cylinder("c", (-0.6, 0.9), 0.3, (0.0, 1.0)),
        prism("p", np.array([[-1.0, -1.0], [0.2, -1.2], [-0.3, -0.6]]), (0.0, 1.0)),
    ]
    outlines = sections(solids, 0.1)
    footprint = BURGER.model.footprint
    edge = along(footprint, 100)
    surface = np.vstack([along(circle(s) if s.is_cylinder else s.polygon, 100) for s in solids])
    for _ in range(30):
        pose = SE2.from_xyt(*rng.uniform(-1.5, 1.5, 2), rng.uniform(-3, 3))
        got = distance_to_outlines(pose @ footprint, outlines.segments, outlines.circles)
        sampled = np.linalg.norm((pose @ edge)[:, None] - surface[None], axis=-1).min()
        if got == 0.0:
            assert sampled < 0.12 or contains(solids, 0.1, pose.xy[None])[0]
        else:
            assert got == pytest.approx(sampled, abs=1e-2)


def test_a_turning_lidar_takes_each_beam_at_its_own_instant():
    sensor = lidar()
    # Turning by 0.2 rad during the sweep, on the spot.
    poses = np.stack([np.full(7, -2.0), np.zeros(7), np.linspace(0.0, 0.2, 7)], axis=-1)
    moving, _ = sensor.true_ranges(poses)
    for beam in (0, 45, 180, 359):
        yaw = 0.2 * beam / 360.0
        still, _ = sensor.true_ranges(np.array([[-2.0, 0.0, yaw]]))
        assert moving[beam] == pytest.approx(still[beam], abs=1e-9)
    assert sensor.spec.time_increment == pytest.approx(0.2 / 360.0)
    assert sensor.spec.scan_time == pytest.approx(0.2)


def test_scans_come_at_five_hertz_with_the_stamp_of_the_first_beam():
    for turning in (True, False):
        config = SimConfig(lidar={"turning": turning, "noise": "none"})
        with Simulator(WORLD, BURGER, config, 0) as simulator:
            observations = [simulator.reset()] + [simulator.step(Twist(0.1, 1.0)) for _ in range(24)]
        scans = [(o.stamp_ns, o.scan.stamp_ns) for o in observations if o.scan is not None]
        lag = 200_000_000 if turning else 0
        assert scans == [(k * 200_000_000, k * 200_000_000 - lag) for k in range(1 if turning else 0, 5)]


def test_scan_truth_is_the_pose_at_the_first_beam():
    with Simulator(WORLD, BURGER, SimConfig(lidar={"noise": "none"}), 0) as simulator:
        simulator.reset()
        truths = {0: simulator.truth.T_world_base.xyt}
        for _ in range(18):
            observation = simulator.step(Twist(0.1, 1.0))
            truths[observation.stamp_ns] = simulator.truth.T_world_base.xyt
            if observation.scan is not None:
                np.testing.assert_array_equal(simulator.scan_truth.xyt, truths[observation.scan.stamp_ns])


def test_noise_has_the_stated_deviation_and_keeps_to_the_limits():
    sensor = lidar(LidarConfig(), seed=3)
    pose = np.array([[-2.0, -0.5, 0.3]])
    true, _ = sensor.true_ranges(pose)
    scans = np.stack([sensor.measure(pose) for _ in range(400)]).astype(np.float64)
    ok = np.isfinite(true) & (true < 3.4)
    errors = scans[:, ok] - true[ok]
    assert errors.std() == pytest.approx(0.01, rel=0.03)
    assert abs(errors.mean()) < 2e-4
    assert np.all(np.isposinf(scans[:, ~np.isfinite(true)]))
    finite = np.isfinite(scans)
    assert scans[finite].min() >= 0.12
    assert scans[finite].max() <= 3.5


def test_datasheet_noise_is_a_third_of_the_stated_tolerance():
    near, far = (cylinder("ring", (-0.032, 0.0), radius, (0.0, 1.0)) for radius in (0.4, 2.0))
    for solid, sigma in ((near, 0.015 / 3.0), (far, 0.05 * 2.0 / 3.0)):
        scans = [
            lidar(LidarConfig(noise="datasheet"), [solid], k).measure(np.zeros((1, 3))) for k in range(30)
        ]
        errors = np.stack(scans).astype(np.float64) - solid.radius
        assert errors.std() == pytest.approx(sigma, rel=0.05)


def test_too_near_is_minus_infinity_and_nothing_in_reach_plus_infinity():
    near = lidar(solids=[box("wall", (0.1, 0.0), (0.04, 2.0), 0.0, (0.0, 1.0))])
    ranges = near.measure(np.array([[0.032, 0.0, 0.0]]))
    assert np.isneginf(ranges[0])
    assert np.isposinf(ranges[180])


def test_only_solids_that_cross_the_lidar_plane_are_seen():
    slab = box("slab", (1.0, 0.0), (0.2, 2.0), 0.0, (0.0, 0.04))
    header = box("header", (1.0, 0.0), (0.2, 2.0), 0.0, (0.5, 2.0))
    assert np.all(np.isposinf(lidar(solids=[slab, header]).measure(np.zeros((1, 3)))))


def test_dropout_and_dark_surfaces_lose_the_stated_share_of_beams():
    ring = [cylinder("ring", (0.0, 0.0), 2.0, (0.0, 1.0), reflectivity=0.3)]
    dark = np.stack([lidar(LidarConfig(), ring, k).measure(np.zeros((1, 3))) for k in range(20)])
    assert np.isfinite(dark).mean() == pytest.approx(0.3, abs=0.03)
    bright = [cylinder("ring", (0.0, 0.0), 2.0, (0.0, 1.0))]
    lossy = np.stack(
        [lidar(LidarConfig(dropout=0.2), bright, k).measure(np.zeros((1, 3))) for k in range(20)]
    )
    assert np.isposinf(lossy).mean() == pytest.approx(0.2, abs=0.03)
