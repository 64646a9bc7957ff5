"""Lesson 8: reactive avoidance."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.course.contracts import Avoider
from turtlebag.pipeline.course.lesson import Case, Lesson
from turtlebag.pipeline.course.process import Pupil
from turtlebag.pipeline.course.rooms import HOUSE, draw_map, free_pose
from turtlebag.sim.robots import load_robot
from turtlebag.sim.simulator import CONTROL_HZ, Simulator
from turtlebag.sim.worlds import load_world

WAY_M = 4.0
"""What a drive must cover, without touching a wall: 4 m of ground not driven over before."""
GOOD, FAIR = 0.0, 2.0
"""Metres that are missing."""
DRIVE_S, ROOM_M = 40, 0.5
SPOT_M = 0.25
"""Size of the squares in which ground is counted."""


def make(rng: np.random.Generator) -> Case:
    """A start in the house."""
    start = free_pose(rng, ROOM_M, HOUSE)
    return Case({}, (), start[None], {"seed": int(rng.integers(2**31))})


def play(case: Case, pupil: Pupil) -> Array:
    """The drive (n, 4): x, y, yaw, and whether a wall was touched, at each scan."""
    world = load_world(HOUSE)
    robot = load_robot(world.robot)
    with Simulator(world, robot, seed=case.hidden["seed"]) as simulator:
        seen, command, rows = simulator.reset(SE2.from_array(case.truth[0])), Twist(), [[*case.truth[0], 0.0]]
        angles = robot.lidar.spec(True, None).angles + float(robot.T_base_lidar.yaw)
        pupil.new("Avoider", angles=angles, max_v=robot.model.max_v, max_w=robot.model.max_w)
        for _ in range(DRIVE_S * CONTROL_HZ):
            if seen.scan is not None:
                command = Twist(*pupil.ask("command", (2,), ranges=seen.scan.ranges.astype(float)).tolist())
                rows.append([*simulator.truth.T_world_base.xyt, 0.0])
            seen = simulator.step(command)
            if simulator.truth.contact_visible:
                rows.append([*simulator.truth.T_world_base.xyt, 1.0])
                break
    return np.array(rows)


def way(answer: Array) -> float:
    """Ground covered [m], counted once."""
    return SPOT_M * (len(np.unique(np.floor(answer[:, :2] / SPOT_M), axis=0)) - 1)


def error(case: Case, answer: Array) -> float:
    """Metres that are missing; all of them after a contact."""
    return WAY_M if answer[-1, 3] else max(0.0, WAY_M - way(answer))


def words(case: Case, answer: Array) -> str:
    """What happened."""
    x, y, _, touched = answer[-1]
    driven = float(np.hypot(*np.diff(answer[:, :2], axis=0).T).sum())
    if touched:
        return f"it touches a wall at {x:.2f}, {y:.2f}, after {driven:.1f} m"
    if driven < SPOT_M:
        return "it does not drive: is there a beam of 0 m or inf that stops it?"
    if driven > 2.0 * way(answer):
        return f"it goes round and round: {driven:.1f} m driven, {way(answer):.1f} m of ground"
    return f"only {way(answer):.1f} m of ground in {DRIVE_S} s, where {WAY_M:.0f} m are asked for"


def draw(axes: Axes, case: Case, result: Array | None, colour: str) -> None:
    """The walls, the start and the drive."""
    draw_map(axes, HOUSE)
    axes.plot(*case.truth[0, :2], "o", color="0.5", markersize=4, fillstyle="none")
    if result is not None:
        axes.plot(*result[:, :2].T, color=colour, label="drive")
        if result[-1, 3]:
            axes.plot(*result[-1, :2], "x", color="tab:red")


LESSON = Lesson(
    8, "Reactive avoidance", (Avoider,), "m", GOOD, FAIR, make, play, error, words, draw, "the solution",
)  # fmt: skip
