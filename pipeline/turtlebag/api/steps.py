"""The steps of the command line as functions: same stages, same settings, same bytes.

All of them take `out`, a folder to keep the result in (it must not exist, unless `force` replaces it);
without it nothing stays. `config` is a YAML file of settings and `settings` changes single ones by their
dotted names, as `--config` and `--set` do: `{"loops.match": "open3d"}`. A part of your own is given by its
class.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from turtlebag.api.making import (
    PathLike,
    Pose,
    command_line,
    list_of,
    part_name,
    path_if,
    path_of,
    pose_of,
    pose_text,
    require_finished,
    require_seed,
    setting_words,
    step,
    text_of,
)
from turtlebag.api.outputs import Bag, Map, as_map
from turtlebag.api.results import Comparison, Localisation, Plan, Report, Run
from turtlebag.api.rivals import Rivals, rival_files, rival_options
from turtlebag.api.tasks import Task
from turtlebag.datasets.errors import InputError

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
    """Drive a simulated robot and record what it saw.

    `world` is a name, a file or a class, `robot` a name or a file (default: the world's own), `teleop` a
    script, or a bag whose commands are driven again; `start` is the true pose in the world. A drive that
    got stuck is kept, and its `notes` say so. InputError for unknown names and a start in an obstacle.
    """
    from turtlebag.pipeline.stages.record import RecordOptions
    from turtlebag.pipeline.stages.record import record as stage
    from turtlebag.pipeline.stages.settings import load_config

    words, scene = setting_words(settings), text_of(part_name(world), "world")
    by, drive = None if robot is None else text_of(robot, "robot"), text_of(teleop, "teleop")
    T_start = None if start is None else pose_of(start, "start")
    given = {"world": scene, "robot": by, "teleop": drive, "seed": seed, "start": T_start}
    with step("record", out, force=force, inputs={"teleop": teleop, "config": config}) as now:
        code = stage(
            scene,
            by,
            drive,
            require_seed(seed),
            now.out,
            sim=load_config(RecordOptions, path_if(config, "config"), words).sim,
            start=T_start,
            force=force,
            command=command_line("record", **given, config=config, set=words, out=now.out),
        )
        require_finished(code)
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

    `front_end` is a name or a class (`turtlebag.pipeline.slam.front_end` says what it must have). `truth` (a
    recording) and `relations` (a benchmark's file) only add errors to the metrics. `also` are later
    recordings of the same place, `continued` an earlier map that the recording is added to. `laser` and
    `upside_down` override how the laser sits on the robot. InputError for what cannot be mapped.
    """
    from turtlebag.pipeline.stages.map import build_map

    words, at = setting_words(settings, front_end=front_end), path_of(source, "source")
    heard = None if topic is None else text_of(topic, "topic", "a name")
    later = {f"also {number}": one for number, one in enumerate(list_of(also, "also"), start=1)}
    T_base_lidar = None if laser is None else pose_of(laser, "laser")
    if upside_down and T_base_lidar is None:
        raise InputError("upside_down: give laser, the pose of the laser on the robot, with it")
    files = {"truth": truth, "relations": relations, "config": config, "edits": edits}
    given: dict[str, Any] = {**files, "also": [*later.values()], "continue": continued}
    given |= {"topic": heard, "set": words, "explain": explain}
    laser_text = T_base_lidar and pose_text(T_base_lidar) + (",upside-down" if upside_down else "")
    inputs = {"source": source, **files, **later, "continued": continued}
    with step("map", out, force=force, inputs=inputs) as now:
        build_map(
            at,
            now.out,
            truth=path_if(truth, "truth"),
            relations=path_if(relations, "relations"),
            config=path_if(config, "config"),
            settings=words,
            laser=T_base_lidar,
            upside_down=upside_down,
            also=[path_of(one, what) for what, one in later.items()],
            continued=path_if(continued, "continued"),
            topic=heard,
            edits=path_if(edits, "edits"),
            explain=explain,
            force=force,
            command=command_line("map", source, **given, laser=laser_text, out=now.out),
        )
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
    """Find where a recorded robot was on a map, scan by scan (AMCL).

    `initial_pose` is where it starts on the map, or "global" to search the whole of it; without one the
    result is rejected. `truth` is a recording; it only adds errors to the metrics. InputError for a recording
    without odometry or a map without walls.
    """
    from turtlebag.api.requests import told_pose
    from turtlebag.pipeline.stages.localise import load_localise_config
    from turtlebag.pipeline.stages.localise import localise as stage

    words, at, on = setting_words(settings), path_of(source, "source"), as_map(map).yaml
    told = told_pose(initial_pose, "global")
    T_base_lidar = None if laser is None else pose_of(laser, "laser")
    laser_text = T_base_lidar and pose_text(T_base_lidar) + (",upside-down" if upside_down else "")
    given = {"map": on, "initial_pose": told, "laser": laser_text, "truth": truth, "seed": seed}
    inputs = {"source": source, "map": map, "truth": truth, "config": config}
    with step("localise", out, force=force, inputs=inputs) as now:
        stage(
            at,
            on,
            now.out,
            initial_pose=told,
            T_base_lidar=T_base_lidar,
            upside_down=upside_down,
            truth=path_if(truth, "truth"),
            config=load_localise_config(path_if(config, "config"), words),
            seed=require_seed(seed),
            force=force,
            command=command_line("localise", source, **given, config=config, set=words, out=now.out),
        )
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
    """Plan a path over a map from a pose to another, both in the map's frame.

    `robot` is a name or a file (default: the one that made the map, else burger), `planner` one of OMPL's
    or a class; `compare` asks all of OMPL's. Where there is no path, `success` is False and the verdict
    says why. InputError for a start or goal off the map or in an obstacle.
    """
    from turtlebag.pipeline.stages.plan import PlanStageConfig, planner_settings
    from turtlebag.pipeline.stages.plan import plan as stage
    from turtlebag.pipeline.stages.settings import load_config

    words, on = setting_words(settings), as_map(map)
    by = None if planner is None else text_of(part_name(planner), "planner", "a name or a class")
    T_start, T_goal = pose_of(start, "start"), pose_of(goal, "goal")
    name = text_of(on.robot or "burger" if robot is None else robot, "robot")
    given = {
        "map": on.yaml,
        "robot": name,
        "start": T_start,
        "goal": T_goal,
        "planner": by,
        "compare": compare,
        "seed": seed,
        "config": config,
        "set": words,
    }
    with step("plan", out, force=force, inputs={"map": map, "config": config}) as now:
        stage(
            on.yaml,
            name,
            T_start,
            T_goal,
            now.out,
            seed=require_seed(seed),
            config=load_config(PlanStageConfig, path_if(config, "config"), [*words, *planner_settings(by)]),
            compare=compare,
            force=force,
            command_line=command_line("plan", **given, out=now.out),
        )
        return Plan.of(now)


def report(
    *outputs: PathLike,
    rivals: Rivals | None = None,
    animate: bool = True,
    paper: bool = False,
    out: PathLike | None = None,
    force: bool = False,
) -> Report:
    """One page of what recordings, maps, runs, localisations and plans came to, with figures and numbers.

    `rivals` are other systems to show beside ours: files or `Rival`s by name. `animate=False` leaves out the
    animations, `paper=True` adds every figure as PDF and SVG. InputError for what is no such output, and for
    rivals that cannot be compared with it. `turtlebag verify` needs the outputs themselves: give those an
    `out` to keep them.
    """
    from turtlebag.pipeline.stages.report import make_report
    from turtlebag.pipeline.stages.rivals import inputs_of

    if not outputs:
        raise InputError("report: give one or more outputs: recordings, maps, runs, localisations, plans")
    shown = {f"output {number}": one for number, one in enumerate(outputs, start=1)}
    others = rival_files(rivals)
    words, known = rival_options(others)
    with step("report", out, force=force, inputs={**shown, **inputs_of(others)}) as now:
        options = {"rival": words, **known, "no_animation": not animate, "paper": paper, "out": now.out}
        make_report(
            [path_of(one, what) for what, one in shown.items()],
            now.out,
            rivals=others,
            force=force,
            animate=animate,
            paper=paper,
            command=command_line("report", *outputs, **options),
        )
        return Report.of(now)


def compare(
    output: PathLike,
    other: PathLike | None = None,
    *,
    rivals: Rivals | None = None,
    out: PathLike | None = None,
    force: bool = False,
) -> Comparison:
    """What differs between two outputs of one step, or between ours and other systems' of one recording.

    `rivals` are files or `Rival`s by the systems' names, in place of `other`. InputError for outputs of two
    kinds, and for rivals that cannot be read or compared.
    """
    from turtlebag.pipeline.stages.compare import compare_outputs, compare_rivals
    from turtlebag.pipeline.stages.rivals import inputs_of

    ours, files = path_of(output, "output"), rival_files(rivals)
    if (other is None) == (not files):
        raise InputError("compare: give another output, or rivals by their names")
    words, options = rival_options(files)
    given = {"output": output, "other": other}
    with step("compare", out, force=force, inputs={**given, **inputs_of(files)}) as now:
        seconds = words if other is None else [other]
        command = command_line("compare", output, *seconds, **options, out=now.out)
        if other is None:
            found = compare_rivals(ours, files, now.out, force=force, command=command)
            now.notes += [f"{name}: {note}" for name, note in found.notes]
        else:
            compare_outputs(ours, path_of(other, "other"), now.out, force=force, command=command)
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
    takeover: PathLike | None = None,
    keepout: PathLike | Sequence[Any] | None = None,
    config: PathLike | None = None,
    settings: Settings | None = None,
    out: PathLike | None = None,
    force: bool = False,
) -> Run:
    """Drive a task in closed loop with the simulator, recorded and measured.

    A patrol and a goal go by `map`; without one, a goal by odometry. `world` and `robot` are names or files
    (default: those of the recording that the map was made from). `start` is the true pose in the world,
    `initial_pose` what the robot is told of it: "start" tells the truth, "global" to search the map, None
    nothing. `wiggle` turns the robot to and fro first. `takeover` is a file of intervals of teleop.
    `keepout` are areas to stay out of: a file, outlines (n, 2) [m], or [] for none (default: the world's).

    A task that fails is a result, too: see `success` and `goals`. InputError for a bad goal, map or name.
    """
    from turtlebag.api.requests import asked_for
    from turtlebag.pipeline.navigation.config import NavigateConfig
    from turtlebag.pipeline.stages.navigate import navigate as stage
    from turtlebag.pipeline.stages.settings import load_config

    words = setting_words(settings)
    with step(
        "navigate", out, force=force, inputs={"map": map, "takeover": takeover, "config": config}
    ) as now:
        asked = asked_for(
            map,
            part_name(task),
            world=part_name(world),
            robot=robot,
            seed=seed,
            start=start,
            initial_pose=initial_pose,
            wiggle=wiggle,
            takeover=takeover,
            keepout=keepout,
        )
        now.kept.append(asked.files)
        options = {**asked.options, "config": config, "set": words, "out": now.out}
        code = stage(
            asked.world,
            asked.request,
            now.out,
            robot=asked.robot,
            config=load_config(NavigateConfig, path_if(config, "config"), [*words, *asked.settings]),
            force=force,
            command_line=command_line("navigate", **options),
            say=lambda line: None,
            files={} if config is None else {"config": path_of(config, "config")},
        )
        require_finished(code)
        return Run.of(now)
