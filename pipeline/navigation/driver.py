"""The contract of a task, which drives the robot in a run: observations in, commands out."""

from __future__ import annotations

from typing import Protocol

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Observation, Twist
from turtlebag.pipeline.navigation.goal_runner import Tick
from turtlebag.pipeline.navigation.goal_states import State
from turtlebag.pipeline.navigation.kit import Kit
from turtlebag.pipeline.navigation.mission import Mission
from turtlebag.pipeline.navigation.sensing import DeskewedScan, Sensing
from turtlebag.planners.obstacle_layer import ObstacleLayer


class Task(Protocol):
    """A task in closed loop: `--task module:Class`. It never sees ground truth.

    A class that derives from `Driver` only needs `step` and `stand_by`.
    """

    sensing: Sensing
    """The kit's, or its own; `step` and `stand_by` must pass it every observation."""
    state: str
    """What it is doing, in one word, for the run log."""
    goal_index: int
    """The current goal, -1 for none."""
    finished: bool
    """Whether the task is over; then it is not called any more."""
    estimate: SE2 | None
    """The estimated pose on the map; None if unknown, or without a map."""

    def __init__(self, kit: Kit, mission: Mission) -> None:
        """`kit` holds the components of a driver, `mission` the command's options and the map, if any."""
        ...

    def step(self, observation: Observation) -> Twist:
        """The command for the next control period, within the robot's limits."""
        ...

    def stand_by(self, observation: Observation) -> None:
        """Process an observation during a teleop override; goals wait meanwhile."""
        ...

    def resume(self, last: Twist) -> None:
        """Drive again from the next step on; `last` is the override's last command."""
        ...


class Driver(Task):
    """Base of the tasks. It never sees ground truth."""

    def __init__(self, sensing: Sensing) -> None:
        self.sensing, self.state = sensing, State.WAIT.value
        self.goal_index, self.finished = -1, False
        self.estimate: SE2 | None = None
        self._last = Twist()

    def resume(self, last: Twist) -> None:
        """Drive again from the next step on; `last` is the override's last command."""
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
        """A tick's data for the goal runner; `stop` if a moving obstacle is too near."""
        return Tick(
            observation.stamp_ns,
            T_frame_base,
            observation.odometry.twist,
            self._last,
            self.sensing.points_base(observation.odometry.T_odom_base),
            observation.scan is not None,
            stop,
        )
