"""Known answers of a moving robot: deskewing, blended corrections, odometry errors."""

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.exact_rays import ranges_to, rectangle
from tests.helpers.made_drives import Sensor, Wheels, make_log, sick
from tests.helpers.made_logs import office_plan, office_route
from tests.helpers.slam_rooms import LDS, ROOM, around_the_room, dead_reckoning, drifted, recording
from turtlebag.datasets.grid import OCCUPIED
from turtlebag.datasets.motion import sweep_motion
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import LidarSpec, Recording, Trajectory
from turtlebag.pipeline.localisation.deskewed_beams import prepare
from turtlebag.pipeline.slam.graph.pose_graph import carried_poses
from turtlebag.pipeline.slam.grid import OccupancyConfig, make_grid
from turtlebag.pipeline.slam.odometry.calibration import calibrate
from turtlebag.pipeline.slam.odometry.line_icp import Lines
from turtlebag.pipeline.slam.odometry.track import OdometryNoise, TrackingConfig
from turtlebag.pipeline.slam.odometry.tracker import track_log
from turtlebag.pipeline.slam.scans.align import Prior, align
from turtlebag.pipeline.slam.scans.clouds import make_clouds
from turtlebag.pipeline.slam.scans.correspondences import Limits
from turtlebag.pipeline.slam.scans.scans import Scans
from turtlebag.pipeline.stages.localise import sweep_ends

SWEEP_S = 0.2
TURNING = LidarSpec(360, 0.0, np.pi / 180.0, 0.12, 8.0, SWEEP_S / 360, SWEEP_S)
BACKWARDS = replace(TURNING, time_increment=-SWEEP_S / 360)
SWEEPS = {
    "forwards": TURNING,
    "backwards": BACKWARDS,
    "upside down": TURNING.turned_over(),
    "upside down and backwards": BACKWARDS.turned_over(),
}
FOUR_WALLS = rectangle(0.0, 0.0, 8.0, 6.0)
T_BASE_LIDAR = SE2.from_xyt(0.1, 0.05, 0.4)


def swept(lidar: LidarSpec) -> tuple[Recording, SE2]:
    """Exact scans from an arc at 0.8 m/s and 1 rad/s, each beam from where the base was then; base poses."""
    stamps = (10**10 + 500_000_000 * np.arange(4)).astype(np.int64)

    def base(seconds: np.ndarray) -> SE2:
        turn = 1.0 * (seconds - 10.0)
        return SE2.from_xyt(2.0 + 0.8 * np.sin(turn), 2.0 + 0.8 * (1.0 - np.cos(turn)), turn)

    ranges = np.empty((len(stamps), lidar.n_beams), dtype=np.float32)
    for row, stamp in zip(ranges, stamps, strict=True):
        poses = base(stamp * 1e-9 + lidar.order * abs(lidar.time_increment)) @ T_BASE_LIDAR
        row[:] = ranges_to(FOUR_WALLS, poses, lidar.angles, lidar.range_max)
    times = (10**10 + 10_000_000 * np.arange(-40, 240)).astype(np.int64)
    odometry = Trajectory(times, base(times * 1e-9))
    T_odom_base = base(stamps * 1e-9)
    return Recording("arc", stamps, ranges, lidar, T_BASE_LIDAR, T_odom_base, odometry), T_odom_base


def off_the_walls(points: np.ndarray) -> np.ndarray:
    """Distance of points (n, 2) from the four walls [m]."""
    x, y = points.T
    return np.abs(np.stack([x, x - 8.0, y, y - 6.0])).min(axis=0)


@pytest.mark.slow
@pytest.mark.parametrize("lidar", SWEEPS.values(), ids=SWEEPS.keys())
def test_a_sweep_in_motion_puts_every_point_on_its_wall(lidar):
    log, T = swept(lidar)
    clouds = make_clouds(log, 30.0)
    placed = [T[k] @ clouds.of(k) for k in range(len(log))]
    assert max(off_the_walls(points).max() for points in placed) < 0.01
    still = make_clouds(replace(log, lidar=replace(lidar, time_increment=0.0)), 30.0)
    assert off_the_walls(T[0] @ still.of(0)).max() > 0.2


