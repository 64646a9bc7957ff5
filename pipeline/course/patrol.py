"""Lesson 7: planning and control, the patrol."""

from __future__ import annotations

from functools import cache

import numpy as np
from matplotlib.axes import Axes

from turtlebag.datasets.se2 import SE2, Array, wrap
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.course.lesson import Case, Lesson
from turtlebag.pipeline.course.process import Fault, Pupil
from turtlebag.pipeline.course.rooms import CELL_M, ROBOT, WORLD, draw_map, free_pose, true_map
from turtlebag.planners.control.controller import Controller
from turtlebag.planners.costmap import Costmap, CostmapConfig, costmap_from_grid
from turtlebag.planners.planner import GlobalPlanner, PlanConfig
from turtlebag.planners.tasks.waypoints import tutorial_patrol
from turtlebag.sim.robots import PERIOD_S, load_robot
from turtlebag.sim.simulator import Simulator
from turtlebag.sim.worlds import load_world

GOOD, FAIR = 0.0, 0.25
"""Shares of the goals that are not reached."""
TIMEOUT_S, MOST_MISSED = 60.0, 2
"""Time for each goal [s], as in the tutorial; with more goals missed than that, the drive is over."""
HOLD = 3
"""Control steps of the simulator for which a command holds."""
NEAR_M, TURNED_RAD = 0.1, 0.2
MOST_GAP_M = 0.2
SIGMA = np.array([0.005, 0.005, 0.01])
"""Errors of the pose that the controller is told [m, m, rad]."""


@cache
def costmap() -> Costmap:
    """The walls of the arena as obstacles."""
    return costmap_from_grid(true_map(), CostmapConfig())


def make(rng: np.random.Generator) -> Case:
    """The tutorial's eight waypoints from any of them on, either way round, from a random start."""
    goals = np.array([w.T_map_goal.xyt for w in tutorial_patrol().waypoints if w.T_map_goal is not None])
    order = np.roll(np.arange(len(goals))[:: int(rng.choice([-1, 1]))], rng.integers(len(goals)))
    return Case({}, (), goals[order], {"start": free_pose(rng), "seed": int(rng.integers(2**31))})


def play(case: Case, pupil: Pupil) -> Array:
    """The drive (n, 6): x, y, yaw, goals reached, goals missed, and whether something was touched."""
    robot, seed = load_robot(ROBOT), case.hidden["seed"]
    rng, rows = stream(seed, "pose"), [np.array([*case.hidden["start"], 0.0, 0.0, 0.0])]
    with Simulator(load_world(WORLD), robot, seed=seed) as simulator:
        simulator.reset(SE2.from_array(case.hidden["start"]))
        pupil.new("Controller", model=robot.model, period=HOLD * PERIOD_S)
        for goal in case.truth:
            asked = {"T_map_start": simulator.truth.T_world_base, "T_map_goal": SE2.from_array(goal)}
            pupil.new("GlobalPlanner", config=PlanConfig())
            path = pupil.ask("plan", (None, 3), costmap=costmap(), model=robot.model, seed=seed, **asked)
            check(path, goal)
            pupil.ask("set_path", None, poses=SE2.from_array(path))
            rows += leg(simulator, pupil, rng, goal, rows[-1])
            if rows[-1][5] or rows[-1][4] > MOST_MISSED:
                break
    return np.array(rows)


def leg(
    simulator: Simulator, pupil: Pupil, rng: np.random.Generator, goal: Array, before: Array
) -> list[Array]:
    """The drive to one goal, up to the contact if there is one."""
    last, rows, outcome = Twist(), [], before[3:].copy()
    for _ in range(round(TIMEOUT_S / (HOLD * PERIOD_S))):
        pose = SE2.from_array(simulator.truth.T_world_base.xyt + SIGMA * rng.standard_normal(3))
        last = Twist(*pupil.ask("command", (2,), pose=pose, last=last, costmap=costmap()).tolist())
        for _ in range(HOLD):
            simulator.step(last)
            outcome[2] = max(outcome[2], simulator.truth.contact_visible)
        rows.append(np.array([*simulator.truth.T_world_base.xyt, *outcome]))
        off = rows[-1][:3] - goal
        arrived = bool(np.hypot(*off[:2]) < NEAR_M and abs(wrap(off[2])) < TURNED_RAD)
        if arrived or outcome[2]:
            break
    rows[-1][3:5] += [arrived, not arrived]
    return rows


def check(path: Array, goal: Array) -> None:
    """Fault for a path that does not lead to the goal, or through something."""
    x, y = path[-1, :2]
    if np.hypot(*(path[-1, :2] - goal[:2])) > NEAR_M:
        raise Fault(f"the path ends at {x:.2f}, {y:.2f} in place of the goal {goal[0]:.2f}, {goal[1]:.2f}")
    if (gap := np.hypot(*np.diff(path[:, :2], axis=0).T).max(initial=0.0)) > MOST_GAP_M:
        raise Fault(f"poses of the path are {gap:.2f} m apart; at most {MOST_GAP_M} m are allowed")
    through = path[1:, :2][costmap().clearance_at(path[1:, :2]) < CELL_M]
    if len(through):
        raise Fault("the path leads through an obstacle at {:.2f}, {:.2f}".format(*through[0]))


def error(case: Case, answer: Array) -> float:
    """The share of goals that are not reached; all of them after a contact."""
    return 1.0 if answer[-1, 5] else float(1.0 - answer[-1, 3] / len(case.truth))


def words(case: Case, answer: Array) -> str:
    """What happened on the way."""
    x, y, _, reached, missed, touched = answer[-1]
    if touched:
        return f"it touches something at {x:.2f}, {y:.2f}, on the way to goal {int(reached + missed)}"
    if np.ptp(answer[:, :2], axis=0).max() < NEAR_M:
        return "it does not drive: the commands have no speed ahead"
    k = int(np.argmax(answer[:, 4] > 0))
    goal = case.truth[int(answer[k, 3])]
    off = float(np.hypot(*(answer[k, :2] - goal[:2])))
    turned = f"at {off:.2f} m, but not turned as it says" if off < NEAR_M else f"it ends {off:.2f} m off"
    where = f"goal {int(answer[k, 3]) + 1} at {goal[0]:.1f}, {goal[1]:.1f}"
    return f"{where} is not reached in {TIMEOUT_S:.0f} s: {turned}"


def draw(axes: Axes, case: Case, result: Array | None, colour: str) -> None:
    """The map, the goals and the drive."""
    draw_map(axes)
    axes.plot(*case.truth[:, :2].T, "o", color="0.5", markersize=4, fillstyle="none")
    if result is not None:
        axes.plot(*result[:, :2].T, color=colour, label="drive")
        if result[-1, 5]:
            axes.plot(*result[-1, :2], "x", color="tab:red")


LESSON = Lesson(
    7, "Planning and control", (GlobalPlanner, Controller), "of the goals", GOOD, FAIR,
    make, play, error, words, draw, "the solution",
)  # fmt: skip
