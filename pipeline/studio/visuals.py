"""Turns a session into views, computing only what has changed."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

import numpy as np

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import RobotModel, Twist
from turtlebag.pipeline.localisation.amcl import Amcl
from turtlebag.pipeline.navigation.explore_driver import ExploreDriver
from turtlebag.pipeline.navigation.goal_states import State
from turtlebag.pipeline.navigation.initial_pose import on_map
from turtlebag.pipeline.navigation.navigator import NavigationDriver
from turtlebag.pipeline.slam.online.mapper import Mapper
from turtlebag.pipeline.studio.loops_shown import graph_of_mapper
from turtlebag.pipeline.studio.pilot import Pilot, Task
from turtlebag.pipeline.studio.view import (
    CostLayer,
    Event,
    GoalMark,
    Graph,
    Level,
    MapLayer,
    Path,
    SectorMarks,
    Stop,
)
from turtlebag.planners.costmap import Costmap
from turtlebag.planners.global_plan import fits
from turtlebag.planners.obstacle_layer import ObstacleLayer
from turtlebag.planners.tasks.patrol import GoalSequence

Made = TypeVar("Made")
AHEAD_S, AHEAD_STEPS = 1.5, 16
"""The local trajectory is where the command leads in this time."""
STEP_M, MOST_POINTS = 0.02, 20_000
FAR_M = 0.02
"""If a loop closure moves the robot farther than this, its path so far is drawn anew."""
MOST_EVENTS = 500
NO_ROOM = "in an obstacle, a keep-out area or unknown space"


class Trail:
    """A path that grows by points at least 2 cm apart; of a long one only the newer part is kept."""

    def __init__(self) -> None:
        self._points = np.empty((1024, 2))
        self._count = 0
        self.path = Path(0, self._points[:0])

    def add(self, xy: Array) -> None:
        """One more point (2,), unless it lies where the last one does."""
        if self._count and np.hypot(*(xy - self._points[self._count - 1])) < STEP_M:
            return
        if self._count == len(self._points):
            self._make_room()
        self._points[self._count] = xy
        self._count += 1
        self.path = Path(self.path.version, self._points[: self._count])

    def clear(self) -> None:
        """Begin anew."""
        self._points, self._count = np.empty((1024, 2)), 0
        self.path = Path(self.path.version + 1, self._points[:0])

    def replace(self, points: Array) -> None:
        """All its points (n, 2) were elsewhere."""
        self.clear()
        for xy in points[-MOST_POINTS:]:
            self.add(xy)

    def _make_room(self) -> None:
        """Room for more in another array: what was shown before does not change."""
        if self._count >= MOST_POINTS:
            self._count //= 2
            self._points = self._points[-self._count :]
            self.path = Path(self.path.version + 1, self._points)
        grown = np.empty((2 * len(self._points), 2))
        grown[: self._count] = self._points[: self._count]
        self._points = grown


class Trails:
    """The paths by odometry, by the robot's estimate, and in truth."""

    def __init__(self) -> None:
        self.odom, self.slam, self.true = Trail(), Trail(), Trail()
        self._loops = 0

    def clear(self) -> None:
        """The robot starts anew."""
        self.odom.clear()
        self.true.clear()
        self.frame_changed()

    def frame_changed(self) -> None:
        """The robot's path so far was on another map."""
        self.slam.clear()
        self._loops = 0

    def leave(self, T_odom_base: SE2, T_map_base: SE2, T_world_base: SE2, slam: Mapper | None) -> None:
        """The robot is here; what maps, if anything, may have closed loops."""
        self.odom.add(T_odom_base.xy)
        self.slam.add(T_map_base.xy)
        self.true.add(T_world_base.xy)
        jumps = [] if slam is None else slam.jumps[self._loops :]
        if slam is not None and max(jumps, default=0.0) > FAR_M:
            self.slam.replace(slam.trajectory.poses.xy)
        self._loops += len(jumps)


