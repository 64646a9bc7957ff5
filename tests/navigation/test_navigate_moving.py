"""Moving obstacles are distinguished from static ones; the robot stops for them, and finds a way out."""

import numpy as np

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.navigation.obstacle_memory import ObstacleMemory, in_company
from turtlebag.pipeline.navigation.sensing import DeskewedScan
from turtlebag.planners.tasks.recovery import Ladder, RecoveryConfig, Rung
from turtlebag.planners.tasks.sector_rule import Sectors
from turtlebag.sim.robots import load_robot

BURGER = load_robot("burger").model
ANGLES = np.radians(np.arange(0.5, 360.0))
DIRECTIONS = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)
TICK_NS = 200_000_000
OPEN = Sectors(1.5, 2.0, 1.5)


def sweep(k, T_odom_lidar, disc_xy, noise=None):
    """Sweep k from a lidar pose in a room of 3 m about the origin, with a disc of 0.2 m in it."""
    origin, ways = T_odom_lidar.xy, SE2.from_xyt(0, 0, float(T_odom_lidar.yaw)) @ DIRECTIONS
    with np.errstate(divide="ignore"):
        walls = np.min(
            np.where(ways > 0, (1.5 - origin) / ways, np.where(ways < 0, (-1.5 - origin) / ways, np.inf)), 1
        )
    to_disc = np.asarray(disc_xy) - origin
    along = ways @ to_disc
    off2 = to_disc @ to_disc - along**2
    disc = np.where((off2 < 0.04) & (along > 0), along - np.sqrt(np.maximum(0.04 - off2, 0)), np.inf)
    ranges = np.minimum(walls, disc) + (0.0 if noise is None else noise.normal(0.0, 0.01, 360))
    return DeskewedScan(k * TICK_NS, T_odom_lidar, origin + ways * ranges[:, None], np.zeros((0, 2)), OPEN)


def watched(poses, discs):
    memory, noise = ObstacleMemory(BURGER), np.random.default_rng(1)
    counts = []
    for k, (pose, disc) in enumerate(zip(poses, discs, strict=True)):
        memory.observe(sweep(k, pose, disc, noise))
        counts.append(len(memory.moving_odom))
    return memory, counts


def test_a_disc_that_walks_is_seen_to_move_and_nothing_else_is():
    here = SE2.from_xyt(-0.5, -0.3, 0.4)
    memory, counts = watched([here] * 10, [(1.0 - 0.06 * k, 0.3) for k in range(10)])
    assert min(counts[3:]) >= 5
    centre = np.array([1.0 - 0.06 * 9, 0.3])
    assert np.all(np.linalg.norm(memory.moving_odom - centre, axis=1) < 0.25)


def test_what_stands_does_not_move_when_the_robot_does():
    poses = [SE2.from_xyt(-0.8 + 0.05 * k, -0.3, 0.2 * k) for k in range(20)]
    _, counts = watched(poses, [(0.4, 0.3)] * 20)
    assert max(counts) == 0


def test_a_point_alone_is_noise():
    points = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1], [0.1, 0.1], [2.0, 2.0]])
    assert in_company(points, 3, 0.2).tolist() == [True] * 4 + [False]
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    assert np.array_equal(in_company(points, 2, 0.11), (distance <= 0.11).sum(axis=1) > 2)


def test_the_robot_stands_still_for_what_moves_within_reach():
    memory, here = ObstacleMemory(BURGER), SE2.from_xyt(1.0, 2.0, 0.5)

    def stops(points_base):
        memory.moving_odom = here @ np.array(points_base)
        return memory.stops(here)

    assert not memory.stops(here)
    assert stops([[0.3, 0.0]])
    assert stops([[-0.3, -0.2]])
    assert not stops([[0.5, 0.0], [0.0, 0.5]])


def test_recovery_moves_where_it_can():
    rungs = (
        Rung(kind="back_up", amount=0.2),
        Rung(kind="rotate", amount=1.0),
        Rung(kind="rotate", amount=1.0),
    )
    pose = SE2.identity()

    def moves(room):
        ladder = Ladder(RecoveryConfig(ladder=rungs), lambda: None)
        return [ladder.climb(0, pose, room).command(0, pose) for _ in rungs]

    free = moves(lambda twist, amount: 1.0)
    assert [np.sign(t.v) for t in free] == [-1.0, 0.0, 0.0]
    assert free[1].w == -free[2].w
    ahead = moves(lambda twist, amount: 0.1 * amount if twist.v > 0.0 or twist.w > 0.0 else 0.0)
    assert ahead[0].v > 0.0
    assert ahead[1].w > 0.0
    assert ahead[2].w > 0.0
    assert moves(lambda twist, amount: -np.inf) == [Twist()] * 3
