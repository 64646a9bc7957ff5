"""Episodes of the navigation benchmark: each is a world, a robot, a request, all from one seed."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from datasets.grid import OccupancyGrid
from datasets.maps import save_map
from datasets.se2 import SE2
from datasets.seeds import stream
from pipeline.navigation.config import NavigateConfig
from pipeline.navigation.setup import Request
from planners.control.goal_checker import GoalCheckerConfig
from planners.costmap import CostmapConfig, costmap_from_grid
from planners.tasks.avoid import AvoidConfig
from sim.movers import Mover
from sim.robots import RobotSpec, load_robot
from sim.shapes import box, cylinder
from sim.worlds import World, load_world

ROOM_M = 0.05
"""Goals are reachable for the circumscribed radius and this."""


@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """One episode: `score` turns its metrics into a number where the scenario has one."""

    name: str
    seed: int
    world: World
    robot: RobotSpec
    request: Request
    config: NavigateConfig = dataclasses.field(default_factory=NavigateConfig)
    score: Callable[[dict], float] | None = None


def floor(world: World, robot: RobotSpec) -> tuple[OccupancyGrid, np.ndarray]:
    """The true map and its cells (n, 2) that the robot can reach from the spawn."""
    grid = world.rasterize(robot.lidar_height)
    costmap = costmap_from_grid(grid, CostmapConfig(), world.keepout)
    regions = costmap.regions(robot.model.circumscribed_radius + ROOM_M)
    row, col = grid.cell_of(world.spawn.xy)
    cells = np.argwhere(regions == regions[row, col]) if regions[row, col] else np.zeros((0, 2), int)
    return grid, cells


def pose_on(grid: OccupancyGrid, cells: np.ndarray, rng: np.random.Generator) -> SE2:
    x, y = grid.center_of(cells[rng.integers(len(cells))])
    return SE2.from_xyt(x, y, rng.uniform(-math.pi, math.pi))


def true_map(world: World, robot: RobotSpec, folder: Path) -> Path:
    name = "".join(c if c.isalnum() else "_" for c in f"{world.name}_{robot.name}")
    return save_map(world.rasterize(robot.lidar_height), folder, name)


def patrol(seeds: int, make_map: Callable[[], Path]) -> Iterator[Case]:
    """The tutorial's patrol on a map made by SLAM."""
    map_path = make_map()
    world, robot = load_world("turtlebot3_world"), load_robot("burger")
    for seed in range(seeds):
        request = Request(task="patrol", seed=seed, map_path=map_path, initial_pose="start")
        yield Case("patrol", seed, world, robot, request)


