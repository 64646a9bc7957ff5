"""Lesson 1: drive and record."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from turtlebag.datasets.se2 import SE2, Array, compose
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.course.contracts import WheelOdometry
from turtlebag.pipeline.course.lesson import Case, Lesson, once
from turtlebag.pipeline.course.rooms import ROBOT, WORLD, draw_map, free_pose, room_at
from turtlebag.sim.robots import load_robot
from turtlebag.sim.simulator import CONTROL_HZ, SimConfig, Simulator
from turtlebag.sim.wheels import OdometryConfig
from turtlebag.sim.worlds import load_world

GOOD, FAIR = 0.06, 0.2
DRIVE_S, EVERY = 24, 3
"""Length of a drive [s], and every how manieth reading of the wheels is given."""
AHEAD_M, ROOM_M = 0.25, 0.25
MISTAKES = {
    "the wheels do not move it: it stays at the start": (0.0, 1.0, False),
    "left and right are exchanged": (1.0, 1.0, True),
    "the distance between the wheels counts twice": (1.0, 2.0, False),
    "the distance between the wheels counts half": (1.0, 0.5, False),
    "the wheel's diameter is used as its radius": (2.0, 1.0, False),
    "the wheel's radius is used as its diameter": (0.5, 1.0, False),
}
"""Factors of radius and track, and whether the wheels are exchanged."""


def make(rng: np.random.Generator) -> Case:
    """A drive in the simulator: ahead in curves where there is room, else turning."""
    robot, config = (
        load_robot(ROBOT),
        SimConfig(sensors="clean", odometry=OdometryConfig(radius_error=0.0, track_error=0.0)),
    )
    first = rng.uniform(20.0, 60.0, 2)
    wheels, poses = [], []
    with Simulator(load_world(WORLD), robot, config, int(rng.integers(2**31))) as simulator:
        seen = simulator.reset(SE2.from_array(free_pose(rng)))
        turn, side = 0.0, float(rng.choice([-0.9, 0.9]))
        for step in range(DRIVE_S * CONTROL_HZ):
            if step % EVERY == 0:
                wheels.append(first + seen.joints.position)
                poses.append(simulator.truth.T_world_base.xyt)
            if step % CONTROL_HZ == 0:
                turn = float(rng.normal(0.0, 0.5))
            clear = room_at(simulator.truth.T_world_base @ np.array([AHEAD_M, 0.0])) > ROOM_M
            seen = simulator.step(Twist(0.2, turn) if clear else Twist(0.0, side))
    new = {"radius": robot.wheels.radius, "track": robot.wheels.separation, "start": poses[0]}
    return Case(new, tuple({"left": left, "right": right} for left, right in wheels), np.array(poses))


def error(case: Case, answer: Array) -> float:
    """Largest distance from the true path [m]."""
    return float(np.hypot(*(answer - case.truth)[:, :2].T).max())


def by_wheels(case: Case, radius: float = 1.0, track: float = 1.0, exchanged: bool = False) -> Array:
    """The path (n, 3) that follows from the wheels, with a mistake."""
    angles = np.array([(asked["left"], asked["right"]) for asked in case.questions])
    rolled = np.diff(angles[:, ::-1] if exchanged else angles, axis=0) * case.new["radius"] * radius
    poses = [case.new["start"]]
    for left, right in rolled:
        turn = (right - left) / (case.new["track"] * track)
        half = compose(poses[-1], np.array([0.0, 0.0, 0.5 * turn]))
        poses.append(compose(half, np.array([0.5 * (left + right), 0.0, 0.5 * turn])))
    return np.array(poses)


def words(case: Case, answer: Array) -> str:
    """Which mistake it looks like."""
    for said, mistake in MISTAKES.items():
        if np.hypot(*(answer - by_wheels(case, *mistake))[:, :2].T).max() < GOOD:
            return said
    off = np.hypot(*(answer - case.truth)[:, :2].T)
    if off[0] > FAIR:
        return f"it does not begin at the start: {off[0]:.2f} m off; the first angles need not be 0"
    return f"{off.max():.2f} m off, {off[len(off) // 2]:.2f} m half way"


def draw(axes: Axes, case: Case, result: Array | None, colour: str) -> None:
    """The map and the path."""
    draw_map(axes)
    if result is not None:
        axes.plot(*result[:, :2].T, color=colour, label="path")


LESSON = Lesson(
    1, "Drive and record", (WheelOdometry,), "m", GOOD, FAIR, make, once, error, words, draw,
)  # fmt: skip
