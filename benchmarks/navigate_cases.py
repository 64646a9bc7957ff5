"""Episodes of the navigation benchmark: each is a world, a robot and a request, all made from one seed."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from benchmarks.barn_kind import GOAL, START, barn_like
from benchmarks.drives import PLACES, Maps
from benchmarks.runner import public
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.seeds import stream
from turtlebag.pipeline.navigation.config import NavigateConfig
from turtlebag.pipeline.navigation.mission import Request
from turtlebag.planners.control.dwa import DwaConfig
from turtlebag.planners.control.goal_checker import GoalCheckerConfig
from turtlebag.planners.costmap import EIGHT_NEIGHBOURS, Costmap, CostmapConfig, costmap_from_grid
from turtlebag.planners.tasks.sector_rule import AvoidConfig
from turtlebag.planners.tasks.waypoints import tutorial_patrol
from turtlebag.reports.metrics.navigation import RunMetrics
from turtlebag.sim.faults import FaultConfig
from turtlebag.sim.robots import RobotSpec, load_robot
from turtlebag.sim.shapes import Solid, box
from turtlebag.sim.world import World
from turtlebag.sim.worlds import load_world

ARENA, HOUSE = (world for world, _ in PLACES.values())
ROOM_M = 0.05
"""Goals are reachable for the circumscribed radius and this."""
GOALS_PER_WORLD = 5
NEW_WORLDS_FROM = 7000
"""Generated worlds of the benchmark have numbers from here on: nothing else uses those."""
APART_M = 1.5
"""Nobody walks nearer than this to a robot that has just been put down."""
OFF_M, OFF_RAD = 0.5, math.radians(30.0)
FAR_M = 4.0
"""Goals of episodes with a fault are this far from the start: there is time for it."""
CARRIED_M = 1.5
DOORS = ((2.3, 0.4, 1), (2.3, 4.63, 1), (-6.3092, 0.925, 0), (6.2195, -0.175, 0))
"""Doors of the house: middle [m], and 1 for one in a wall along y. None has a way round."""
DOOR_M, THICK_M = 0.9, 0.15
CONTROLLERS = {
    "pursuit": NavigateConfig(),
    "dwa": NavigateConfig(controller="dwa"),
    "tutorial's dwa": NavigateConfig(
        controller="dwa",
        dwa=DwaConfig(preset="tutorial"),
        goal_checker=GoalCheckerConfig(preset="tutorial"),
    ),
}


@dataclasses.dataclass(frozen=True, eq=False)
class Trial:
    """One episode. `score` turns its metrics into a number where the scenario has one; `wanted` is the
    status that the goals should end with; `within` says how near [m, rad] one that counts as reached must
    truly be; `seen` is the share of the floor that must have been looked at in the end.
    """

    world: World
    robot: RobotSpec
    request: Request
    config: NavigateConfig = dataclasses.field(default_factory=NavigateConfig)
    score: Callable[[RunMetrics], float] | None = None
    wanted: str = "reached"
    within: tuple[float, float] = (0.05, math.radians(5.0))
    seen: float = 0.0

    @property
    def start(self) -> SE2:
        """Where the robot is put down."""
        return self.world.spawn if self.request.start is None else self.request.start

    def asked(self, **changes: Any) -> Trial:
        """The case with another request."""
        return dataclasses.replace(self, request=dataclasses.replace(self.request, **changes))

    def simulated(self, **changes: Any) -> Trial:
        """The case with other settings of the simulator, which the driver is not told of."""
        sim = self.config.sim.model_copy(update=changes)
        return dataclasses.replace(self, config=self.config.model_copy(update={"sim": sim}))


def regions_of(costmap: Costmap, radius: float) -> np.ndarray:
    """Labels (rows, cols), 0: blocked, of the parts of the floor that a disc of `radius` [m] can roam."""
    return np.asarray(scipy.ndimage.label(costmap.clearance > radius, structure=EIGHT_NEIGHBOURS)[0])


def floor(world: World, robot: RobotSpec) -> tuple[OccupancyGrid, np.ndarray]:
    """The true map and its cells (n, 2) that the robot can reach from the spawn."""
    grid = world.rasterize(robot.lidar_height)
    costmap = costmap_from_grid(grid, CostmapConfig(), world.keepout)
    regions = regions_of(costmap, robot.model.circumscribed_radius + ROOM_M)
    row, col = grid.cell_of(world.spawn.xy)
    cells = np.argwhere(regions == regions[row, col]) if regions[row, col] else np.zeros((0, 2), int)
    return grid, cells


@functools.lru_cache(maxsize=8)
def named_floor(world: str, robot: str) -> tuple[World, RobotSpec, OccupancyGrid, np.ndarray]:
    """A world and a robot by name, with `floor` of them."""
    loaded, spec = load_world(world), load_robot(robot)
    return loaded, spec, *floor(loaded, spec)


def pose_on(grid: OccupancyGrid, cells: np.ndarray, rng: np.random.Generator) -> SE2:
    """A pose on one of the cells."""
    x, y = grid.center_of(cells[rng.integers(len(cells))])
    return SE2.from_xyt(x, y, rng.uniform(-math.pi, math.pi))


def goal_case(
    seed: int, world: World, robot: RobotSpec, path: Path, start: SE2, goal: SE2, **more: Any
) -> Trial:
    """From a start that the robot is told to a goal on a map, with five minutes for it."""
    request = Request("goal", seed, path, initial_pose="start", start=start, goal=goal, timeout_s=300.0)
    return Trial(world, robot, request, **more)


def patrol(maps: Maps, name: str, seed: int) -> Trial:
    """The tutorial's patrol on a map made by SLAM."""
    world, robot = load_world(ARENA), load_robot("burger")
    path = maps.slam(ARENA, "burger")
    return Trial(world, robot, Request("patrol", seed, path, initial_pose="start"))