def goals(
    name: str, worlds: list[str], robots: list[str], count: int, maps: Callable[[World, RobotSpec], Path]
) -> Iterator[Case]:
    """Random reachable starts and goals, in turn over worlds and robots."""
    for seed in range(count):
        world = load_world(worlds[seed % len(worlds)])
        robot = load_robot(robots[(seed // len(worlds)) % len(robots)])
        grid, cells = floor(world, robot)
        rng = stream(seed, name)
        start, goal = pose_on(grid, cells, rng), pose_on(grid, cells, rng)
        yield Case(name, seed, world, robot, _goal(seed, maps(world, robot), start, goal))


def obstacles(name: str, count: int, maps: Callable[[World, RobotSpec], Path]) -> Iterator[Case]:
    """House goals among five boxes and three movers that are not on the map."""
    house = load_world("turtlebot3_house")
    for seed in range(count):
        robot = load_robot(("waffle_pi", "burger")[seed % 2])
        rng = stream(seed, name)
        grid, cells = floor(house, robot)
        while True:
            boxes = tuple(_box(k, grid, cells, rng) for k in range(5))
            world = dataclasses.replace(house, shapes=house.shapes + boxes)
            true_grid, free = floor(world, robot)
            # Boxes that shut off much of the house would make many goals unreachable.
            if len(free) > 0.7 * len(cells):
                break
        start, goal = pose_on(true_grid, free, rng), pose_on(true_grid, free, rng)
        movers = tuple(_mover(k, true_grid, free, start, rng) for k in range(3))
        world = dataclasses.replace(world, movers=movers)
        yield Case(name, seed, world, robot, _goal(seed, maps(house, robot), start, goal))


def avoid(mode: str, seeds: int, duration: float) -> Iterator[Case]:
    world, robot = load_world("turtlebot3_house"), load_robot("waffle_pi")
    gate = box("gate", (1.1123, -0.1749), (0.9, 0.15), 0.0, (0.0, 1.0))
    world = dataclasses.replace(world, shapes=(*world.shapes, gate))
    config = NavigateConfig(avoid=AvoidConfig(mode="tutorial" if mode == "tutorial" else "guarded"))
    grid, cells = floor(world, robot)
    for seed in range(seeds):
        start = pose_on(grid, cells, stream(seed, "avoid"))
        request = Request(task="avoid", seed=seed, start=start, duration_s=duration)
        yield Case(f"avoid {mode}", seed, world, robot, request, config)


def offsets(count: int, maps: Callable[[World, RobotSpec], Path]) -> Iterator[Case]:
    """House goals with an initial pose that is wrong by 0.5 m and 30 degrees."""
    for case in goals("initial pose off", ["turtlebot3_house"], ["waffle_pi"], count, maps):
        start = case.request.start
        assert start is not None
        angle = stream(case.seed, "offset").uniform(-math.pi, math.pi)
        wrong = start @ SE2.from_xyt(0.5 * math.cos(angle), 0.5 * math.sin(angle), math.radians(30.0))
        yield dataclasses.replace(case, request=dataclasses.replace(case.request, initial_pose=wrong))


def barn(runs: int) -> Iterator[Case]:
    """The BARN worlds found in TURTLEBAG_DATA/barn, mapless; none when there are none."""
    folder = Path(os.environ.get("TURTLEBAG_DATA", "")) / "barn"
    robot = load_robot("jackal")
    # The robot stops by its drifting odometry, the challenge judges by the truth: leave room between.
    checker = GoalCheckerConfig(xy_goal_tolerance=0.75, yaw_goal_tolerance=math.pi, stop=False, hold=0.0)
    config = NavigateConfig(goal_checker=checker)
    start = SE2.from_xyt(-2.25, 3.0, math.pi / 2.0)
    goal = SE2.from_xyt(-2.25, 13.0, math.pi / 2.0)
    paths = sorted(folder.glob("world_*.world"), key=lambda p: int(p.stem.split("_")[1]))
    for path in paths if os.environ.get("TURTLEBAG_DATA") else []:
        cells = np.load(path.with_name(path.stem.replace("world", "path") + ".npy"))
        inner = np.stack([0.15 * cells[:, 0] - 4.575, 0.15 * cells[:, 1] + 5.075], axis=1)
        whole = np.concatenate([start.xy[None], inner, goal.xy[None]])
        best = float(np.linalg.norm(np.diff(whole, axis=0), axis=1).sum()) / 2.0
        for run in range(runs):
            request = Request(task="goal", seed=run, start=start, goal=goal, timeout_s=100.0)
            world = load_world(str(path))
            yield Case(f"BARN {path.stem}", run, world, robot, request, config, _barn_score(best))


def _barn_score(best: float) -> Callable[[dict], float]:
    def score(metrics: dict) -> float:
        """Success (truly within 1 m) times OT over AT cut to 2 OT .. 8 OT (the challenge's formula)."""
        taken, error = metrics["goals"][0]["time_s"], metrics["goals"][0]["error_m"]
        arrived = metrics["success"] and error is not None and error <= 1.0
        return float(arrived) * best / min(max(taken, 2.0 * best), 8.0 * best)

    return score


def _goal(seed: int, map_path: Path, start: SE2, goal: SE2) -> Request:
    return Request(
        task="goal",
        seed=seed,
        map_path=map_path,
        initial_pose="start",
        start=start,
        goal=goal,
        timeout_s=300.0,
    )


def _box(k: int, grid: OccupancyGrid, cells: np.ndarray, rng: np.random.Generator):
    x, y = grid.center_of(cells[rng.integers(len(cells))])
    size = (float(rng.uniform(0.2, 0.5)), float(rng.uniform(0.2, 0.5)))
    return box(f"box_{k}", (float(x), float(y)), size, float(rng.uniform(-3.0, 3.0)), (0.0, 0.5))


def _mover(k: int, grid: OccupancyGrid, cells: np.ndarray, start: SE2, rng: np.random.Generator) -> Mover:
    while True:
        x, y = grid.center_of(cells[rng.integers(len(cells))])
        if math.hypot(x - start.x, y - start.y) > 1.5:
            break
    area = (x - 2.0, x + 2.0, y - 2.0, y + 2.0)
    return Mover(
        solid=cylinder(f"mover_{k}", (0.0, 0.0), 0.2, (0.0, 1.0)),
        path=np.array([[x, y]]),
        speed=0.3,
        wander=True,
        area=area,
        yields=True,
    )