@pytest.mark.slow
@pytest.mark.parametrize("lidar", SWEEPS.values(), ids=SWEEPS.keys())
def test_a_sweep_in_motion_draws_straight_walls_into_the_grid(lidar):
    log, T = swept(lidar)
    config = OccupancyConfig(min_hits=1, behind_share=0.0, before_share=0.0)
    grid = make_grid(log, T, config, 30.0)
    walls = grid.center_of(np.argwhere(grid.cells == OCCUPIED))
    assert len(walls) > 100
    assert off_the_walls(walls).max() < 0.06


@pytest.mark.slow
@pytest.mark.parametrize("lidar", SWEEPS.values(), ids=SWEEPS.keys())
def test_localisation_sees_a_sweep_in_motion_as_it_was(lidar):
    log, T = swept(lidar)
    ends = sweep_ends(log)
    assert ends is not None
    for k in range(len(log)):
        beams = prepare(log.scan(k), T_BASE_LIDAR, T[k].inverse() @ ends[k])
        assert off_the_walls(T[k] @ beams.points).max() < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("lidar", SWEEPS.values(), ids=SWEEPS.keys())
def test_a_turning_robot_maps_as_well_whichever_way_its_lidar_turns(lidar):
    sensor = Sensor(lidar, SWEEP_S, T_base_lidar=(0.1, 0.05, 0.4))
    route = np.array([(16.0, 7.0), (27.0, 7.0), (27.0, 12.0), (27.0, 7.0), (24.0, 7.0)])
    log = make_log("turns", office_plan(1), route, sensor, wheels=Wheels(0.0, 0.0, 0.0, 0.0, 0.0))
    track = track_log(Scans.of(log.recording, 8.0), TrackingConfig(), Lines)
    assert np.linalg.norm(track.T_track_base.xy - log.truth.poses.xy, axis=1).max() < 0.03


def test_a_correction_is_shared_out_between_the_key_scans_before_and_after():
    poses = np.column_stack([0.1 * np.arange(9), np.zeros((9, 2))])
    log = recording(ROOM, poses + np.array([1.0, 1.0, 0.0]), odometry=poses)
    track = replace(dead_reckoning(log), keys=np.array([0, 4, 8]))
    T_map_keys = SE2.from_array(poses[[0, 4, 8]] + [[0.0, 0.0, 0.0], [0.0, 0.4, 0.0], [0.0, 0.4, 0.0]])
    gap = np.array([[1, 2]])
    carried = carried_poses(track.T_track_base, track.keys, T_map_keys)
    np.testing.assert_allclose(carried.y, [0.0, 0.1, 0.2, 0.3, 0.4, 0.4, 0.4, 0.4, 0.4], atol=1e-9)
    # nothing is known of the motion from scan 1 to scan 2: the correction happens there
    carried = carried_poses(track.T_track_base, track.keys, T_map_keys, gap)
    np.testing.assert_allclose(carried.y, [0.0, 0.0, 0.4, 0.4, 0.4, 0.4, 0.4, 0.4, 0.4], atol=1e-9)
    np.testing.assert_allclose(carried.x, poses[:, 0], atol=1e-9)


def test_a_prior_that_the_scan_contradicts_gives_way():
    truth = np.array([1.5, 1.2, 0.3])
    poses = np.array([[1.2, 1.0, 0.0], [1.8, 1.5, 1.0], truth])
    clouds = make_clouds(recording(ROOM, poses), 30.0)
    lying = truth + np.array([0.3, -0.2, 0.1])
    found = {
        cauchy: align(
            clouds, 2, truth, np.arange(2), poses[:2], Limits(0.3, 0.05, 20),
            Prior(lying, np.diag([1e7, 1e7, 1e7]), cauchy),
        ).T_map_base.xyt
        for cauchy in (0.0, 2.0)
    }  # fmt: skip
    assert np.abs(found[2.0] - truth).max() < 0.01
    assert np.abs(found[0.0] - truth).max() > 0.1


