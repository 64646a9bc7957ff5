"""The controllers' compiled parts beside plain loops and other formulas for the same."""

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial import ConvexHull

from tests.helpers.planning_room import BURGER
from turtlebag.datasets.se2 import SE2
from turtlebag.planners.control.along_path import arc_lengths, point_at, project
from turtlebag.planners.control.collision_monitor import depth_inside, free_time, moved, padded
from turtlebag.planners.control.dwa import COMFORT_M, STEP_S, ArcFloor, ArcWeights, best_arc, value_at
from turtlebag.planners.costmap import clearance_field, distance_field
from turtlebag.planners.footprint import field_at, footprint_clearance, sample_footprint
from turtlebag.planners.grid_distance import grid_distance
from turtlebag.sim.robots import load_robot

RES = 0.05


def bent(seed: int, n: int = 20):
    """A path of uneven steps, with one place twice."""
    points = np.random.default_rng(seed).normal(0.0, 0.2, (n, 2)).cumsum(axis=0)
    points[n // 2] = points[n // 2 - 1]
    return points


@pytest.mark.parametrize("seed", range(4))
def test_lengths_along_a_path_are_the_sums_of_its_pieces(seed):
    path = bent(seed)
    expected = [sum(math.dist(a, b) for a, b in itertools.pairwise(path[: k + 1])) for k in range(len(path))]
    np.testing.assert_allclose(arc_lengths(path), expected, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_the_nearest_place_on_a_path_is_that_of_dense_samples(seed):
    path, rng = bent(seed), np.random.default_rng(seed)
    lengths = arc_lengths(path)
    dense = np.linspace(0.0, lengths[-1], 20001)
    places = np.column_stack([np.interp(dense, lengths, path[:, 0]), np.interp(dense, lengths, path[:, 1])])
    for x, y in rng.normal(0.0, 1.0, (30, 2)):
        s, distance = project(path, lengths, x, y, -0.5, lengths[-1] + 0.5)
        gaps = np.hypot(places[:, 0] - x, places[:, 1] - y)
        assert distance == pytest.approx(gaps.min(), abs=2e-4)
        at = np.array(point_at(path, lengths, s))
        assert math.dist(at, (x, y)) == pytest.approx(distance, abs=1e-9)


@pytest.mark.parametrize(
    ("window", "s", "distance"),
    [
        ((0.0, 9.0), 7.4, 0.3),
        ((0.0, 4.9), 1.6, 0.7),  # the pieces that begin within it, and no later one
        ((0.0, 5.0), 7.0, 0.5),
        ((2.0, 4.9), 1.6, 0.7),
        ((2.1, 4.9), 2.0, math.hypot(0.4, 0.7)),
        ((4.1, 4.9), 4.7, 2.4),
        ((7.0, 8.0), 7.4, 0.3),
        ((7.1, 8.0), 7.4, 0.3),
    ],
)
def test_the_nearest_place_is_looked_for_on_the_pieces_that_a_window_touches(window, s, distance):
    """Out along y = 0, back along y = 1."""
    path = np.array([[0.0, 0.0], [2.0, 0.0], [4.0, 0.0], [4.0, 1.0], [2.0, 1.0], [0.0, 1.0]])
    found = project(path, arc_lengths(path), 1.6, 0.7, *window)
    assert found == (pytest.approx(s), pytest.approx(distance))


@pytest.mark.parametrize("seed", range(3))
def test_the_point_at_a_length_is_interpolated_and_held_at_the_ends(seed):
    path = bent(seed)
    lengths = arc_lengths(path)
    for s in [*np.linspace(-0.5, lengths[-1] + 0.5, 60), *lengths]:
        expected = np.interp(s, lengths, path[:, 0]), np.interp(s, lengths, path[:, 1])
        assert point_at(path, lengths, s) == pytest.approx(expected)


@pytest.mark.parametrize("v", [0.3, -0.2, 0.0])
@pytest.mark.parametrize("w", [0.9, -1.7, 0.0, 1e-7, 1e-5])
def test_an_arc_is_what_the_unicycles_equations_integrate_to(v, w):
    start = (0.4, -0.3, 2.0)
    end = solve_ivp(
        lambda _, p: (v * math.cos(p[2]), v * math.sin(p[2]), w), (0.0, 1.7), start, rtol=1e-10, atol=1e-12
    )
    assert moved(*start, v, w, 1.7) == pytest.approx(end.y[:, -1], abs=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_the_depth_in_a_polygon_is_the_distance_to_its_nearest_edges_line(seed):
    rng = np.random.default_rng(seed)
    hull = ConvexHull(rng.normal(size=(10, 2)))
    corners = hull.points[hull.vertices]
    for x, y in rng.normal(size=(60, 2)):
        expected = -np.max(hull.equations[:, :2] @ [x, y] + hull.equations[:, 2])
        assert depth_inside(corners, x, y) == pytest.approx(expected)
    grown = ConvexHull(padded(corners, 0.1))
    for normal in hull.equations:
        same = grown.equations[np.argmax(grown.equations[:, :2] @ normal[:2])]
        np.testing.assert_allclose(same, normal - [0.0, 0.0, 0.1], atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_the_free_time_ends_at_the_last_step_before_a_point_gets_deeper(seed):
    rng = np.random.default_rng(seed)
    shape = BURGER.footprint
    reach = float(np.linalg.norm(shape, axis=1).max())
    seen = 0
    for _ in range(30):
        v, w = rng.uniform(-0.3, 0.3), rng.uniform(-2.0, 2.0)
        points, horizon, dt = rng.uniform(-0.3, 0.3, (6, 2)), rng.uniform(0.3, 1.5), 0.037
        steps = math.ceil(horizon / dt)
        start = [depth_inside(shape, *p) for p in points]
        expected = horizon
        for i in range(1, steps + 1):
            T = SE2.from_xyt(*moved(0.0, 0.0, 0.0, v, w, horizon * i / steps)).inverse()
            depth = [depth_inside(shape, *(T @ p)) for p in points]
            if any(d > max(0.0, s + 1e-4) for d, s in zip(depth, start, strict=True)):
                expected = horizon * (i - 1) / steps
                seen += 1
                break
        assert free_time(points, shape, reach, v, w, horizon, dt) == pytest.approx(expected)
    assert seen > 5


def test_points_out_of_reach_leave_the_whole_time():
    shape = BURGER.footprint
    assert free_time(np.array([[3.0, 0.0]]), shape, 0.15, 0.2, 0.0, 1.0, 0.1) == 1.0
    # one step that ends in a point, and a horizon shorter than a step
    assert free_time(np.array([[0.2, 0.0]]), shape, 0.15, 0.5, 0.0, 0.35, 1.0) == 0.0


def test_a_value_of_a_field_is_its_cells_and_the_other_one_elsewhere():
    field = np.array([[0.0, 1.0, 2.0], [3.0, np.inf, 5.0]], dtype=np.float32)
    for x, y, value in (
        (0.5, 0.5, 0.0), (2.9, 0.9, 2.0), (0.0, 1.0, 3.0), (2.0, 1.99, 5.0), (1.5, 1.5, 7.0),
        (-0.1, 0.5, 7.0), (3.0, 0.5, 7.0), (0.5, -0.1, 7.0), (0.5, 2.0, 7.0),
    ):  # fmt: skip
        assert value_at(field, 1.0, x, y, 7.0) == value


NAMES = (
    "time", "braking", "goal", "path", "ahead", "room", "least", "back", "nose", "occupied", "least_v",
    "least_w",
)  # fmt: skip
USUAL = (1.2, 0.8, 1.0, 0.3, 0.325, 1.5, 0.06, 1.5, 0.0, 0.0, 0.0, 0.0)


def plain_arc(clearance, to_goal, to_path, samples, pose, vs, ws, setting):
    """The cost of every admissible arc, and the (v, w) of the least."""
    c = dict(zip(NAMES, setting, strict=True))

    def room_at(x, y, yaw):
        return footprint_clearance(clearance, RES, samples, x, y, yaw)

    here = room_at(*pose)
    base = value_at(to_goal, RES, pose[0], pose[1], 1.0e3)
    best = (np.inf, 0.0, 0.0)
    for v, w in itertools.product(vs, ws):
        if abs(v) < c["least_v"] and abs(w) < c["least_w"]:
            continue
        steps = math.ceil(max(c["time"], abs(v) / c["braking"] + STEP_S) / STEP_S)
        needed = v * v / (2.0 * c["braking"]) + abs(v) * STEP_S
        room, end, admissible = np.inf, pose, True
        for i in range(1, steps + 1):
            at = moved(*pose, v, w, i * STEP_S)
            d = room_at(*at)
            if d < c["least"] and d <= here:
                admissible = i > 2 and abs(v) * (i - 1) * STEP_S >= needed
                break
            room = min(room, d)
            if i * STEP_S < c["time"] + 1e-9:
                end = at
        if not admissible:
            continue
        nose = end[0] + c["ahead"] * math.cos(end[2]), end[1] + c["ahead"] * math.sin(end[2])
        cost = c["goal"] * (
            value_at(to_goal, RES, *end[:2], base + 1.0) + value_at(to_goal, RES, *nose, base + 1.0)
        )
        cost += c["path"] * value_at(to_path, RES, *end[:2], 1.0) + c["nose"] * value_at(
            to_path, RES, *nose, 1.0
        )
        cost += c["back"] * max(-v, 0.0) * c["time"] - c["room"] * min(room, COMFORT_M)
        cost += c["occupied"] * 252.0 * min(1.0, math.exp(-3.0 * (room - samples.inscribed)))
        if cost < best[0]:
            best = (cost, v, w)
    return best[1:]


@pytest.mark.parametrize(
    "changed",
    [
        {}, {"goal": 0.0, "path": 1.0}, {"nose": 2.0, "goal": 0.2}, {"occupied": 0.02, "room": 0.0},
        {"least_v": 0.15, "least_w": 0.6}, {"back": 0.0, "goal": 0.0, "path": 0.0},
        {"time": 0.5, "braking": 0.25},
        {"least": 0.0, "time": 2.0},
    ],
)  # fmt: skip
def test_the_best_arc_is_the_cheapest_of_all_that_can_be_stopped_in_time(changed):
    rng = np.random.default_rng(len(str(changed)))
    setting = np.array([changed.get(name, value) for name, value in zip(NAMES, USUAL, strict=True)])
    samples = sample_footprint(BURGER, 0.05)
    inside = [depth_inside(BURGER.footprint, *p) > 1e-9 for p in samples.points]
    assert inside == [k >= samples.outline for k in range(len(samples.points))]
    chosen = set()
    for _ in range(10):
        lethal = rng.random((50, 50)) < 0.008
        lethal[20:30, 20:30] = False
        clearance = clearance_field(lethal, RES)
        on = np.zeros((50, 50), dtype=bool)
        on[25, 25:] = True
        to_path = distance_field(on, RES)
        to_goal = grid_distance(clearance > 0.12, *rng.integers(5, 45, 2), np.inf) * np.float32(RES)
        pose = (*rng.uniform(1.05, 1.45, 2), rng.uniform(-3.0, 3.0))
        vs, ws = np.linspace(-0.3, 0.6, 7), np.linspace(-1.5, 1.5, 7)
        found = best_arc(
            ArcFloor(clearance, to_goal, to_path, RES), samples, pose, vs, ws, ArcWeights(*setting)
        )  # fmt: skip
        assert found == plain_arc(clearance, to_goal, to_path, samples, pose, vs, ws, setting)
        chosen.add(found)
    assert len(chosen) > 4


@pytest.mark.parametrize("seed", range(3))
def test_a_post_under_a_corner_is_left_as_all_samples_of_the_footprint_say(seed):
    """A jackal's corners lie farther out than its outline's other points: there the inner ones count."""
    robot, rng = load_robot("jackal").model, np.random.default_rng(seed)
    samples, post = sample_footprint(robot, 0.05), np.zeros((80, 80), dtype=bool)
    post[40, 40] = True
    clearance = clearance_field(post, RES)
    to_goal = grid_distance(np.ones((80, 80), dtype=bool), 40, 70, np.inf) * np.float32(RES)
    vs, ws, setting = np.linspace(-0.3, 0.6, 7), np.linspace(-1.5, 1.5, 7), np.array(USUAL)
    floor = ArcFloor(clearance, to_goal, clearance, RES)
    for _ in range(30):
        corner, yaw = robot.footprint[rng.integers(4)] * rng.uniform(0.7, 0.95, 2), rng.uniform(-3.0, 3.0)
        pose = (*(40.5 * RES - SE2.from_xyt(0.0, 0.0, yaw) @ corner).tolist(), yaw)
        found = best_arc(floor, samples, pose, vs, ws, ArcWeights(*USUAL))
        assert found == plain_arc(clearance, to_goal, clearance, samples, pose, vs, ws, setting)


def test_where_nothing_can_be_driven_the_robot_stands():
    lethal = np.ones((50, 50), dtype=bool)
    lethal[24:27, 24:27] = False
    clearance, samples = clearance_field(lethal, RES), sample_footprint(BURGER, 0.05)
    flat = np.ones((50, 50), dtype=np.float32)
    assert field_at(clearance, RES, 1.275, 1.275) == pytest.approx(0.1)
    found = best_arc(
        ArcFloor(clearance, flat, flat, RES), samples, (1.275, 1.275, 0.0),
        np.array([0.3]), np.array([0.5]), ArcWeights(*USUAL),
    )  # fmt: skip
    assert found == (0.0, 0.0)
