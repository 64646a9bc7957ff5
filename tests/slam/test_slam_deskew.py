"""A scan of a wall taken while driving and turning comes out straight: as points, and in the grid."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.helpers.exact_rays import ranges_to, rectangle
from turtlebag.datasets.grid import OCCUPIED
from turtlebag.datasets.motion import sweep_motion
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import LidarSpec, Recording, Trajectory
from turtlebag.pipeline.slam.grid import OccupancyConfig, make_grid
from turtlebag.pipeline.slam.scans.clouds import make_clouds

ROOM = rectangle(0.025, 0.025, 5.025, 4.025)  # in the middle of cells
LIDAR = LidarSpec(120, 0.0, np.deg2rad(3.0), 0.1, 8.0, time_increment=0.2 / 120)
T_BASE_LIDAR = SE2.from_xyt(-0.06, 0.02, 0.5)
STARTS = SE2.from_xyt(np.array([2.0, 3.0, 2.5]), np.array([1.5, 2.0, 2.5]), np.array([0.3, -2.0, 2.9]))


def test_a_turn_among_sweeps_at_rest_is_no_jump_whichever_way_the_lidar_sweeps():
    seconds = np.arange(0.0, 40.0, 0.01)
    yaw = np.clip(seconds - 20.0, 0.0, 0.4)
    odometry = Trajectory(np.round(seconds * 1e9).astype(np.int64), SE2.from_xyt(0.0, 0.0, yaw))
    stamps = 10**9 + np.arange(190) * 200_000_000
    ranges = np.ones((190, 120), dtype=np.float32)
    for sign in (1.0, -1.0):
        lidar = replace(LIDAR, time_increment=sign * LIDAR.time_increment)
        log = Recording("x", stamps, ranges, lidar, T_BASE_LIDAR, odometry.at(stamps), odometry=odometry)
        whole = sweep_motion(log)[:, -1].yaw
        turning = np.flatnonzero(np.abs(whole) > 0.1)
        np.testing.assert_array_equal(turning, [95, 96])
        np.testing.assert_allclose(whole[turning], 0.2 * 119 / 120, atol=1e-6)


def test_a_lidar_of_one_beam_has_no_sweep_to_undo():
    lidar = LidarSpec(1, 0.0, 0.0, 0.1, 8.0, time_increment=0.1)
    odometry = Trajectory(np.array([0, 10**9]), SE2.identity(2))
    assert (
        sweep_motion(Recording("x", np.array([0]), np.ones((1, 1)), lidar, T_BASE_LIDAR, odometry=odometry))
        is None
    )


def driven(v, w, faster):
    """Three scans of a room at v [m/s], turning at w [rad/s] when they begin and faster during the sweep."""
    seconds = np.arange(0.0, 0.2 + 1e-9, 0.001)
    yaw = w * seconds + 0.5 * faster * seconds**2
    ways = 0.001 * v * np.column_stack([np.cos(yaw), np.sin(yaw)])
    xy = np.vstack([np.zeros(2), np.cumsum(0.5 * (ways[1:] + ways[:-1]), axis=0)])
    path = Trajectory(np.round(seconds * 1e9).astype(np.int64), SE2.from_xyt(xy[:, 0], xy[:, 1], yaw))
    sent = path.at(np.round(np.arange(120) * LIDAR.time_increment * 1e9).astype(np.int64)) @ T_BASE_LIDAR
    ranges = [ranges_to(ROOM, start @ sent, LIDAR.angles, LIDAR.range_max) for start in STARTS]
    stamps = np.arange(3) * 10**9
    odometry = Trajectory(
        np.concatenate([path.stamps_ns + stamp for stamp in stamps]),
        SE2(np.concatenate([(start @ path.poses).xyt for start in STARTS])),
    )
    return Recording(
        "x", stamps, np.array(ranges, dtype=np.float32), LIDAR, T_BASE_LIDAR, STARTS, odometry=odometry
    )


def off_the_walls(points):
    """Largest distance of points (n, 2) from the room's walls [m]."""
    sides = np.abs(points[:, [0, 0, 1, 1]] - ROOM[[0, 0, 0, 1], [0, 2, 1, 3]]).min(axis=1)
    return float(sides.max())


@settings(max_examples=25)
@given(st.floats(-0.3, 1.0), st.floats(-3.0, 3.0), st.floats(-8.0, 8.0))
def test_a_scan_taken_while_driving_and_turning_shows_straight_walls(v, w, faster):
    log = driven(v, w, faster)
    clouds = make_clouds(log, 30.0)
    assert (
        off_the_walls(np.vstack([STARTS[k] @ clouds.of(k) for k in range(3)])) < 3e-3
    )  # knots are 25 ms apart
    grid = make_grid(log, STARTS, OccupancyConfig(min_hits=1, behind_share=0.0, before_share=0.0), 30.0)
    walls = grid.center_of(np.argwhere(grid.cells == OCCUPIED))
    assert len(walls) > 100
    assert off_the_walls(walls) < 1e-6  # one cell thick


def test_as_if_taken_all_at_once_the_walls_are_bent():
    log = driven(0.3, 2.0, 0.0)
    bent = replace(log, lidar=replace(LIDAR, time_increment=0.0))
    clouds = make_clouds(bent, 30.0)
    assert off_the_walls(np.vstack([STARTS[k] @ clouds.of(k) for k in range(3)])) > 0.3
