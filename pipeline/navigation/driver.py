"""What drives the robot in a run: sees observations, returns commands."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.parts import Answer
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Observation, Twist
from turtlebag.pipeline.navigation.goal_runner import Tick
from turtlebag.pipeline.navigation.sensing import DeskewedScan, Sensing
from turtlebag.planners.control.interface import require_twist
from turtlebag.planners.obstacle_layer import ObstacleLayer


class Task(Protocol):
    """A task in closed loop: `--task module:Class`. It never sees the truth.

    Whoever derives from `Driver` has all of it but `step` and `stand_by`.
    """

    sensing: Sensing
    """That of the kit, or one of its own; it is shown every observation, in `step` and `stand_by`."""
    state: str
    """One word on what it is doing, for the run log."""
    goal_index: int
    """Which goal it pursues, -1 for none."""
    finished: bool
    """Whether the task is over; it is asked no more then."""
    estimate: SE2 | None
    """Where it takes itself to be in the map; None when it does not know, or needs no map."""

    def __init__(self, kit: Any, mission: Any) -> None:
        """With a `turtlebag.pipeline.navigation.drivers.Kit`, what drivers are made of, and a
        `turtlebag.pipeline.navigation.setup.Mission`, what was asked for: the map, if one was given."""
        ...

    def step(self, observation: Observation) -> Twist:
        """The command for the next control period, within the limits of the robot."""
        ...

    def stand_by(self, observation: Observation) -> None:
        """Take in an observation of a tick in which someone else drives; goals wait meanwhile."""
        ...

    def resume(self, last: Twist) -> None:
        """Drive again from the next step on, after the command that someone else gave last."""
        ...


def require_task(task: Task, observation: Observation, command: object) -> None:
    """InputError unless it returned, and says of itself, what it must after a step."""
    require_twist(task, "step", command)
    answer = Answer(task, "step")
    answer.require_kind("state", task.state, str)
    answer.require_kind("goal_index", task.goal_index, int, np.integer)
    answer.require_kind("finished", task.finished, bool, np.bool_)
    if task.estimate is not None:
        answer.require_kind("estimate", task.estimate, SE2)
        answer.require_finite("estimate", task.estimate.xyt, 3)
    if task.sensing.shown_ns != observation.stamp_ns:
        raise answer.wrong("its sensing must be shown every observation")


class Driver(Task):
    """What the tasks share. It never sees the truth."""

    def __init__(self, sensing: Sensing) -> None:
        self.sensing, self.state = sensing, "wait"
        self.goal_index, self.finished = -1, False
        self.estimate: SE2 | None = None
        self._last = Twist()

    def resume(self, last: Twist) -> None:
        """Drive again from the next step on, after the command that someone else gave last."""
        self._last = last

    def _see(self, sweep: DeskewedScan, T_frame_odom: SE2, obstacles: ObstacleLayer) -> None:
        """Enter a sweep in the obstacle layer."""
        obstacles.update(
            seconds(sweep.stamp_ns),
            T_frame_odom @ sweep.T_odom_lidar,
            T_frame_odom @ sweep.hits_odom,
            T_frame_odom @ sweep.passes_odom,
        )

    def _tick(self, observation: Observation, T_frame_base: SE2, *, stop: bool = False) -> Tick:
        """What a goal runner is told of a tick; `stop` where something moves too near."""
        return Tick(
            observation.stamp_ns,
            T_frame_base,
            observation.odometry.twist,
            self._last,
            self.sensing.points_base(observation.odometry.T_odom_base),
            observation.scan is not None,
            stop,
        )
