"""What there is to draw of a session at one instant.

Views are immutable: an array, layer or tuple that is the same object as in the previous view has not
changed, and anything changed is a new object.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.planners.costmap import INSCRIBED_COST, Costmap, inflated_cost
from turtlebag.sim.robots import RobotSpec
from turtlebag.sim.world import World

Level = Literal["info", "warning", "error"]
LETHAL, FADING = 254, 10.0
"""costmap_2d's cost of a cell that stops the robot, and its default for how fast costs fade [1/m]."""


class Event(NamedTuple):
    """A line of the event log; events are numbered from 1 on."""

    number: int
    t: float
    text: str
    level: Level


class GoalMark(NamedTuple):
    """A goal in the map frame and what became of it: `waiting`, `active`, or a status of metrics.json."""

    x: float
    y: float
    yaw: float
    status: str


class Stop(NamedTuple):
    """A waypoint being edited, in the map frame: its wait [s], None for that of patrols, and why the robot
    cannot stand there; empty if it can, or as long as no map is loaded."""

    x: float
    y: float
    yaw: float
    wait: float | None
    blocked: str = ""


class SectorMarks(NamedTuple):
    """The three sectors of the scan, least range in metres (inf: nothing), and what was decided by them."""

    left: float
    front: float
    right: float
    decision: str


class Path(NamedTuple):
    """Points (n, 2) in the map frame. While `version` stays, points are only added at the end."""

    version: int
    points: Array


NO_PATH = Path(0, np.zeros((0, 2)))


class Graph(NamedTuple):
    """Poses of the key scans (n, 3) in the map frame; edges (m, 3): from, to, 0 (step) or 1 (loop)."""

    nodes: Array
    edges: NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class MapLayer:
    """An occupancy grid as it is drawn."""

    grid: OccupancyGrid

    @property
    def resolution(self) -> float:
        """Side of a cell [m]."""
        return self.grid.resolution

    @property
    def origin(self) -> SE2:
        """Outer corner of cell (0, 0) in the map frame."""
        return self.grid.T_map_grid

    @cached_property
    def cells(self) -> NDArray[np.uint8]:
        """(rows, cols), row 0 lowest: 0 free to 100 occupied, 255 unknown."""
        return np.ascontiguousarray(self.grid.cells).view(np.uint8)


@dataclass(frozen=True, eq=False)
class CostLayer:
    """A costmap as it is drawn; its costs are worked out when they are asked for."""

    costmap: Costmap
    T_map_odom: SE2
    """The costmap's frame in the map frame: another only without a map, where it is odometry's."""
    inscribed_radius: float

    @property
    def resolution(self) -> float:
        """Side of a cell [m]."""
        return self.costmap.resolution

    @cached_property
    def origin(self) -> SE2:
        """Outer corner of cell (0, 0) in the map frame."""
        return self.T_map_odom @ self.costmap.T_map_grid

    @cached_property
    def cells(self) -> NDArray[np.uint8]:
        """(rows, cols), row 0 lowest: 0 free to 254 lethal."""
        beyond = self.costmap.clearance - self.inscribed_radius
        costs = np.where(beyond <= 0.0, INSCRIBED_COST, inflated_cost(beyond, FADING))
        return np.where(self.costmap.lethal, LETHAL, costs).astype(np.uint8)


@dataclass(frozen=True, eq=False, kw_only=True)
class Scene:
    """What stays the same for a whole session; where a bag is played there is neither robot nor world."""

    world: str
    robot: str = ""
    seed: int = 0
    max_v: float = 0.0
    max_w: float = 0.0
    bounds: tuple[float, float, float, float]
    """x_min, y_min, x_max, y_max of the world [m]."""
    outline: Array
    """Of the robot, (k, 2) in the base frame."""
    world_segments: Array = field(default_factory=lambda: np.zeros((0, 4)))
    """Of everything the robot can touch: (n, 4) x0, y0, x1, y1."""
    world_circles: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """(m, 3) x, y, radius."""

    @staticmethod
    def of(world: World, robot: RobotSpec, seed: int) -> Scene:
        """The scene of a robot in a world."""
        x_min, x_max, y_min, y_max = world.bounds
        solid, limits = world.touchable(robot.height), robot.limits
        return Scene(
            world=world.name,
            robot=robot.name,
            seed=seed,
            max_v=limits.max_v,
            max_w=limits.max_w,
            bounds=(x_min, y_min, x_max, y_max),
            outline=robot.model.footprint,
            world_segments=solid.segments,
            world_circles=solid.circles,
        )


