"""Narrow passages: every path that exists is found, and none that does not."""

import math

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from tests.helpers.planning_room import BURGER
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import RobotModel
from turtlebag.planners.control.collision_monitor import padded
from turtlebag.planners.costmap import Costmap
from turtlebag.planners.footprint import footprint_free
from turtlebag.planners.footprint_motions import Ground, free_from
from turtlebag.planners.global_plan import NoPath, fits, plan_path
from turtlebag.planners.grid_distance import grid_distance
from turtlebag.planners.lattice import HEADINGS, YAWS
from turtlebag.planners.lattice_search import WIDE, Floor, ends
from turtlebag.planners.ompl_planner import OmplConfig
from turtlebag.planners.planner import PlanConfig

RES = 0.05
WAFFLE = RobotModel(
    "waffle_pi",
    np.array([[-0.205, -0.155], [0.077, -0.155], [0.077, 0.155], [-0.205, 0.155]]),
    0.26,
    1.82,
    1.0,
    12.5,
)


def partitions(rng: np.random.Generator, gaps: tuple[int, int]) -> Costmap:
    """A 3 x 1.5 m hall cut by two thin walls, each with a gap of so many free cells."""
    lethal = np.zeros((30, 60), dtype=bool)
    lethal[[0, -1], :] = lethal[:, [0, -1]] = True
    for col in (rng.integers(17, 24), rng.integers(37, 44)):
        width = rng.integers(*gaps)
        first = rng.integers(1, 29 - width)
        lethal[:first, col] = lethal[first + width :, col] = True
    return Costmap(lethal, RES, SE2.identity())


