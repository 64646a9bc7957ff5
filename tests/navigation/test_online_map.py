"""Mapping while driving: scan by scan as the offline mapper; obstacles that the lidar cannot see are
noticed."""

import numpy as np
import pytest

from tests.helpers.planning_room import BURGER
from tests.helpers.slam_rooms import ROOM, around_the_room, drifted, recording
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Joints, Observation, Odometry, Scan, Twist
from turtlebag.pipeline.navigation.bump_reflex import BumpReflex
from turtlebag.pipeline.navigation.obstacle_memory import MEMORY_NS, ObstacleMemory
from turtlebag.pipeline.navigation.online_map import OnlineMap
from turtlebag.pipeline.navigation.sensing import DeskewedScan
from turtlebag.pipeline.slam.mapper import SlamConfig
from turtlebag.planners.costmap import Costmap
from turtlebag.planners.tasks.sector_rule import Sectors

TRUE = around_the_room(200, laps=2)
LOG = recording(ROOM, TRUE, odometry=drifted(TRUE))


def drive(online: OnlineMap, upto: int = len(LOG)) -> None:
    """Every scan of LOG with its odometry, as a simulator would hand them over."""
    for k in range(upto):
        stamp, T_odom_base = int(LOG.stamps_ns[k]), LOG.T_odom_base[k]
        joints = Joints(stamp, (0.0, 0.0), (0.0, 0.0))
        scan = Scan(stamp, LOG.ranges[k], LOG.lidar)
        online.observe(Observation(stamp, Odometry(stamp, T_odom_base, Twist()), joints, scan, ()))


@pytest.mark.slow
def test_the_estimate_stays_true_while_odometry_drifts_and_the_map_comes_bit_by_bit():
    online = OnlineMap(SE2.identity(), SlamConfig())
    errors, sizes = [], []
    for k in range(len(LOG)):
        stamp, T_odom_base = int(LOG.stamps_ns[k]), LOG.T_odom_base[k]
        scan = Scan(stamp, LOG.ranges[k], LOG.lidar)
        joints = Joints(stamp, (0.0, 0.0), (0.0, 0.0))
        online.observe(Observation(stamp, Odometry(stamp, T_odom_base, Twist()), joints, scan, ()))
        error = (SE2(TRUE[k]).inverse() @ (online.T_map_odom @ T_odom_base)).xyt
        errors.append(np.hypot(error[0], error[1]))
        if k % 60 == 59:
            sizes.append(int((online.update().cells == 0).sum()))
    drift = (SE2(TRUE[-1]).inverse() @ LOG.T_odom_base[len(LOG) - 1]).xyt
    assert np.hypot(drift[0], drift[1]) > 0.3
    assert max(errors) < 0.06
    assert sizes == pytest.approx([17700] * 3, rel=0.02)


@pytest.mark.slow
def test_the_finished_map_is_that_of_the_offline_mapper():
    from turtlebag.pipeline.slam.mapper import run_slam

    online = OnlineMap(SE2.identity(), SlamConfig())
    drive(online, 120)
    online.update()
    np.testing.assert_array_equal(
        online.finish().cells, run_slam(online.recording(), SlamConfig()).grid.cells
    )


def test_scans_taken_while_pushing_are_not_drawn():
    online = OnlineMap(SE2.identity(), SlamConfig())
    drive(online, 60)
    before = len(online.recording())
    online.distrust()
    assert 1 <= before - len(online.recording()) <= 4


def wall_ahead(T_world_base: SE2) -> np.ndarray:
    """Points (n, 2) in the base frame of a corner that stands at rest in the world."""
    y = np.arange(-2.0, 2.0, 0.05)
    corner = np.concatenate(
        [np.stack([np.full(len(y), 2.0), y], axis=1), np.stack([y, np.full(len(y), 1.5)], axis=1)]
    )
    return T_world_base.inverse() @ corner


@pytest.mark.parametrize("pushing", [True, False])
def test_wheels_that_turn_on_the_spot_are_noticed_and_the_place_is_kept_out_of(pushing):
    memory = ObstacleMemory(BURGER)
    reflex = BumpReflex(memory)
    noticed = []
    for k in range(12):
        T_odom_base = SE2.from_xyt(0.04 * k, 0.0, 0.0)
        T_true = SE2.identity() if pushing else T_odom_base
        hits = T_odom_base @ wall_ahead(T_true)
        sweep = DeskewedScan(k * 200_000_000, T_odom_base, hits, np.zeros((0, 2)), Sectors(2.0, 2.0, 2.0))
        noticed.append(reflex.triggered(sweep, T_odom_base, Twist(0.2, 0.0), 0.0, SE2.identity()))
    assert any(noticed) == pushing
    free = Costmap(np.zeros((80, 80), dtype=bool), 0.05, SE2.from_xyt(-2.0, -2.0, 0.0))
    now = 12 * 200_000_000
    kept_out = memory.kept_out(free, now).lethal
    if not pushing:
        assert not kept_out.any()
        return
    first = noticed.index(True)
    nose = np.array([0.04 * first + 0.041 + 0.05, 0.0])
    assert memory.kept_out(free, now).clearance_at(nose) < 0.06
    assert memory.kept_out(free, now + MEMORY_NS) is free
    start = SE2.from_xyt(0.04 * first, 0.0, 0.0)
    assert reflex.command(first * 200_000_000, start) == Twist(-0.1, 0.0)
    assert reflex.command(first * 200_000_000, start @ SE2.from_xyt(-0.26, 0.0, 0.0)) is None
    assert reflex.escape is None
