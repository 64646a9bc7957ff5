"""The simulated robot of a session with its map and tasks, and what is written down of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NotRequired

import numpy as np

from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.durations import LONGEST_S, seconds
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.navigation.command_owner import CommandOwner
from turtlebag.pipeline.navigation.kit import Kit
from turtlebag.pipeline.navigation.sensing import Sensing
from turtlebag.pipeline.navigation.status_lines import News, tally, verdict
from turtlebag.pipeline.studio.library import Library
from turtlebag.pipeline.studio.pilot import Pilot, Task, WiggleDriver
from turtlebag.pipeline.studio.publisher import Publisher
from turtlebag.pipeline.studio.run_log import RunLogWriter
from turtlebag.pipeline.studio.setup import StudioSetup
from turtlebag.pipeline.studio.view import Level, Stop, View
from turtlebag.pipeline.studio.visuals import EventLog, Trails, Visuals
from turtlebag.planners.control.collision_monitor import CollisionMonitor
from turtlebag.planners.costmap import Costmap, costmap_from_grid
from turtlebag.reports.metrics.navigation import RunMetrics
from turtlebag.sim.robots import stamp_of
from turtlebag.sim.simulator import Simulator

TUTORIAL = "turtlebot3_world"
"""The world of the tutorial, and of its waypoints."""


@dataclass(frozen=True, eq=False)
class LoadedMap:
    """The map in use, its name as asked for, and its file."""

    grid: OccupancyGrid
    name: str | None
    path: Path


class TaskMetrics(RunMetrics):
    """Those of a task that began so long after the session [s], and why it was broken off, if it was."""

    begin_s: float
    broken_off: NotRequired[str]


class Robot:
    """Simulator, run log and the bag that is recorded outlast a restart; everything else begins anew."""

    idle = False
    longest_s = LONGEST_S

    def __init__(self, setup: StudioSetup, folder: Path, events: EventLog) -> None:
        """As after a restart. InputError for a map of the setup that cannot be used."""
        self.setup, self.folder, self._events = setup, folder, events
        self.library = Library(folder, setup.map_path, tutorial=setup.arena.name == TUTORIAL)
        self.publisher, self.trails = Publisher(), Trails()
        self.simulator = Simulator(setup.arena, setup.spec, setup.config.sim, setup.seed)
        self.run_log = RunLogWriter(folder, self.simulator, self.publisher)
        self.recording: tuple[str, BagWriter] | None = None
        """Name of the bag that is recorded, and the bag."""
        self.bags: tuple[str, ...] = ()
        """Names of the bags so far."""
        self._tasks: list[TaskMetrics] = []
        """Metrics of the tasks that are over."""
        self.waypoints: tuple[Stop, ...] = ()
        self._step = 0
        self.restart()

    def restart(self) -> None:
        """Put the robot at the world's spawn, on the map of the setup."""
        setup, robot = self.setup, self.setup.spec
        self.observation = self.simulator.reset(step=self._step)
        self.publisher.grid = self.publisher.path = None
        self.pilot = Pilot(Kit(robot, setup.config, setup.seed, Sensing.of(robot), self.publisher))
        self.by_hand: Twist | None = None
        """The current teleop command; None without teleop."""
        self.owner = CommandOwner(self.pilot, robot.model, self, CollisionMonitor(robot.model))
        self.loaded: LoadedMap | None = None
        self.keepout: tuple[Array, ...] = setup.arena.keepout
        self.boxes = np.zeros((0, 4))
        """Dropped so far, see `View.boxes`."""
        self._visuals = Visuals(self.pilot)
        self._doing = ""
        self._news = News("", self.say, self._clock)
        self.trails.clear()
        if setup.map_path is not None:
            self.load_map("")

    def load_map(self, name: str) -> LoadedMap:
        """Go by a map of the library; the robot is not localised on it yet. InputError when there is none."""
        path, grid, saved = self.library.load_map(name)
        keepout = self.setup.arena.keepout if saved is None else saved
        costmap = self.costmap(grid, keepout)
        self.end_task("ended: a map was loaded")
        self.loaded, self.keepout = LoadedMap(grid, name, path), keepout
        self.pilot.load(grid, costmap, self.stamp_ns)
        self.trails.frame_changed()
        return self.loaded

    def costmap(self, grid: OccupancyGrid, keepout: Sequence[Array]) -> Costmap:
        """What the robot plans on; InputError for a map that is too large for one."""
        return costmap_from_grid(grid, self.setup.config.costmap, keepout)

    @property
    def stamp_ns(self) -> int:
        """Simulated time since the session began [ns]."""
        return stamp_of(self._step)

    @property
    def T_map_base(self) -> SE2:
        """The estimated pose; by odometry alone until there is a better one."""
        return self.pilot.T_map_odom @ self.observation.odometry.T_odom_base

    def asked(self, stamp_ns: int) -> Twist | None:
        """The speed asked for by hand (see `CommandOwner`)."""
        return self.by_hand

    def say(self, text: str, level: Level = "info") -> None:
        """A line for the event log."""
        self._events.add(self.stamp_ns, text, level)

    def tick(self) -> None:
        """One control period."""
        observation, pilot, truth = self.observation, self.pilot, self.simulator.truth
        self.owner.step(observation)
        del self.owner.asked[:-1]  # the journal has them
        self.run_log.tick(observation, self.owner, pilot.T_map_odom)
        task = pilot.task
        sequence = None if task is None else task.sequence
        self._news.tick(observation.stamp_ns, self.owner, sequence, truth)
        if observation.scan is not None:
            T_odom_base = observation.odometry.T_odom_base
            self.trails.leave(T_odom_base, self.T_map_base, truth.T_world_base, pilot.slam)
        if task is not None and task.driver.finished:
            self._task_over(task)
        elif task is not None and observation.stamp_ns >= task.end_ns:
            self.end_task("cancelled: timed out")
        self.observation = self.simulator.step(self.owner.command)
        self._step += 1

    def begin(self, task: Task) -> None:
        """Start a task with the next tick; no other is running."""
        self.pilot.begin(task)
        self.run_log.begin()
        self._news.begin()
        self._visuals.shown = task.sequence

    def end_task(self, why: str) -> None:
        """End the task, if there is one."""
        task = self.pilot.task
        if task is None:
            return
        if task.sequence is not None:
            task.sequence.close_all("timeout", why, self.stamp_ns)
        self._task_over(task, why)

    def _task_over(self, task: Task, broken_off: str = "") -> None:
        """Its metrics and a line; a task that was broken off has neither succeeded nor failed."""
        if isinstance(task.driver, WiggleDriver):
            self.say(task.driver.convergence)
        explorer = task.explorer
        grid = None if explorer is None else explorer.grid
        metrics = self.run_log.end(task, grid)
        if metrics is not None:
            about: TaskMetrics = {"begin_s": round(seconds(task.begin_ns), 6), **metrics}
            if broken_off:
                about["broken_off"] = broken_off
            self._tasks.append(about)
        if broken_off:
            self.say(f"{task.kind} {broken_off}" + (f": {tally(metrics)}" if metrics is not None else ""))
        elif metrics is not None:
            self.say(verdict(metrics), "info" if metrics["true_success"] else "warning")
        self.publisher.path = None
        self.pilot.end_task()

    def _clock(self, stamp_ns: int, doing: str) -> None:
        self._doing = doing

    def carried(self) -> None:
        """The robot was carried: what it last said of its place does not hold here."""
        self._visuals.carried()

    def interrupt(self) -> None:
        """Nothing takes long."""

    def close(self, failure: type[BaseException] | None = None) -> None:
        """Finish the files of the run; after a failure, the open bag as far as it goes."""
        if failure is None:
            self.run_log.close()
        elif self.recording is not None:
            self.recording[1].__exit__(failure)
        self.simulator.close()

    def metrics(self) -> dict[str, Any]:
        """The metrics of each task."""
        return {"tasks": self._tasks}

    def view(self) -> View:
        """What there is to draw now."""
        pilot, look, truth, trails = self.pilot, self._visuals, self.simulator.truth, self.trails
        task, command, moving = pilot.task, self.owner.command, self.simulator.surroundings.moving
        sequence = None if task is None else task.sequence
        goal = None if sequence is None or sequence.goal is None else sequence.waypoint.written
        return View(
            stamp_ns=self.stamp_ns,
            owner=self.owner.owner,
            command=(command.v, command.w),
            task="" if task is None else task.kind,
            state=self._doing,
            recording=None if self.recording is None else self.recording[0],
            mapping=pilot.mapping,
            map_name=None if self.loaded is None else self.loaded.name,
            maps=self.library.maps,
            waypoint_files=self.library.waypoint_files,
            bags=self.bags,
            waypoints=look.waypoints(self.waypoints),
            localised=pilot.localised,
            sure=look.sure(),
            lost=look.lost(),
            T_map_base=self.T_map_base,
            T_odom_base=self.observation.odometry.T_odom_base,
            T_world_base=truth.T_world_base,
            goals=look.goals(),
            goal_index=pilot.goal_index,
            goal=goal,
            sectors=look.sectors(),
            events=self._events.events,
            scan=look.scan(),
            particles=look.particles(),
            plan=look.plan(self.publisher.path),
            local=look.local(self.T_map_base, command),
            odom_path=trails.odom.path,
            slam_path=trails.slam.path,
            true_path=trails.true.path,
            graph=look.graph(),
            boxes=self.boxes,
            keepout=self.keepout,
            mover_segments=moving.segments,
            mover_circles=moving.circles,
            map=look.map(self.publisher.grid),
            costmap=look.costmap(),
        )