def inside(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Which points (..., 2) lie in a convex polygon, by the sign of every edge's cross product."""
    edges = np.roll(corners, -1, axis=0) - corners
    off = points[..., None, :] - corners
    return np.all(edges[:, 0] * off[..., 1] - edges[:, 1] * off[..., 0] >= 0.0, axis=-1)


def plain_free(lethal: np.ndarray, corners: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Whether no lethal cell's centre lies in the polygon at poses (n, 3); off the grid all are lethal."""
    grown = np.pad(lethal, 12, constant_values=True)
    centres = (np.argwhere(grown)[:, ::-1] - 12 + 0.5) * RES
    size = np.array(lethal.shape[::-1]) * RES

    def free(pose: SE2) -> bool:
        outline = pose @ corners
        on_grid = np.all(outline >= 0.0) and np.all(outline < size)
        return bool(on_grid and not inside(corners, pose.inverse() @ centres).any())

    return np.array([free(SE2(pose)) for pose in poses])


def plain_joined(lethal: np.ndarray, corners: np.ndarray, a: tuple, b: tuple) -> bool:
    """Whether steps and turns join two states (row, column, heading), each swept over all cells at once."""
    rows, cols = lethal.shape
    n, size, pad = len(HEADINGS), lethal.size, 12
    grown = np.pad(lethal, pad, constant_values=True)
    offsets = (np.stack(np.meshgrid(*2 * [np.arange(-10, 11)]), axis=-1) * RES).reshape(-1, 2)

    def swept(poses: np.ndarray) -> np.ndarray:
        """Cells from whose centre the footprint goes through poses (n, 3) relative to it."""
        hit = np.zeros(len(offsets), dtype=bool)
        for pose in poses:
            hit |= inside(corners, SE2(pose).inverse() @ offsets)
        blocked = np.zeros_like(lethal)
        for dc, dr in np.round(offsets[hit] / RES).astype(int):
            blocked |= grown[pad + dr : pad + dr + rows, pad + dc : pad + dc + cols]
        return ~blocked

    heads, tails = [], []
    index = np.arange(size).reshape(rows, cols)
    for k, (dc, dr) in enumerate(HEADINGS):
        steps = max(1, math.ceil(math.hypot(dc, dr) * 2))
        along = np.arange(steps + 1) / steps
        drive = swept(np.stack([along * dc * RES, along * dr * RES, np.full(steps + 1, YAWS[k])], axis=1))
        r, c = np.nonzero(drive)
        heads.append(k * size + index[r, c])
        tails.append(k * size + index[r + dr, c + dc])
        angle = (YAWS[(k + 1) % n] - YAWS[k]) % (2.0 * math.pi)
        steps = max(1, math.ceil(angle / 0.1))
        yaws = YAWS[k] + angle * np.arange(steps + 1) / steps
        r, c = np.nonzero(swept(np.stack([0.0 * yaws, 0.0 * yaws, yaws], axis=1)))
        heads.append(k * size + index[r, c])
        tails.append((k + 1) % n * size + index[r, c])
    i, j = np.concatenate(heads), np.concatenate(tails)
    graph = sparse.coo_matrix((np.ones(len(i)), (i, j)), shape=(n * size, n * size))
    labels = connected_components(graph, directed=False)[1]
    return bool(labels[a[2] * size + index[a[0], a[1]]] == labels[b[2] * size + index[b[0], b[1]]])


def disc_joined(costmap: Costmap, radius: float, a: tuple, b: tuple) -> bool:
    free = costmap.clearance > radius
    return bool(free[a[:2]] and free[b[:2]] and np.isfinite(grid_distance(free, *b[:2], np.inf)[a[:2]]))


def pose_of(state: tuple) -> SE2:
    return SE2.from_xyt((state[1] + 0.5) * RES, (state[0] + 0.5) * RES, YAWS[state[2]])


def near(pose: SE2, costmap: Costmap, corners: np.ndarray, rng: np.random.Generator) -> SE2:
    """A free pose in the same cell, up to 5 degrees turned."""
    while True:
        moved = pose @ SE2.from_xyt(*rng.uniform(-0.024, 0.024, 2), rng.uniform(-0.09, 0.09))
        if plain_free(costmap.lethal, corners, moved.xyt[None])[0]:
            return moved


def test_a_polygon_is_free_when_no_lethal_centre_lies_in_it():
    rng = np.random.default_rng(4)
    lethal = rng.random((40, 40)) < 0.02
    costmap = Costmap(lethal, RES, SE2.identity())
    poses = np.column_stack([rng.uniform(-0.1, 2.1, (600, 2)), rng.uniform(-4.0, 4.0, 600)])
    found = [footprint_free(costmap.clearance, RES, WAFFLE.footprint, *pose) for pose in poses]
    expected = plain_free(lethal, WAFFLE.footprint, poses)
    assert 100 < expected.sum() < 500
    assert found == expected.tolist()


@pytest.mark.parametrize("yaw", [0.0, 0.4, math.pi / 2.0, 2.9])
def test_no_robot_fits_across_a_wall_one_cell_thick(yaw):
    """Samples of the outline straddled such a wall, and the goal in it was taken."""
    lethal = np.zeros((40, 40), dtype=bool)
    lethal[20, :] = True
    costmap = Costmap(lethal, RES, SE2.identity())
    for y in np.arange(0.96, 1.09, 0.0073):
        assert not fits(costmap, WAFFLE, SE2.from_xyt(1.0, y, yaw))


def test_what_the_cells_join_is_planned_though_the_planner_finds_nothing():
    """RRTConnect did not get through a maze with no room to spare, and that was called unreachable."""
    costmap = partitions(np.random.default_rng(1), (7, 8))
    ompl = OmplConfig(iterations=1)
    plan = plan_path(
        costmap, BURGER, SE2.from_xyt(0.4, 0.7, 0.0), SE2.from_xyt(2.6, 0.7, 0.0), PlanConfig(ompl=ompl), 1
    )
    assert plan.planner == "grid"
    assert free_from(Ground(costmap.clearance, RES, BURGER.footprint), plan.poses.xyt) == 0


@pytest.mark.slow
def test_room_that_is_asked_for_is_kept_in_a_narrow_gap_too():
    costmap = partitions(np.random.default_rng(2), (8, 9))
    start, goal = SE2.from_xyt(0.6, 0.75, 1.0), SE2.from_xyt(2.5, 0.75, -1.0)
    with pytest.raises(NoPath):
        plan_path(costmap, WAFFLE, start, goal, PlanConfig(margins=(0.2, 0.08)), seed=1)
    plan = plan_path(costmap, WAFFLE, start, goal, PlanConfig(margins=(0.2, 0.04)), seed=1)
    assert free_from(Ground(costmap.clearance, RES, padded(WAFFLE.footprint, 0.04)), plan.poses.xyt) == 0


def test_a_gap_that_the_disc_round_the_robot_does_not_pass_is_driven_straight():
    costmap = partitions(np.random.default_rng(2), (8, 9))
    start, goal = SE2.from_xyt(0.6, 0.75, 1.0), SE2.from_xyt(2.5, 0.75, -1.0)
    assert not disc_joined(costmap, WAFFLE.circumscribed_radius, (15, 12), (15, 50))
    config = PlanConfig(ompl=OmplConfig(iterations=1))
    plan = plan_path(costmap, WAFFLE, start, goal, config, seed=1)
    assert plan.planner == "footprint lattice"
    np.testing.assert_allclose(plan.poses.xyt[[0, -1]], [start.xyt, goal.xyt], atol=1e-9)
    grown = padded(WAFFLE.footprint, 0.5 * RES)
    assert free_from(Ground(costmap.clearance, RES, grown), plan.poses.xyt) == 0
    assert plan.length < 3.5


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(24))
def test_a_query_is_solved_when_and_only_when_start_and_goal_are_joined(seed):
    """Joined by a search of its own; start and goal lie anywhere in their cells."""
    rng = np.random.default_rng(seed)
    model, gaps = (WAFFLE, (5, 12)) if seed % 3 else (BURGER, (3, 7))
    costmap = partitions(rng, gaps)
    grown = padded(model.footprint, 0.5 * RES)
    ends = []
    for columns in ((6, 14), (47, 54)):
        while True:
            state = int(rng.integers(4, 26)), int(rng.integers(*columns)), int(rng.integers(32))
            if plain_free(costmap.lethal, grown, pose_of(state).xyt[None])[0]:
                ends.append(state)
                break
    joined = disc_joined(costmap, model.circumscribed_radius, *ends) or plain_joined(
        costmap.lethal, grown, *ends
    )
    start, goal = (near(pose_of(state), costmap, grown, rng) for state in ends)
    try:
        plan = plan_path(costmap, model, start, goal, PlanConfig(), seed)
    except NoPath:
        assert not joined
        return
    assert joined
    assert plain_free(costmap.lethal, model.footprint, plan.poses.xyt).all()
    np.testing.assert_allclose(plan.poses.xyt[[0, -1]], [start.xyt, goal.xyt], atol=1e-9)


def test_the_way_to_a_lattice_state_costs_one_and_a_half_times_its_length_in_cells():
    field = np.full((40, 40), 9.0, dtype=np.float32)
    numbers = np.full((40, 40), WIDE, dtype=np.int32)
    yaws = np.linspace(0.0, 2.0 * math.pi, 16, endpoint=False)
    pose = np.array([2.03, 2.05, 0.0])
    none = np.zeros(0, dtype=np.int8)
    headings = np.zeros((16, 2), dtype=np.int64)
    states, gaps = ends(
        Floor(Ground(field, 0.1, BURGER.footprint), numbers, none, none, headings, yaws, 2.0, 0.2), pose
    )
    assert len(states) == 25
    length = np.hypot(states[:, 1] * 0.1 + 0.05 - pose[0], states[:, 0] * 0.1 + 0.05 - pose[1]) / 0.1
    np.testing.assert_allclose(gaps, 1.5 * length)
