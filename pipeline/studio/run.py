"""The robot of a session since its start or last reset."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.navigation.drivers import Kit
from turtlebag.pipeline.navigation.sensing import Sensing
from turtlebag.pipeline.navigation.status_lines import News, verdict
from turtlebag.pipeline.navigation.teleop_override import CommandOwner
from turtlebag.pipeline.studio.library import Library
from turtlebag.pipeline.studio.pilot import Pilot, Task, WiggleDriver
from turtlebag.pipeline.studio.publisher import Publisher
from turtlebag.pipeline.studio.run_log import RunLogWriter
from turtlebag.pipeline.studio.setup import StudioSetup
from turtlebag.pipeline.studio.view import Level
from turtlebag.pipeline.studio.visuals import EventLog, Trails, Visuals
from turtlebag.planners.control.collision_monitor import CollisionMonitor
from turtlebag.reports.metrics.navigation import RunMetrics
from turtlebag.sim.simulator import Simulator


@dataclass(frozen=True, eq=False)
class LoadedMap:
    """The map in use, its name as asked for, and its file."""

    grid: OccupancyGrid
    name: str | None
    path: Path


class TaskMetrics(RunMetrics):
    """Those of a task that began so long after the session [s]."""

    begin_s: float


@dataclass(frozen=True, eq=False)
class Shared:
    """What survives a reset."""

    setup: StudioSetup
    simulator: Simulator
    library: Library
    run_log: RunLogWriter
    events: EventLog
    publisher: Publisher
    tasks: list[TaskMetrics]
    """Metrics of the tasks that are over."""
    trails: Trails


class Run:
    """Robot, map and tasks."""

    def __init__(self, shared: Shared, step: int) -> None:
        """The robot stands at the world's spawn at control step `step`."""
        setup = shared.setup
        self.shared = shared
        self.observation = shared.simulator.reset(step=step)
        robot, config = setup.spec, setup.config
        shared.publisher.grid = shared.publisher.path = None
        self.pilot = Pilot(Kit(robot, config, setup.seed, Sensing(robot.T_base_lidar), shared.publisher))
        self.by_hand: Twist | None = None
        """The current teleop command; None without teleop."""
        self.owner = CommandOwner(self.pilot, robot.model, self, CollisionMonitor(robot.model))
        self.visuals = Visuals(self.pilot)
        self.doing = ""
        self.loaded: LoadedMap | None = None
        self.keepout: tuple[Array, ...] = setup.arena.keepout
        self.boxes = np.zeros((0, 4))
        """Dropped so far, see `View.boxes`."""
        self.waypoints: tuple[tuple[float, float, float, float | None], ...] | None = None
        self._news = News("", self.say, self._clock)
        shared.trails.clear()

    @property
    def stamp_ns(self) -> int:
        """Simulated time [ns]."""
        return self.observation.stamp_ns

    @property
    def T_map_base(self) -> SE2:
        """The estimated pose; by odometry alone until there is a better one."""
        return self.pilot.T_map_odom @ self.observation.odometry.T_odom_base

    def asked(self, stamp_ns: int) -> Twist | None:
        """The speed asked for by hand (see `CommandOwner`)."""
        return self.by_hand

    def say(self, text: str, level: Level = "info") -> None:
        """A line for the event log."""
        self.shared.events.add(self.stamp_ns, text, level)

    def tick(self) -> None:
        """One control period."""
        observation, shared, pilot = self.observation, self.shared, self.pilot
        self.owner.step(observation)
        del self.owner.asked[:-1]  # the journal has them
        shared.run_log.tick(observation, self.owner, pilot.T_map_odom)
        task = pilot.task
        sequence = None if task is None else task.sequence
        self._news.tick(observation.stamp_ns, self.owner, sequence, shared.simulator.truth)
        if observation.scan is not None:
            T_odom_base, T_world_base = observation.odometry.T_odom_base, shared.simulator.truth.T_world_base
            shared.trails.leave(T_odom_base, self.T_map_base, T_world_base, pilot.slam)
        if task is not None and task.driver.finished:
            self._task_over(task)
        elif task is not None and observation.stamp_ns >= task.end_ns:
            self.end_task("cancelled: timed out")
        self.observation = shared.simulator.step(self.owner.command)

    def begin(self, task: Task) -> None:
        """Start a task with the next tick; no other is running."""
        self.pilot.begin(task)
        self.shared.run_log.begin()
        self._news.begin()
        self.visuals.shown = task.sequence

    def end_task(self, why: str) -> None:
        """End the task, if there is one."""
        task = self.pilot.task
        if task is None:
            return
        if task.sequence is not None:
            task.sequence.close_all("timeout", why, self.stamp_ns)
        self.say(f"{task.kind} {why}")
        self._task_over(task)

    def _task_over(self, task: Task) -> None:
        if isinstance(task.driver, WiggleDriver):
            self.say(task.driver.convergence)
        explorer = task.explorer
        grid = None if explorer is None else explorer.grid
        metrics = self.shared.run_log.end(task, grid)
        if metrics is not None:
            self.shared.tasks.append({"begin_s": round(seconds(task.begin_ns), 6), **metrics})
            self.say(verdict(metrics), "info" if metrics["true_success"] else "warning")
        self.shared.publisher.path = None
        self.pilot.end_task()

    def _clock(self, stamp_ns: int, doing: str) -> None:
        self.doing = doing
