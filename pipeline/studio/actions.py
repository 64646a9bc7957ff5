"""What each input does to the robot, its maps and bags: refused in one line, or executed in full."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from turtlebag.datasets.bags.footprint import footprint_text
from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.durations import seconds
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import sha256_text
from turtlebag.datasets.plurals import counted
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist
from turtlebag.datasets.yaml_files import config_text
from turtlebag.pipeline.navigation.driver_setup import (
    DEFAULT_EXPLORE_S,
    MAX_SIMULATED_S,
    SINGLE_GOAL,
)
from turtlebag.pipeline.navigation.drivers import make_avoider, make_explorer, make_mapless
from turtlebag.pipeline.navigation.initial_pose import require_free, require_on_map
from turtlebag.pipeline.navigation.navigator import NavigationDriver
from turtlebag.pipeline.studio import inputs
from turtlebag.pipeline.studio.pilot import Task, WiggleDriver, changes_only
from turtlebag.pipeline.studio.robot import LoadedMap, Robot
from turtlebag.pipeline.studio.view import Stop
from turtlebag.planners.costmap import polygon_mask
from turtlebag.planners.tasks.patrol import GoalSequence
from turtlebag.planners.tasks.waypoints import Waypoint
from turtlebag.sim import shapes
from turtlebag.sim.robots import static_transforms

BOX_HEIGHT_M, MOST_BOXES = 0.5, 100


def act(robot: Robot, entry: inputs.Input) -> str:
    """Do what is asked for; returns what there is to tell of it. InputError when it cannot be done."""
    if entry.do not in ACTIONS:
        raise InputError(f"{entry.do}: no bag is being played; start the studio with --bag BAG")
    return ACTIONS[entry.do](robot, entry)


def drive(robot: Robot, action: inputs.Drive) -> str:
    """Teleop."""
    robot.by_hand = Twist(action.v, action.w)
    return ""


def stop(robot: Robot, action: inputs.Plain) -> str:
    """Teleop at zero speed."""
    robot.by_hand = Twist()
    return ""


def release(robot: Robot, action: inputs.Plain) -> str:
    """End teleop."""
    robot.by_hand = None
    return ""


def record(robot: Robot, action: inputs.Save) -> str:
    """Begin a bag."""
    if robot.recording is not None:
        raise InputError(f"record: {robot.recording[0]} is being recorded; stop it first")
    setup, publisher, folder = robot.setup, robot.publisher, robot.folder / "bags" / action.name
    if folder.exists():
        raise InputError(f"record: a bag {action.name} already exists; choose another name")
    custom = {
        "seed": str(setup.seed),
        "config_sha256": sha256_text(config_text(setup.config)),
        "world": setup.arena.name,
        "task": "studio",
        **footprint_text(setup.spec.model.footprint),
    }
    bag = BagWriter(folder, custom=custom, lidars=setup.spec.lidars)
    robot.recording, publisher.bag = (action.name, bag), bag
    robot.bags = (*robot.bags, action.name)
    bag.static_transforms(robot.stamp_ns, static_transforms(setup.spec))
    if publisher.grid is not None:
        bag.map(robot.stamp_ns, publisher.grid)
    if robot.owner.owner == "teleop":
        bag.owner(robot.stamp_ns, "teleop")
    return f"recording {action.name}"


def record_stop(robot: Robot, action: inputs.Plain) -> str:
    """Close the bag."""
    if robot.recording is None:
        raise InputError("record_stop: nothing is being recorded")
    name, bag = robot.recording
    robot.recording = robot.publisher.bag = None
    bag.close()
    return f"bag {name} recorded"


def reset(robot: Robot, action: inputs.Plain) -> str:
    """Start again, on the map that was given."""
    _finish(robot, "ended: reset")
    robot.restart()
    return "reset: the robot is back at its start"


def end(robot: Robot, action: inputs.Plain) -> str:
    """End the session."""
    _finish(robot, "ended with the session")
    return "the session is over"


def map_start(robot: Robot, action: inputs.Plain) -> str:
    """Start a new map; a loaded one is unloaded."""
    if robot.pilot.mapping:
        raise InputError("map_start: mapping is already running; stop it first")
    robot.end_task("ended: a new map was started")
    _new_map(robot)
    return "mapping"


def map_stop(robot: Robot, action: inputs.Plain) -> str:
    """Stop mapping; the map can still be saved."""
    if not robot.pilot.mapping:
        raise InputError("map_stop: mapping is not running")
    if robot.pilot.task is not None and robot.pilot.task.kind == "explore":
        raise InputError("map_stop: this map is being explored; cancel explore first")
    robot.pilot.mapping = False
    return "mapping stopped"


def map_save(robot: Robot, action: inputs.Save) -> str:
    """Save the map made here, finished, or else the loaded one, with its keep-out areas."""
    library, mapper = robot.library, robot.pilot.mapper
    grid = None if robot.loaded is None else robot.loaded.grid
    library.check_name(action.name)
    if mapper is not None:
        if not mapper.ready:
            raise InputError("map_save: the map is still empty; drive on a little")
        grid = mapper.finish()
    if grid is None:
        raise InputError("map_save: there is no map; start mapping and drive, or load one")
    library.save_map(action.name, grid, robot.keepout)
    if mapper is not None:
        robot.publisher.map(robot.stamp_ns, grid)
    return f"map {action.name} saved"


def map_load(robot: Robot, action: inputs.Load) -> str:
    """Load a map; the robot is not localised on it yet."""
    loaded = robot.load_map(action.name)
    return f"map {action.name or loaded.path.stem} loaded"


def pose_estimate(robot: Robot, action: inputs.At) -> str:
    """Set the pose estimate."""
    navigation, loaded = _on_map(robot, "pose_estimate")
    pose = SE2.from_xyt(*action.pose)
    require_on_map("pose_estimate", pose, navigation.tools.obstacles.static, loaded.path)
    navigation.locate(pose, robot.observation.odometry.T_odom_base)
    robot.trails.frame_changed()
    x, y, yaw = action.pose
    return f"initial pose {x:.2f}, {y:.2f}, {yaw:.2f}"


def localise_global(robot: Robot, action: inputs.Plain) -> str:
    """Start global localisation."""
    navigation, _ = _on_map(robot, "localise_global")
    navigation.locate("global", robot.observation.odometry.T_odom_base)
    robot.trails.frame_changed()
    return "global localisation: the robot may be anywhere on the map"


def goal(robot: Robot, action: inputs.At) -> str:
    """Drive to a goal: on the map if there is one, else mapless."""
    pilot, T_map_goal = robot.pilot, SE2.from_xyt(*action.pose)
    if pilot.navigation is None:
        robot.end_task("ended: another goal was set")
        goals = [Waypoint(pilot.T_map_odom.inverse() @ T_map_goal, "", action.pose)]
        sequence = _sequence(robot, goals, SINGLE_GOAL)
        driver = make_mapless(pilot.kit, robot.observation.odometry.T_odom_base, sequence)
        return _begin(robot, Task("goal", robot.stamp_ns, driver, sequence), "drive to a goal without a map")
    navigation, loaded = _localised(robot, "goal")
    costmap = navigation.tools.obstacles.static
    require_free("goal", T_map_goal, costmap, pilot.kit.robot.model, loaded.path)
    robot.end_task("ended: another goal was set")
    sequence = _sequence(robot, [Waypoint(T_map_goal, "", action.pose)], SINGLE_GOAL)
    navigation.begin(sequence)
    return _begin(robot, Task("goal", robot.stamp_ns, navigation, sequence, on_map=True), "drive to a goal")


def patrol(robot: Robot, action: inputs.Patrol) -> str:
    """Patrol the waypoints."""
    navigation, _ = _localised(robot, "patrol")
    robot.end_task("ended: a patrol was started")
    stops = [Waypoint(SE2.from_xyt(*stop.pose), "", stop.pose, stop.wait) for stop in action.waypoints]
    sequence = _sequence(robot, stops, {"laps": action.laps})
    navigation.begin(sequence)
    opening = f"patrol of {len(stops)} goals" + (f", {action.laps} laps" if action.laps > 1 else "")
    return _begin(robot, Task("patrol", robot.stamp_ns, navigation, sequence, on_map=True), opening)


def avoid(robot: Robot, action: inputs.Plain) -> str:
    """Drive about."""
    robot.end_task("ended: avoid was started")
    end_s = seconds(robot.stamp_ns) + MAX_SIMULATED_S
    driver = make_avoider(robot.pilot.kit, end_s, changes_only(robot.say))
    return _begin(robot, Task("avoid", robot.stamp_ns, driver), "drive around and avoid obstacles")


def explore(robot: Robot, action: inputs.Plain) -> str:
    """Explore: continues the current map."""
    robot.end_task("ended: explore was started")
    if not robot.pilot.mapping:
        _new_map(robot)
    assert robot.pilot.mapper is not None
    driver = make_explorer(robot.pilot.kit, robot.pilot.mapper, seconds(robot.stamp_ns) + DEFAULT_EXPLORE_S)
    return _begin(robot, Task("explore", robot.stamp_ns, driver), "explore and map")


def wiggle(robot: Robot, action: inputs.Plain) -> str:
    """Turn back and forth."""
    _localised(robot, "wiggle")
    robot.end_task("ended: wiggle")
    assert robot.pilot.localiser is not None
    task = Task("wiggle", robot.stamp_ns, WiggleDriver(robot.pilot.kit, robot.pilot.localiser), on_map=True)
    return _begin(robot, task, "wiggle until the particles converge")


def cancel(robot: Robot, action: inputs.Plain) -> str:
    """End the task."""
    if robot.pilot.task is None:
        raise InputError("cancel: there is no task to cancel")
    robot.end_task("cancelled")
    return ""


def waypoints(robot: Robot, action: inputs.Waypoints) -> str:
    """Show the waypoints of a page to all of them."""
    robot.waypoints = tuple(Stop(*stop.pose, stop.wait) for stop in action.waypoints)
    return ""


def waypoints_save(robot: Robot, action: inputs.WaypointsSave) -> str:
    """Save waypoints."""
    robot.library.save_waypoints(action.name, action.waypoints)
    return f"waypoints {action.name} saved"


def waypoints_load(robot: Robot, action: inputs.Load) -> str:
    """Show waypoints."""
    loaded = robot.library.load_waypoints(action.name)
    robot.waypoints = tuple(Stop(*waypoint.written, waypoint.wait) for waypoint in loaded)
    return f"waypoints {action.name or 'from the tutorial'} loaded"


def kidnap(robot: Robot, action: inputs.At) -> str:
    """Kidnap the robot."""
    robot.simulator.carry(SE2.from_xyt(*action.pose))
    robot.carried()
    x, y, yaw = action.pose
    return f"kidnapped to {x:.2f}, {y:.2f}, {yaw:.2f}"


def box(robot: Robot, action: inputs.DropBox) -> str:
    """Drop a box."""
    if len(robot.boxes) >= MOST_BOXES:
        raise InputError(f"box: the limit of {MOST_BOXES} boxes is reached")
    x, y = action.xy
    robot.simulator.drop(shapes.box("box", (x, y), (action.size, action.size), 0.0, (0.0, BOX_HEIGHT_M)))
    robot.boxes = np.vstack([robot.boxes, [x, y, action.size, action.size]])
    return f"box dropped at {x:.2f}, {y:.2f}"


def keepout(robot: Robot, action: inputs.Keepout) -> str:
    """Set the keep-out areas, replacing earlier ones."""
    outlines = tuple(np.array(outline, dtype=np.float64) for outline in action.outlines)
    if robot.loaded is not None:
        costmap = robot.costmap(robot.loaded.grid, outlines)
        for number, outline in enumerate(outlines, start=1):
            if not polygon_mask(costmap, outline).any():
                raise InputError(f"keepout {number}: outside the map; draw it on the map")
        robot.pilot.keep_out(costmap)
    robot.keepout = outlines
    return counted(len(outlines), "keep-out area")


ACTIONS: dict[str, Callable[[Robot, Any], str]] = {
    act.__name__: act
    for act in (
        drive, stop, release, record, record_stop, reset, end, map_start, map_stop, map_save, map_load,
        pose_estimate, localise_global, goal, patrol, waypoints, waypoints_save, waypoints_load, avoid,
        explore, wiggle, cancel, kidnap, box, keepout,
    )
}  # fmt: skip
"""The actions by `do`."""


def _finish(robot: Robot, why: str) -> None:
    robot.end_task(why)
    if robot.recording is not None:
        robot.say(record_stop(robot, inputs.Plain(do="record_stop")))


def _begin(robot: Robot, task: Task, opening: str) -> str:
    robot.begin(task)
    return opening


def _sequence(robot: Robot, goals: Sequence[Waypoint], changes: Mapping[str, float]) -> GoalSequence:
    return GoalSequence(goals, robot.pilot.kit.config.sequence.model_copy(update=changes))


def _new_map(robot: Robot) -> None:
    robot.loaded = robot.publisher.grid = None
    robot.pilot.start_mapping()
    robot.trails.frame_changed()


def _on_map(robot: Robot, what: str) -> tuple[NavigationDriver, LoadedMap]:
    """The driver on the loaded map, and the map; InputError without one."""
    if robot.pilot.navigation is None or robot.loaded is None:
        raise InputError(f"{what}: needs a map; load one first")
    return robot.pilot.navigation, robot.loaded


def _localised(robot: Robot, what: str) -> tuple[NavigationDriver, LoadedMap]:
    """The same, for a robot with a pose estimate."""
    found = _on_map(robot, what)
    if not robot.pilot.told:
        raise InputError(f"{what}: the robot is not localised; set a pose estimate first")
    return found
