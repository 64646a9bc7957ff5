"""The steps of the command line as functions: same stages, same settings, same bytes.

All of them take `out`, a folder for the result (it must not exist, unless `force` replaces it); without it
nothing is kept. `config` is a YAML file of settings, and `settings` changes single ones by their dotted
names, as `--config` and `--set` do: `{"loops.match": "open3d"}`. For a part of your own, pass its class.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from turtlebag.api import given
from turtlebag.api.given import PathLike, Pose
from turtlebag.api.making import TemporaryFolder, step
from turtlebag.api.other_systems import Systems, system_options
from turtlebag.api.outputs import Bag, Map, as_map, robot_for
from turtlebag.api.results import Comparison, Localisation, Plan, Report, Run
from turtlebag.api.tasks import Avoid, Explore, Patrol, Task, keepout_option, task_options
from turtlebag.datasets.errors import InputError
from turtlebag.reports.system_comparison import SystemComparison

Settings = Mapping[str, Any]


def record(
    world: PathLike | type,
    robot: PathLike | None = None,
    *,
    teleop: PathLike = "tour",
    seed: int = 1,
    start: Pose | None = None,
    config: PathLike | None = None,
    settings: Settings | None = None,
    out: PathLike | None = None,
    force: bool = False,
) -> Bag:
    """Drive a simulated robot and record its sensor data.

    `world` is a name, a file or a class, `robot` a name or a file (default: the world's own), `teleop` a
    script, or a bag whose commands are replayed; `start` is the true pose in the world. If the robot gets
    stuck, the recording is kept, and its `notes` say so. InputError for unknown names and a start in an
    obstacle.
    """
    told = {
        "world": given.text(given.part(world), "world"),
        "robot": None if robot is None else given.text(robot, "robot"),
        "teleop": given.text(teleop, "teleop"),
        "seed": given.seed(seed),
        "start": None if start is None else given.pose(start, "start"),
    }
    words = given.settings(settings)
    with step("record", out, force=force, inputs={"teleop": teleop, "config": config}) as now:
        now.run(**told, config=config, set=words)
        return Bag.of(now)


def map(
    source: PathLike,
    *,
    front_end: str | type | None = None,
    truth: PathLike | None = None,
    relations: PathLike | None = None,
    also: Sequence[PathLike] = (),
    continued: PathLike | None = None,
    laser: Pose | None = None,
    upside_down: bool = False,
    topic: str | None = None,
    edits: PathLike | None = None,
    explain: bool = False,
    config: PathLike | None = None,
    settings: Settings | None = None,
    out: PathLike | None = None,
    force: bool = False,
) -> Map:
    """Build a map from a recording: a Bag, a folder, a bag file or a CARMEN log.

    `front_end` is a name or a class (its contract is `turtlebag.pipeline.slam.front_end`). `truth` (a
    recording) and `relations` (a benchmark's file) only add error metrics. `also` are later recordings of the
    same place, `continued` an earlier map that the recording is added to. `laser` and `upside_down` override
    the laser's pose on the robot. InputError for what cannot be mapped.
    """
    words, placed = given.settings(settings, front_end=front_end), given.laser(laser, upside_down)
    heard = None if topic is None else given.text(topic, "topic", "a name")
    later = {f"also {number}": one for number, one in enumerate(given.items(also, "also"), start=1)}
    files = {"truth": truth, "relations": relations, "config": config, "edits": edits}
    told: dict[str, Any] = {**files, "also": [*later.values()], "continue": continued}
    told |= {"topic": heard, "set": words, "explain": explain, "laser": placed}
    inputs = {"source": source, **files, **later, "continued": continued}
    with step("map", out, force=force, inputs=inputs) as now:
        now.run(given.path(source, "source"), **told)
        return Map.of(now)


def localise(
    source: PathLike,
    map: PathLike,
    *,
    initial_pose: Pose | Literal["global"] | None = None,
    truth: PathLike | None = None,
    laser: Pose | None = None,
    upside_down: bool = False,
    seed: int = 1,
    config: PathLike | None = None,
    settings: Settings | None = None,
    out: PathLike | None = None,
    force: bool = False,
) -> Localisation:
    """Localise a recorded robot on a map, scan by scan (AMCL).

    `initial_pose` is its first pose on the map, or "global" to search the whole map; without one the result
    is rejected. `truth` is a recording; it only adds error metrics. InputError for a recording without
    odometry or a map without walls.
    """
    told = {
        "map": as_map(map).yaml,
        "initial_pose": given.initial_pose(initial_pose, "global"),
        "laser": given.laser(laser, upside_down),
        "truth": truth,
        "seed": given.seed(seed),
    }
    words = given.settings(settings)
    inputs = {"source": source, "map": map, "truth": truth, "config": config}
    with step("localise", out, force=force, inputs=inputs) as now:
        now.run(given.path(source, "source"), **told, config=config, set=words)
        return Localisation.of(now)


def plan(
    map: PathLike,
    start: Pose,
    goal: Pose,
    *,
    robot: PathLike | None = None,
    planner: str | type | None = None,
    compare: bool = False,
    seed: int = 0,
    config: PathLike | None = None,
    settings: Settings | None = None,
    out: PathLike | None = None,
    force: bool = False,
) -> Plan:
    """Plan a path on a map from one pose to another, both in the map's frame.

    `robot` is a name or a file (default: the one that made the map, else burger), `planner` one of OMPL's or
    a class; `compare` runs all of OMPL's. If there is no path, `success` is False and the verdict gives the
    reason. InputError for a start or goal off the map or in an obstacle.
    """
    on = as_map(map)
    told = {
        "map": on.yaml,
        "robot": robot_for(on, robot),
        "start": given.pose(start, "start"),
        "goal": given.pose(goal, "goal"),
        "planner": given.planner(planner),
        "compare": compare,
        "seed": given.seed(seed),
    }
    words = given.settings(settings)
    with step("plan", out, force=force, inputs={"map": map, "config": config}) as now:
        now.run(**told, config=config, set=words)
        return Plan.of(now)


def report(
    *outputs: PathLike,
    systems: Systems | None = None,
    animate: bool = True,
    paper: bool = False,
    out: PathLike | None = None,
    force: bool = False,
) -> Report:
    """Make one page about recordings, maps, runs, localisations and plans, with figures and numbers.

    `systems` are other systems to show beside ours: files or `System`s by name. `animate=False` leaves out
    the animations, `paper=True` adds every figure as PDF and SVG. InputError for anything that is not such an
    output, and for systems that cannot be compared with it. `turtlebag verify` needs the outputs themselves:
    give them an `out` to keep them.
    """
    from turtlebag.pipeline.cli.report import make

    if not outputs:
        raise InputError("report: give one or more outputs: recordings, maps, runs, localisations, plans")
    shown = {f"output {number}": one for number, one in enumerate(outputs, start=1)}
    words, known, files = system_options(systems)
    with step("report", out, force=force, inputs={**shown, **files}) as now:
        paths = [given.path(one, what) for what, one in shown.items()]
        make(now.arguments(*paths, system=words, **known, no_animation=not animate, paper=paper))
        return Report.of(now)


def compare(
    output: PathLike,
    other: PathLike | None = None,
    *,
    systems: Systems | None = None,
    out: PathLike | None = None,
    force: bool = False,
) -> Comparison:
    """Compare two outputs of one step, or ours with other systems' results for one recording.

    `systems` are files or `System`s by the systems' names, instead of `other`. InputError for outputs of two
    kinds, and for systems that cannot be read or compared.
    """
    from turtlebag.pipeline.cli.compare import make

    words, known, files = system_options(systems)
    if (other is None) == (not files):
        raise InputError("compare: give another output, or other systems by their names")
    path, read = given.path(output, "output"), {"output": output, "other": other, **files}
    with step("compare", out, force=force, inputs=read) as now:
        found = make(now.arguments(path, *(words if other is None else [other]), **known))
        if isinstance(found, SystemComparison):
            now.notes += [f"{name}: {note}" for name, note in found.notes]
        return Comparison.of(now)


def navigate(
    map: PathLike | None = None,
    *,
    task: Task | type,
    world: PathLike | type | None = None,
    robot: PathLike | None = None,
    seed: int = 0,
    start: Pose | None = None,
    initial_pose: Pose | Literal["start", "global"] | None = "start",
    wiggle: bool = False,
    teleop_override: PathLike | None = None,
    keepout: PathLike | Sequence[Any] | None = None,
    config: PathLike | None = None,
    settings: Settings | None = None,
    out: PathLike | None = None,
    force: bool = False,
) -> Run:
    """Run a task in closed loop with the simulator, recorded and measured.

    A patrol and a goal use `map`; without one, a goal uses odometry. `world` and `robot` are names or files
    (default: those of the recording that the map was made from). `start` is the true pose in the world,
    `initial_pose` the pose that the localiser starts from: "start" for the true one, "global" to search the
    whole map, None for none. `wiggle` turns the robot back and forth first. `teleop_override` is a file
    of teleop intervals. `keepout` are keep-out areas: a file, outlines (n, 2) [m], or [] for none (default:
    the world's). A failed task is a result, too: see `success` and `goals`. InputError for a bad goal, map
    or name.
    """
    words, name = given.settings(settings), given.part(task)
    inputs = {"map": map, "teleop_override": teleop_override, "config": config}
    with step("navigate", out, force=force, inputs=inputs) as now:
        on, files = None if map is None else as_map(map), TemporaryFolder()
        now.kept.append(files)
        told = task_options(name, files.path)
        if on is None and isinstance(task, Patrol):
            raise InputError("map: a patrol needs one; give the map to drive on")
        if isinstance(task, Avoid | Explore) and (on is not None or wiggle or keepout is not None):
            raise InputError(f"{told['task']}: takes no map, wiggle or keepout; leave them out")
        scene = given.part(world) if world is not None or on is None else on.world
        if scene is None:
            raise InputError("world: give the world to drive in; the map does not say where it was made")
        by = robot if robot is not None or on is None else on.robot
        now.run(
            world=given.text(scene, "world"),
            robot=None if by is None else given.text(by, "robot"),
            task=told.pop("task"),
            map=None if on is None else on.yaml,
            start=None if start is None else given.pose(start, "start"),
            initial_pose=None if on is None else given.initial_pose(initial_pose, "start", "global"),
            seed=given.seed(seed),
            **told,
            wiggle=wiggle,
            # the command line's word for the keys of the terminal is a file's name here, as any other
            teleop_override="./keyboard" if teleop_override == "keyboard" else teleop_override,
            keepout=keepout_option(keepout, files.path),
            config=config,
            set=words,
        )
        return Run.of(now)