class EventLog:
    """The last lines, numbered."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._lines: deque[Event] = deque(maxlen=MOST_EVENTS)
        self._number = 0
        self.events: tuple[Event, ...] = ()

    def add(self, stamp_ns: int, text: str, level: Level = "info") -> None:
        """One more line."""
        self._number += 1
        self._lines.append(Event(self._number, round(seconds(stamp_ns), 3), text, level))
        self.events = tuple(self._lines)
        self._say(text)


class Cached:
    """The last thing made, for as long as what it was made of is the same objects."""

    def __init__(self) -> None:
        self._made: dict[str, tuple[tuple[Any, ...], Any]] = {}

    def get(self, name: str, of: tuple[Hashable | object, ...], make: Callable[[], Made]) -> Made:
        """What was made under this name of these objects, or else what `make` makes."""
        before = self._made.get(name)
        if before is None or not all(a is b or _same(a, b) for a, b in zip(before[0], of, strict=True)):
            before = self._made[name] = of, make()
        return before[1]  # type: ignore[no-any-return]


def _same(a: object, b: object) -> bool:
    """Whether two plain values are equal; other objects are the same only when they are one."""
    return isinstance(a, (int, str, float)) and isinstance(b, (int, str, float)) and a == b


class Visuals:
    """Looks at the robot's side of a session."""

    def __init__(self, pilot: Pilot) -> None:
        self._pilot, self._cached = pilot, Cached()
        self._stale: tuple[object, int] | None = None
        self.shown: GoalSequence | None = None
        """The goals of the last task, if it had some."""

    def scan(self) -> Array | None:
        """Where the beams of the newest sweeps ended, (n, 2) in the map frame."""
        sweep, T_map_odom = self._pilot.sensing.sweep, self._pilot.T_map_odom
        if sweep is None:
            return None
        return self._cached.get("scan", (sweep, self._frame), lambda: T_map_odom @ sweep.around_odom)

    def particles(self) -> Array | None:
        """The cloud, (n, 3)."""
        localiser = self._pilot.localiser
        if localiser is None or not localiser.amcl.initialised:
            return None
        amcl = localiser.amcl
        assert isinstance(amcl, Amcl)
        return self._cached.get("particles", (amcl.watch, amcl.watch.updates), lambda: amcl.particles.xyt)

    def plan(self, path: SE2 | None) -> Array | None:
        """The global path, (n, 2), of a task that has one."""
        task = self._pilot.task
        if task is None or path is None:
            return None
        T = self._T_map_task(task)
        return self._cached.get("plan", (path, self._frame), lambda: T @ path.xy)

    def local(self, T_map_base: SE2, command: Twist) -> Array | None:
        """Where the command leads, (n, 2); None for one to stand still."""
        if command.v == 0.0 and command.w == 0.0:
            return None
        t = np.linspace(0.0, AHEAD_S, AHEAD_STEPS)
        yaw = command.w * t
        half = np.sinc(yaw / (2.0 * np.pi)) * command.v * t
        return T_map_base @ np.stack([half * np.cos(0.5 * yaw), half * np.sin(0.5 * yaw)], axis=1)

    def map(self, grid: OccupancyGrid | None) -> MapLayer | None:
        """The map that is loaded, or that grows."""
        if grid is None:
            return None
        return self._cached.get("map", (grid,), lambda: MapLayer(grid))

    def costmap(self) -> CostLayer | None:
        """What the robot plans on, with the obstacles that it sees."""
        layer = self._obstacle_layer()
        if layer is None:
            return None
        costmap, task, radius = layer.costmap, self._pilot.task, self._pilot.kit.robot.model.inscribed_radius
        T = SE2.identity() if task is None else self._T_map_task(task)
        return self._cached.get("costmap", (costmap, self._frame), lambda: CostLayer(costmap, T, radius))

    def sectors(self) -> SectorMarks | None:
        """The three sectors of the newest sweep."""
        sweep, task = self._pilot.sensing.sweep, self._pilot.task
        if sweep is None:
            return None
        s, decision = sweep.sectors, "" if task is None else task.decision
        return self._cached.get(
            "sectors", (s, decision), lambda: SectorMarks(s.left, s.front, s.right, decision)
        )

    def graph(self) -> Graph | None:
        """Key scans of the map that is being made, and what ties them together."""
        slam = self._pilot.slam
        if slam is None:
            return None
        of = (slam, len(slam.T_map_keys), len(slam.jumps))
        return self._cached.get("graph", of, lambda: graph_of_mapper(slam, 0).graph)

    def goals(self) -> tuple[GoalMark, ...]:
        """The goals of the last task and what has become of each in its last lap."""
        sequence = self.shown
        if sequence is None:
            return ()
        done, running = len(sequence.outcomes), sequence.goal is not None
        return self._cached.get("goals", (sequence, done, running), lambda: _marks(sequence))

    def waypoints(self, stops: tuple[Stop, ...]) -> tuple[Stop, ...]:
        """Waypoints being edited, with what stands in their way on the loaded map."""
        pilot = self._pilot
        if pilot.navigation is None:
            return stops
        costmap, model = pilot.navigation.tools.obstacles.static, pilot.kit.robot.model
        return self._cached.get(
            "waypoints", (stops, costmap), lambda: tuple(_checked(stop, costmap, model) for stop in stops)
        )

    def sure(self) -> float | None:
        """The share of the scans that the map explains; None while none has been compared."""
        pilot = self._pilot
        if pilot.localiser is not None:
            known = pilot.localised and self._updates != self._stale
            return pilot.localiser.amcl.agreement if known else None
        return None if pilot.slam is None else pilot.slam.fit

    def carried(self) -> None:
        """The last comparison of a scan with the map was made elsewhere."""
        self._stale = self._updates

    @property
    def _updates(self) -> tuple[object, int] | None:
        """The filter, and how many scans it has used."""
        localiser = self._pilot.localiser
        if localiser is None or not isinstance(localiser.amcl, Amcl):
            return None
        return localiser.amcl, localiser.amcl.watch.updates

    def lost(self) -> str | None:
        """Why the robot does not trust its pose; None when it does, or has none."""
        localiser, navigation = self._pilot.localiser, self._pilot.navigation
        if self._pilot.mapping and self._pilot.slam is not None:
            return "scans do not fit the map" if self._pilot.slam.lost else None
        if localiser is None or navigation is None or not localiser.amcl.initialised:
            return None
        machine = navigation.machine
        if self._pilot.task is not None and machine.within(State.LOST) and machine.state is not State.WIGGLE:
            return machine.state.value.replace("_", " ")
        if not localiser.amcl.converged:
            return "particles have not converged"
        return None if localiser.amcl.agrees else "scans disagree with the map"

    @property
    def _frame(self) -> object:
        """Stands for odometry's frame on the map: another object when that is another."""
        T = self._pilot.T_map_odom
        return self._cached.get("frame", tuple(T.xyt.tolist()), object)

    def _T_map_task(self, task: Task) -> SE2:
        """The frame that the driver of a task works in."""
        mapless = isinstance(task.driver, NavigationDriver) and task.driver.relocaliser is None
        return self._pilot.T_map_odom if mapless else SE2.identity()

    def _obstacle_layer(self) -> ObstacleLayer | None:
        driver = None if self._pilot.task is None else self._pilot.task.driver
        if isinstance(driver, NavigationDriver | ExploreDriver):
            return driver.tools.obstacles
        return None if self._pilot.navigation is None else self._pilot.navigation.tools.obstacles


def _checked(stop: Stop, costmap: Costmap, model: RobotModel) -> Stop:
    T_map_base = SE2.from_xyt(stop.x, stop.y, stop.yaw)
    if not on_map(costmap, T_map_base):
        return stop._replace(blocked="off the map")
    return stop if fits(costmap, model, T_map_base) else stop._replace(blocked=NO_ROOM)


def _marks(sequence: GoalSequence) -> tuple[GoalMark, ...]:
    lap = sequence.lap
    status = ["waiting"] * len(lap)
    first = max(sequence.index, 0) // len(lap) * len(lap)
    for outcome in sequence.outcomes:
        if outcome.index >= first:
            status[outcome.index % len(lap)] = outcome.status
    if sequence.goal is not None:
        status[sequence.index % len(lap)] = "active"
    return tuple(GoalMark(*goal.written, word) for goal, word in zip(lap, status, strict=True))