def house_robot(seed: int) -> str:
    """waffle_pi and burger in turn."""
    return ("waffle_pi", "burger")[seed % 2]


def new_world(seed: int) -> tuple[str, str]:
    """An office or a maze that is used for a few goals only, and the robot in it."""
    number = seed // GOALS_PER_WORLD
    world = f"{('office', 'maze')[number % 2]}:{NEW_WORLDS_FROM + number}"
    return world, ("burger", "waffle_pi")[number // 2 % 2]


def new_world_goal(maps: Maps, name: str, seed: int) -> Trial:
    """A random reachable start and goal in a world that is used for a few goals only."""
    return random_goal(maps, *new_world(seed), name, seed)


def random_goal(maps: Maps, world: str, robot: str, name: str, seed: int) -> Trial:
    """A random reachable start and goal on the map of a world."""
    loaded, spec, grid, cells = named_floor(world, robot)
    rng, path = stream(seed, name), maps.slam(world, robot)
    start, goal = pose_on(grid, cells, rng), pose_on(grid, cells, rng)
    return goal_case(seed, loaded, spec, path, start, goal)


def avoid(mode: str, duration: float, name: str, seed: int) -> Trial:
    """Avoidance in the house from a random start."""
    world, robot, grid, cells = named_floor(HOUSE, "waffle_pi")
    config = NavigateConfig(avoid=AvoidConfig(mode="tutorial" if mode == "tutorial" else "guarded"))
    start = pose_on(grid, cells, stream(seed, "avoid"))
    request = Request(task="avoid", seed=seed, start=start, duration_s=duration)
    return Trial(world, robot, request, config)


def explore(duration: float, name: str, seed: int) -> Trial:
    """A world that nothing is known of, mapped without a script, in `duration` [s] at most."""
    number = NEW_WORLDS_FROM + 500 + seed
    worlds = (ARENA, f"office:{number}", f"maze:{number}", HOUSE)
    world, robot, grid, cells = named_floor(worlds[seed % 4], ("burger", "waffle_pi")[seed // 4 % 2])
    start = pose_on(grid, cells, stream(seed, name))
    request = Request(task="explore", seed=seed, start=start, duration_s=duration)
    return Trial(world, robot, request, seen=0.95)


def obstacles(maps: Maps, yields: bool, name: str, seed: int) -> Trial:
    """House goals among five boxes and three people of the simulator's clutter; waffle_pi and burger in turn.

    Movers that do not yield walk on whoever stands in their way.
    """
    robot = load_robot(house_robot(seed))
    world = load_world(f"{HOUSE}+clutter:{seed},boxes=5,movers=3")
    movers = tuple(dataclasses.replace(mover, yields=yields) for mover in world.movers)
    world, rng = dataclasses.replace(world, movers=movers), stream(seed, name)
    grid, cells = floor(world, robot)
    start, goal = pose_on(grid, cells, rng), pose_on(grid, cells, rng)
    while min(np.linalg.norm(mover.path[0] - start.xy) for mover in movers) < APART_M:
        start = pose_on(grid, cells, rng)
    return goal_case(seed, world, robot, maps.slam(HOUSE, robot.name), start, goal)


def controlled(maps: Maps, place: str, controller: str, name: str, seed: int) -> Trial:
    """A random goal on the true map, the same for every controller."""
    world, robot, grid, cells = named_floor(*PLACES[place])
    rng = stream(seed, f"controllers {place}")
    start, goal = pose_on(grid, cells, rng), pose_on(grid, cells, rng)
    path, config = maps.true(place, grid), CONTROLLERS[controller]
    return goal_case(seed, world, robot, path, start, goal, config=config)


def barn_worlds() -> list[Path]:
    """The BARN worlds in TURTLEBAG_DATA/barn; none when that is not set."""
    folder = public("barn")
    found = folder.glob("world_*.world") if folder else ()
    return sorted(found, key=lambda p: int(p.stem.split("_")[1]))


def barn(worlds: list[Path], name: str, seed: int) -> Trial:
    """Seed s is run s // n of the n worlds, mapless."""
    path = worlds[seed % len(worlds)]
    cells = np.load(path.with_name(path.stem.replace("world", "path") + ".npy"))
    inner = np.stack([0.15 * cells[:, 0] - 4.575, 0.15 * cells[:, 1] + 5.075], axis=1)
    whole = np.concatenate([START.xy[None], inner, GOAL.xy[None]])
    length = float(np.linalg.norm(np.diff(whole, axis=0), axis=1).sum())
    return through_posts(dataclasses.replace(load_world(str(path)), name=path.stem), length, seed)


def barn_kind(name: str, seed: int) -> Trial:
    """A world of BARN's kind that is used once."""
    return through_posts(*barn_like(seed), seed)


def through_posts(world: World, length: float, seed: int) -> Trial:
    """BARN's challenge in a world through which the best way is this long [m]."""
    # The robot stops by its drifting odometry, the challenge judges by the truth: leave room between.
    checker = GoalCheckerConfig(xy_goal_tolerance=0.5, yaw_goal_tolerance=math.pi, stop=False, hold=0.0)
    config = NavigateConfig(goal_checker=checker)
    request = Request(task="goal", seed=seed, start=START, goal=GOAL, timeout_s=100.0)
    score = functools.partial(_barn_score, length / 2.0)
    return Trial(world, load_robot("jackal"), request, config, score, within=(1.0, math.pi))


def _barn_score(best: float, metrics: RunMetrics) -> float:
    """Success (truly within 1 m) times OT over AT cut to 2 OT .. 8 OT (the challenge's formula)."""
    taken, error = metrics["goals"][0]["time_s"], metrics["goals"][0]["error_m"]
    arrived = metrics["success"] and error is not None and error <= 1.0
    return float(arrived) * best / min(max(taken, 2.0 * best), 8.0 * best)


# Something goes wrong: in the arena (burger, the patrol), in the house (waffle_pi and burger in turn, a goal)
# or in a new world (a goal).


def drive_to(maps: Maps, place: str, name: str, seed: int) -> Trial:
    """What is done while the fault happens: the patrol in the arena, a far goal elsewhere."""
    if place == "arena":
        return patrol(maps, name, seed)
    world, robot = (HOUSE, house_robot(seed)) if place == "house" else new_world(seed)
    for attempt in range(1000):
        case = random_goal(maps, world, robot, name, seed + 100_000 * attempt)
        assert case.request.goal is not None
        if np.linalg.norm(case.start.xy - case.request.goal.xy) > FAR_M:
            return case.asked(seed=seed)
    raise ValueError("no two places so far apart")


def offset(maps: Maps, place: str, name: str, seed: int) -> Trial:
    """The robot is told a pose that is wrong by 0.5 m and 30 degrees."""
    case = drive_to(maps, place, name, seed)
    rng = stream(seed, "offset")
    angle, sign = rng.uniform(-math.pi, math.pi), rng.choice([-1.0, 1.0])
    wrong = case.start @ SE2.from_xyt(OFF_M * math.cos(angle), OFF_M * math.sin(angle), sign * OFF_RAD)
    return case.asked(initial_pose=wrong)


def kidnap(maps: Maps, place: str, name: str, seed: int) -> Trial:
    """Carried off once, 1.5 m or more."""
    case = drive_to(maps, place, name, seed)
    rng = stream(seed, "kidnap")
    grid, cells = allowed_floor(case, place)
    while np.linalg.norm((pose := pose_on(grid, cells, rng)).xy - case.start.xy) <= CARRIED_M:
        pass
    when = rng.uniform(20.0, 60.0) if place == "arena" else rng.uniform(6.0, 14.0)
    return case.simulated(faults=FaultConfig(kidnap=((when, *pose.xyt.tolist()),)))


def allowed_floor(case: Trial, place: str) -> tuple[OccupancyGrid, np.ndarray]:
    """Cells (n, 2) to be put down on: where the robot may be by its own keep-out areas."""
    if place != "arena":
        return named_floor(case.world.name, case.robot.name)[2:]
    grid = case.world.rasterize(case.robot.lidar_height)
    costmap = costmap_from_grid(grid, CostmapConfig(), tutorial_patrol().keepout)
    return grid, np.argwhere(costmap.clearance > case.robot.model.circumscribed_radius + 0.05)


def slip(maps: Maps, place: str, name: str, seed: int) -> Trial:
    """Twice for 2 s: both wheels lose 70 % of their turning, later one of them 60 %."""
    rng = stream(seed, "slip")
    first, second = rng.uniform(5.0, 10.0), rng.uniform(14.0, 20.0)
    one = (0.6, 0.0) if rng.random() < 0.5 else (0.0, 0.6)
    spans = ((first, first + 2.0, 0.7, 0.7), (second, second + 2.0, *one))
    return drive_to(maps, place, name, seed).simulated(faults=FaultConfig(slip=spans))


def dropout(maps: Maps, place: str, name: str, seed: int) -> Trial:
    """The lidar is silent for 2 s, twice."""
    rng = stream(seed, "dropout")
    first, second = rng.uniform(4.0, 10.0), rng.uniform(14.0, 20.0)
    spans = ((first, first + 2.0), (second, second + 2.0))
    return drive_to(maps, place, name, seed).simulated(faults=FaultConfig(scan_silent=spans))


def closed_ring(maps: Maps, name: str, seed: int) -> Trial:
    """The arena's ring is shut between two waypoints: the patrol must find the other way round."""
    rng = stream(seed, "door")
    # The patrol's minute for a waypoint is not enough for the long way.
    case = patrol(maps, name, seed).asked(timeout_s=150.0)
    x, y = (float(rng.choice([-1.0, 1.0])) * part for part in (0.75, 1.8))
    wall = box("shut_ring", (x, y), (0.1, 1.5), 0.0, (0.0, 0.5))  # from the pillars to the arena's wall
    return dataclasses.replace(case, world=with_solid(case.world, wall))


def closed_door(maps: Maps, name: str, seed: int) -> Trial:
    """The only door to the goal's part of the house, open on the map, is shut: to say so is right."""
    rng = stream(seed, "door")
    world, spec, grid, cells = named_floor(HOUSE, house_robot(seed))
    x, y, along_y = DOORS[seed // 2 % len(DOORS)]
    size = (THICK_M, DOOR_M) if along_y else (DOOR_M, THICK_M)
    shut = with_solid(world, box("shut_door", (x, y), size, 0.0, (0.0, 2.0)))
    _, outside = floor(shut, spec)
    inside = np.array(sorted({tuple(c) for c in cells.tolist()} - {tuple(c) for c in outside.tolist()}))
    # Not in the doorway itself.
    room = inside[np.hypot(*(grid.center_of(inside) - (x, y)).T) > 1.0]
    start, goal = pose_on(grid, outside, rng), pose_on(grid, room, rng)
    path = maps.slam(HOUSE, spec.name)
    return goal_case(seed, shut, spec, path, start, goal, wanted="unreachable")


def with_solid(world: World, solid: Solid) -> World:
    """The world with something in it that its map does not show."""
    return dataclasses.replace(world, shapes=(*world.shapes, solid))