class LoopMarks(NamedTuple):
    """Two scans overlaid by a loop: end points of their beams, (n, 2) and (m, 2)."""

    scan: int
    place: int
    scan_points: Array
    place_points: Array
    told: str
    """How the loop was found, and its residual."""


class EditMark(NamedTuple):
    """An edit: `reject` or `add`, of scan and place; or `draw` or `erase`, of the wall near a scan."""

    kind: str
    scan: int
    place: int | None = None


@dataclass(frozen=True, eq=False)
class BagMarks:
    """The state of a played bag."""

    position_s: float
    duration_s: float
    keys: NDArray[np.int64]
    """The scan of each node of the graph."""
    loop: LoopMarks | None
    edits: tuple[EditMark, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class View:
    """A session now; everything is in the map frame unless its name says otherwise.

    What is left out is not there: where a bag is played there is nothing to drive.
    """

    stamp_ns: int
    owner: str = "navigation"
    """Whose commands the robot gets: `navigation` or `teleop`."""
    command: tuple[float, float] = (0.0, 0.0)
    """v, w [m/s, rad/s] of the last tick."""
    task: str = ""
    """The current task: `goal`, `patrol`, `avoid`, `explore`, `wiggle`, or empty."""
    state: str
    """Its state in a word or two."""
    recording: str | None = None
    """Name of the bag that is open."""
    mapping: bool
    map_name: str | None = None
    """Name of the map that is loaded; empty for the one the session was started with."""
    maps: tuple[str, ...]
    """Names of the maps that can be loaded; empty for the one the session was started with."""
    waypoint_files: tuple[str, ...] = ()
    bags: tuple[str, ...] = ()
    """Names of the bags recorded so far."""
    waypoints: tuple[Stop, ...] = ()
    """Those being edited, the same on every page."""
    localised: bool = False
    """Whether there is a pose on a map."""
    sure: float | None = None
    """Share of the scans that the map explains, 0 to 1."""
    lost: str | None = None
    """Why the robot does not trust its pose; None when it does."""
    T_map_base: SE2
    T_odom_base: SE2
    T_world_base: SE2
    """The truth, for the ghost alone."""
    goals: tuple[GoalMark, ...] = ()
    goal_index: int = -1
    """Of the goal that is pursued, -1 for none."""
    goal: tuple[float, float, float] | None = None
    """The goal that is pursued."""
    sectors: SectorMarks | None = None
    events: tuple[Event, ...]
    """The last ones, oldest first."""
    scan: Array | None
    """Where beams of the newest sweep ended, (n, 2)."""
    particles: Array | None = None
    """(n, 3)."""
    plan: Array | None = None
    """The global path, (n, 2)."""
    local: Array | None = None
    """Where the present command leads, (n, 2)."""
    odom_path: Path
    slam_path: Path
    """The robot's estimated path."""
    true_path: Path = NO_PATH
    graph: Graph | None
    boxes: Array | None = None
    """Boxes that were dropped: (n, 4) x, y of the middle, length along x, width along y."""
    keepout: tuple[Array, ...] = ()
    """Keep-out outlines (k, 2)."""
    mover_segments: Array | None = None
    """Of what moves in the true world, for the ghost alone: (n, 4), see `Scene`."""
    mover_circles: Array | None = None
    """(m, 3)."""
    map: MapLayer | None
    costmap: CostLayer | None = None
    bag: BagMarks | None = None