def test_odometry_s_noise_grows_with_the_way_and_with_the_turn():
    noise = OdometryNoise(floor=0.01, share=0.1)
    step = np.array([0.3, -0.4, -2.0])
    s_xy, s_yaw = 0.01 + 0.1 * 0.5, 0.01 + 0.1 * (0.5 + 2.0)
    np.testing.assert_allclose(noise.information(step), np.diag([s_xy**-2, s_xy**-2, s_yaw**-2]))


def test_what_the_scans_taught_about_the_wheels_carries_a_blind_robot():
    """Wheels 8 % too large by the odometry; after a lap the lidar sees nothing for 3 m."""
    lap = around_the_room(160)
    end = lap[-1]
    ahead = (SE2(end) @ SE2.from_xyt(0.1 * np.arange(1, 31), np.zeros(30), np.zeros(30))).xyt
    truth = np.vstack([lap, ahead])
    odometry = drifted(truth, scale=1.08, bias=0.0)
    log = recording(ROOM, truth, LDS, odometry=odometry)
    log.ranges[len(lap) :] = np.inf
    track = track_log(Scans.of(log, 30.0), TrackingConfig(), Lines)
    way = track.T_track_base[len(lap) - 1].inverse() @ track.T_track_base[-1]
    assert float(way.x) == pytest.approx(3.0, abs=0.06)
    told = SE2(odometry[len(lap) - 1]).inverse() @ SE2(odometry[-1])
    assert float(told.x) > 3.2
    assert track.odometry_steps is not None
    driven = np.linalg.norm(track.odometry_steps[:, :2], axis=1).sum()
    true = np.linalg.norm(np.diff(truth[track.keys][:, :2], axis=0), axis=1).sum()
    assert driven == pytest.approx(true, rel=0.02)


def test_what_is_left_of_odometry_s_errors_is_measured_in_standard_deviations():
    wheels = Wheels(noise_m=0.06, noise_rad=0.04)
    log = make_log("noise", office_plan(1), office_route(2), Sensor(sick(180, 30.0), 0.4), wheels=wheels)
    keys = np.arange(0, len(log.recording), 2)
    assert log.recording.T_odom_base is not None
    found = calibrate(
        make_clouds(log.recording, 30.0), keys, log.truth.poses[keys], log.recording.T_odom_base[keys]
    )
    # over a baseline of 1.5 m, and few pairs are pulled to 0.03 m and 0.015 rad by up to a third
    assert 0.8 * 0.06 * 1.5**0.5 < found.noise[0] < 1.15 * 0.06 * 1.5**0.5
    assert 0.75 * 0.04 * 1.5**0.5 < found.noise[2] < 1.15 * 0.04 * 1.5**0.5


def test_a_sweep_is_not_undone_by_odometry_that_jumps():
    """Odometry drives at 0.2 m/s and jumps by 2 m and a radian within sweep 7."""
    poses = np.stack([0.04 * np.arange(20), np.zeros(20), np.zeros(20)], axis=1)
    log = recording(ROOM, poses, LDS, odometry=poses)
    fine = np.arange(0, 4000, 20)
    stamps = log.stamps_ns[0] + fine * 10**6
    jump = np.where(fine[:, None] >= 1500, np.array([2.0, 0.0, 1.0]), 0.0)
    stream = SE2(np.stack([2e-4 * fine, 0.0 * fine, 0.0 * fine], axis=1) + jump)
    lidar = replace(LDS, time_increment=0.2 / (LDS.n_beams - 1))
    motion = sweep_motion(replace(log, lidar=lidar, odometry=Trajectory(stamps, stream)))
    np.testing.assert_allclose(motion.xyt[:7, -1], np.tile([0.04, 0.0, 0.0], (7, 1)), atol=1e-9)
    np.testing.assert_array_equal(motion.xyt[7], motion.xyt[6])
    assert np.hypot(*motion.xyt[8, -1, :2]) == pytest.approx(0.04)
