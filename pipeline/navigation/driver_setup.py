"""Turns the options of `navigate` into a driver; bad goals and maps are refused here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.durations import LONGEST_S
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import FREE, OCCUPIED, OccupancyGrid
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.parts import find, is_own
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Observation
from turtlebag.pipeline.navigation.config import NavigateConfig
from turtlebag.pipeline.navigation.driver import Task
from turtlebag.pipeline.navigation.drivers import (
    make_avoider,
    make_explorer,
    make_mapless,
    make_navigator,
)
from turtlebag.pipeline.navigation.goal_states import State
from turtlebag.pipeline.navigation.initial_pose import require_free, require_on_map
from turtlebag.pipeline.navigation.kit import Kit
from turtlebag.pipeline.navigation.mission import Mission, Request
from turtlebag.pipeline.navigation.online_map import OnlineMap
from turtlebag.pipeline.navigation.sensing import Sensing
from turtlebag.pipeline.navigation.teleop_override import load_script
from turtlebag.pipeline.terminal.messages import log_notes, note_degrees
from turtlebag.planners.costmap import Area, costmap_from_grid
from turtlebag.planners.tasks.patrol import GoalSequence
from turtlebag.planners.tasks.waypoints import Waypoint, WaypointFile, load_waypoints, tutorial_patrol
from turtlebag.sim.robots import RobotSpec

# Simulated seconds: of avoid, and of explore at most, where none were asked for; of any run at most.
DEFAULT_DURATION_S, DEFAULT_EXPLORE_S, MAX_SIMULATED_S = 60.0, 1800.0, 4 * 3600.0
MAX_LAPS = 1000
SINGLE_GOAL = {"initial_wait": 0.0, "timeout": 600.0}
"""Of a sequence's configuration, what is other for a goal that is not one of many."""


def prepare(
    request: Request, robot: RobotSpec, config: NavigateConfig, keepout: Sequence[Area] = ()
) -> Mission:
    """Check a request and load its files; InputError before anything is written.

    `keepout` are the world's own outlines, (n, 2) each; those of the waypoints file are added.
    """
    if request.duration_s is not None and request.duration_s > MAX_SIMULATED_S:
        raise InputError(f"--duration {request.duration_s:g}: at most {MAX_SIMULATED_S:g} s are simulated")
    if request.timeout_s is not None and request.timeout_s > LONGEST_S:
        raise InputError(f"--timeout {request.timeout_s:g}: at most {LONGEST_S:g} s")
    config = config.model_copy(update={"sim": config.sim.resolved(robot)})
    if isinstance(request.teleop_override, Path):
        load_script(request.teleop_override)
    if request.laps is not None and request.laps > MAX_LAPS:
        raise InputError(f"--laps {request.laps}: at most {MAX_LAPS}")
    if request.task in ("avoid", "explore"):
        return Mission(request, config, robot, None, None, ())
    own = is_own(request.task)
    if own and request.map_path is None:
        return Mission(request, config, robot, None, None, ())
    places = WaypointFile(()) if own and request.waypoints_path is None else _places(request)
    if request.map_path is None and request.task == "goal" and request.goal is not None:
        return Mission(request, _with_options(config, request), robot, None, None, places.waypoints)
    if request.map_path is None:
        raise InputError(f"--task {request.task}: needs --map MAP.yaml")
    grid = load_map(request.map_path)
    require_walls_and_floor(grid, request.map_path)
    outlines = keepout if request.keepout is None else request.keepout
    costmap = costmap_from_grid(grid, config.costmap, [*outlines, *places.keepout])
    if isinstance(request.initial_pose, SE2):
        # In a wall it may be: the robot then looks about.
        require_on_map("--initial-pose", request.initial_pose, costmap, request.map_path)
    if request.goal is not None:
        require_free("--goal", request.goal, costmap, robot.model, request.map_path)
    return Mission(request, _with_options(config, request), robot, grid, costmap, places.waypoints)


def require_walls_and_floor(grid: OccupancyGrid, path: Path) -> None:
    """InputError when the robot could not find itself on the map, or not be searched for."""
    if not (grid.cells >= OCCUPIED).any():
        raise InputError(f"{path}: has no occupied cell, so no scan can be compared with it")
    if not (grid.cells == FREE).any():
        raise InputError(f"{path}: has no free cell, so there is nowhere to search for the robot")


def _places(request: Request) -> WaypointFile:
    if request.task == "goal":
        if request.goal is None:
            raise InputError("--task goal: needs --goal X,Y,YAW")
        x, y, yaw = request.goal.xyt.tolist()
        return WaypointFile((Waypoint(request.goal, "", (x, y, yaw)),))
    if request.waypoints_path is None:
        return tutorial_patrol()
    places = load_waypoints(request.waypoints_path)
    log_notes(places.notes)
    for number, waypoint in enumerate(places.waypoints, start=1):
        if waypoint.T_map_goal is not None:
            note_degrees(f"waypoint {number}", waypoint.written[2])
    return places


def _with_options(config: NavigateConfig, request: Request) -> NavigateConfig:
    """Command-line options over the configuration; a single goal has no wait before it."""
    changes: dict[str, float | int] = {}
    if request.task == "goal":
        changes.update(SINGLE_GOAL)
    if request.timeout_s is not None:
        changes["timeout"] = request.timeout_s
    if request.laps is not None:
        changes["laps"] = request.laps
    return config.model_copy(update={"sequence": config.sequence.model_copy(update=changes)})


def make_driver(
    mission: Mission, first: Observation, publisher: BagWriter, say: Callable[[str], None]
) -> Task:
    """The driver of a mission, at the first observation."""
    request, config, robot = mission.request, mission.config, mission.robot
    kit = Kit(robot, config, request.seed, Sensing.of(robot), publisher)
    if is_own(request.task):
        task: Task = find(request.task, Task)(kit, mission)
        return task
    if request.task == "avoid":
        return make_avoider(kit, request.duration_s or DEFAULT_DURATION_S, say)
    if request.task == "explore":
        online = OnlineMap(robot.T_base_lidar, config.explore.slam, kit.lidars())
        return make_explorer(kit, online, request.duration_s or DEFAULT_EXPLORE_S)
    sequence, T_odom_base = GoalSequence(mission.waypoints, config.sequence), first.odometry.T_odom_base
    if mission.grid is None or mission.costmap is None:
        return make_mapless(kit, T_odom_base, sequence)
    wiggles = request.initial_pose is not None and (request.wiggle or request.initial_pose == "global")
    state = State.WIGGLE if wiggles else State.WAIT
    driver = make_navigator(kit, mission.grid, mission.costmap, sequence, state)
    assert driver.localiser is not None
    driver.localiser.tell(request.initial_pose, T_odom_base)
    publisher.map(first.stamp_ns, mission.grid)
    return driver
