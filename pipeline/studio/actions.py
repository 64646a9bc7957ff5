"""What each input does to the robot and its maps: refused in one line, or executed in full."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.plurals import counted
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.navigation.driver_setup import (
    DEFAULT_EXPLORE_S,
    MAX_SIMULATED_S,
    SINGLE_GOAL,
    require_floor,
)
from turtlebag.pipeline.navigation.drivers import make_avoider, make_explorer, make_mapless
from turtlebag.pipeline.navigation.initial_pose import require_free, require_on_map
from turtlebag.pipeline.navigation.navigator import NavigationDriver
from turtlebag.pipeline.studio import inputs
from turtlebag.pipeline.studio.pilot import Task, WiggleDriver, changes_only
from turtlebag.pipeline.studio.run import LoadedMap, Run
from turtlebag.planners.costmap import Costmap, costmap_from_grid, polygon_mask
from turtlebag.planners.tasks.patrol import GoalSequence
from turtlebag.planners.tasks.waypoints import Waypoint
from turtlebag.sim import shapes

BOX_HEIGHT_M, MOST_BOXES = 0.5, 100


def map_start(run: Run, action: inputs.Plain) -> str:
    """Start a new map; a loaded one is unloaded."""
    if run.pilot.mapping:
        raise InputError("map_start: mapping is already running; stop it first")
    run.end_task("ended: a new map was started")
    _new_map(run)
    return "mapping"


def map_stop(run: Run, action: inputs.Plain) -> str:
    """Stop mapping; the map can still be saved."""
    if not run.pilot.mapping:
        raise InputError("map_stop: mapping is not running")
    if run.pilot.task is not None and run.pilot.task.kind == "explore":
        raise InputError("map_stop: this map is being explored; cancel explore first")
    run.pilot.mapping = False
    return "mapping stopped"


def map_save(run: Run, action: inputs.Save) -> str:
    """Save the map made here, finished, or else the loaded one, with its keep-out areas."""
    library, mapper = run.shared.library, run.pilot.mapper
    grid = None if run.loaded is None else run.loaded.grid
    library.check_name(action.name)
    if mapper is not None:
        if not mapper.ready:
            raise InputError("map_save: the map is still empty; drive on a little")
        grid = mapper.finish()
    if grid is None:
        raise InputError("map_save: there is no map; start mapping and drive, or load one")
    library.save_map(action.name, grid, run.keepout)
    if mapper is not None:
        run.shared.publisher.map(run.stamp_ns, grid)
    return f"map {action.name} saved"


def map_load(run: Run, action: inputs.Load) -> str:
    """Load a map; the robot is not localised on it yet."""
    path, grid, saved = run.shared.library.load_map(action.name)
    keepout = run.shared.setup.arena.keepout if saved is None else saved
    costmap = _costmap(run, grid, keepout)
    run.end_task("ended: a map was loaded")
    run.loaded, run.keepout = LoadedMap(grid, action.name, path), keepout
    run.pilot.load(grid, costmap, run.stamp_ns)
    run.shared.trails.frame_changed()
    return f"map {action.name or path.stem} loaded"


def pose_estimate(run: Run, action: inputs.At) -> str:
    """Set the pose estimate."""
    navigation, loaded = _on_map(run, "pose_estimate")
    pose = SE2.from_xyt(*action.pose)
    require_on_map("pose_estimate", pose, navigation.tools.obstacles.static, loaded.path)
    navigation.locate(pose, run.observation.odometry.T_odom_base)
    run.shared.trails.frame_changed()
    x, y, yaw = action.pose
    return f"initial pose {x:.2f}, {y:.2f}, {yaw:.2f}"


def localise_global(run: Run, action: inputs.Plain) -> str:
    """Start global localisation."""
    navigation, loaded = _on_map(run, "localise_global")
    require_floor(loaded.grid, loaded.path)
    navigation.locate("global", run.observation.odometry.T_odom_base)
    run.shared.trails.frame_changed()
    return "global localisation: the robot may be anywhere on the map"


def goal(run: Run, action: inputs.At) -> str:
    """Drive to a goal: on the map if there is one, else mapless."""
    pilot, T_map_goal = run.pilot, SE2.from_xyt(*action.pose)
    if pilot.navigation is None:
        run.end_task("ended: another goal was set")
        goals = [Waypoint(pilot.T_map_odom.inverse() @ T_map_goal, "", action.pose)]
        sequence = _sequence(run, goals, SINGLE_GOAL)
        driver = make_mapless(pilot.kit, run.observation.odometry.T_odom_base, sequence)
        return _begin(run, Task("goal", run.stamp_ns, driver, sequence), "drive to a goal without a map")
    navigation, loaded = _localised(run, "goal")
    costmap = navigation.tools.obstacles.static
    require_free("goal", T_map_goal, costmap, pilot.kit.robot.model, loaded.path)
    run.end_task("ended: another goal was set")
    sequence = _sequence(run, [Waypoint(T_map_goal, "", action.pose)], SINGLE_GOAL)
    navigation.begin(sequence)
    return _begin(run, Task("goal", run.stamp_ns, navigation, sequence, on_map=True), "drive to a goal")


def patrol(run: Run, action: inputs.Patrol) -> str:
    """Patrol the waypoints."""
    navigation, _ = _localised(run, "patrol")
    run.end_task("ended: a patrol was started")
    stops = [Waypoint(SE2.from_xyt(*stop.pose), "", stop.pose, stop.wait) for stop in action.waypoints]
    sequence = _sequence(run, stops, {"laps": action.laps})
    navigation.begin(sequence)
    opening = f"patrol of {len(stops)} goals" + (f", {action.laps} laps" if action.laps > 1 else "")
    return _begin(run, Task("patrol", run.stamp_ns, navigation, sequence, on_map=True), opening)


def avoid(run: Run, action: inputs.Plain) -> str:
    """Drive about."""
    run.end_task("ended: avoid was started")
    end_s = seconds(run.stamp_ns) + MAX_SIMULATED_S
    driver = make_avoider(run.pilot.kit, end_s, changes_only(run.say))
    return _begin(run, Task("avoid", run.stamp_ns, driver), "drive around and avoid obstacles")


def explore(run: Run, action: inputs.Plain) -> str:
    """Explore: continues the current map."""
    run.end_task("ended: explore was started")
    if not run.pilot.mapping:
        _new_map(run)
    assert run.pilot.mapper is not None
    driver = make_explorer(run.pilot.kit, run.pilot.mapper, seconds(run.stamp_ns) + DEFAULT_EXPLORE_S)
    return _begin(run, Task("explore", run.stamp_ns, driver), "explore and map")


def wiggle(run: Run, action: inputs.Plain) -> str:
    """Turn back and forth."""
    _localised(run, "wiggle")
    run.end_task("ended: wiggle")
    assert run.pilot.localiser is not None
    task = Task("wiggle", run.stamp_ns, WiggleDriver(run.pilot.kit, run.pilot.localiser), on_map=True)
    return _begin(run, task, "wiggle until the particles converge")


def cancel(run: Run, action: inputs.Plain) -> str:
    """End the task."""
    if run.pilot.task is None:
        raise InputError("cancel: there is no task to cancel")
    run.end_task("cancelled")
    return ""


def waypoints_save(run: Run, action: inputs.WaypointsSave) -> str:
    """Save waypoints."""
    run.shared.library.save_waypoints(action.name, action.waypoints)
    return f"waypoints {action.name} saved"


def waypoints_load(run: Run, action: inputs.Load) -> str:
    """Show waypoints."""
    loaded = run.shared.library.load_waypoints(action.name)
    run.waypoints = tuple((*waypoint.written, waypoint.wait) for waypoint in loaded)
    return f"waypoints {action.name or 'from the tutorial'} loaded"


def kidnap(run: Run, action: inputs.At) -> str:
    """Kidnap the robot."""
    run.shared.simulator.carry(SE2.from_xyt(*action.pose))
    x, y, yaw = action.pose
    return f"kidnapped to {x:.2f}, {y:.2f}, {yaw:.2f}"


def box(run: Run, action: inputs.DropBox) -> str:
    """Drop a box."""
    if len(run.boxes) >= MOST_BOXES:
        raise InputError(f"box: the limit of {MOST_BOXES} boxes is reached")
    x, y = action.xy
    run.shared.simulator.drop(shapes.box("box", (x, y), (action.size, action.size), 0.0, (0.0, BOX_HEIGHT_M)))
    run.boxes = np.vstack([run.boxes, [x, y, action.size, action.size]])
    return f"box dropped at {x:.2f}, {y:.2f}"


def keepout(run: Run, action: inputs.Keepout) -> str:
    """Set the keep-out areas, replacing earlier ones."""
    outlines = tuple(np.array(outline, dtype=np.float64) for outline in action.outlines)
    if run.loaded is not None:
        costmap = _costmap(run, run.loaded.grid, outlines)
        for number, outline in enumerate(outlines, start=1):
            if not polygon_mask(costmap, outline).any():
                raise InputError(f"keepout {number}: outside the map; draw it on the map")
        run.pilot.keep_out(costmap)
    run.keepout = outlines
    return counted(len(outlines), "keep-out area")


ACTIONS: dict[str, Callable[[Run, Any], str]] = {
    act.__name__: act
    for act in (
        map_start, map_stop, map_save, map_load, pose_estimate, localise_global, goal, patrol, waypoints_save,
        waypoints_load, avoid, explore, wiggle, cancel, kidnap, box, keepout,
    )
}  # fmt: skip
"""The actions by `do`, except those of the session itself: bags, reset and end."""


def _begin(run: Run, task: Task, opening: str) -> str:
    run.begin(task)
    return opening


def _sequence(run: Run, goals: Sequence[Waypoint], changes: Mapping[str, float]) -> GoalSequence:
    return GoalSequence(goals, run.pilot.kit.config.sequence.model_copy(update=changes))


def _new_map(run: Run) -> None:
    run.loaded = run.shared.publisher.grid = None
    run.pilot.start_mapping()
    run.shared.trails.frame_changed()


def _costmap(run: Run, grid: OccupancyGrid, keepout: Sequence[Array]) -> Costmap:
    return costmap_from_grid(grid, run.shared.setup.config.costmap, keepout)


def _on_map(run: Run, what: str) -> tuple[NavigationDriver, LoadedMap]:
    """The driver on the loaded map, and the map; InputError without one."""
    if run.pilot.navigation is None or run.loaded is None:
        raise InputError(f"{what}: needs a map; load one first")
    return run.pilot.navigation, run.loaded


def _localised(run: Run, what: str) -> tuple[NavigationDriver, LoadedMap]:
    """The same, for a robot with a pose estimate."""
    found = _on_map(run, what)
    if not run.pilot.told:
        raise InputError(f"{what}: the robot is not localised; set a pose estimate first")
    return found
