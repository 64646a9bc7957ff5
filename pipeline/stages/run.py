"""Runs what a request asks for: the one way into the stages, of the command line, Python and campaigns."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from turtlebag.datasets.outputs import Output
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.stages.command_line import recorded
from turtlebag.pipeline.stages.requests.bags import ConvertRequest, RecoverRequest
from turtlebag.pipeline.stages.requests.courses import GradeRequest
from turtlebag.pipeline.stages.requests.drives import KeyboardRequest, NavigateRequest, RecordRequest
from turtlebag.pipeline.stages.requests.maps import LocaliseRequest, MapRequest, PlanRequest
from turtlebag.pipeline.stages.requests.pages import CompareRequest, ReportRequest
from turtlebag.pipeline.stages.requests.program import ProgramRequest
from turtlebag.pipeline.stages.requests.request import Request
from turtlebag.pipeline.stages.requests.robots import IdentifyRequest, TwinRequest
from turtlebag.pipeline.stages.requests.studio import StudioRequest
from turtlebag.pipeline.stages.settings import load_config
from turtlebag.pipeline.stages.sources import MapInputs, Source, pose_or_word
from turtlebag.pipeline.terminal.messages import log, say

if TYPE_CHECKING:
    from turtlebag.planners.costmap import Area


def run(request: Request, out: Output) -> int:
    """Do it and write the output; the exit code: 0 done, 1 the task itself failed, 130 interrupted.

    The manifest records the request. InputError, with nothing written, for what cannot be done.
    """
    out = recorded(request, out)
    match request:
        case RecordRequest():
            return _record(request, out)
        case KeyboardRequest():
            return _drive_by_hand(request, out)
        case MapRequest():
            return _map(request, out)
        case LocaliseRequest():
            from turtlebag.pipeline.stages.localise import localise

            return localise(request, out)
        case IdentifyRequest() | TwinRequest():
            return _robot(request, out)
        case PlanRequest():
            return _plan(request, out)
        case NavigateRequest():
            return _navigate(request, out)
        case ReportRequest():
            return _report(request, out)
        case CompareRequest():
            from turtlebag.pipeline.stages.compare import compare_as_asked

            compare_as_asked(request, out)
            return 0
        case GradeRequest():
            from turtlebag.pipeline.stages.grade import grade_file

            return grade_file(request, out)
        case ConvertRequest():
            from turtlebag.pipeline.stages.bags import convert_bag

            return convert_bag(request, out)
        case RecoverRequest():
            from turtlebag.pipeline.stages.bags import recover_bag

            return recover_bag(request, out)
        case ProgramRequest():
            from turtlebag.pipeline.stages.program import run_program

            return run_program(request, out)
        case StudioRequest():
            from turtlebag.pipeline.stages.studio import replay

            return replay(request.replayed(), out, say=log.info)
    raise TypeError(f"{type(request).__name__}: no stage does this")


def _record(request: RecordRequest, out: Output) -> int:
    from turtlebag.pipeline.stages.record import record, scene_of

    return record(scene_of(request), request.teleop, out)


def _drive_by_hand(request: KeyboardRequest, out: Output) -> int:
    from turtlebag.pipeline.stages.record import record_drive, scene_of
    from turtlebag.pipeline.terminal import keyboard_teleop
    from turtlebag.pipeline.terminal.messages import redrawn

    scene = scene_of(request)
    state = keyboard_teleop.KeyState(scene.robot.limits, request.style)
    keyboard_teleop.show(keyboard_teleop.TABLES[request.style] + "\n")
    with keyboard_teleop.keys_of(sys.stdin.fileno()) as read_keys, redrawn() as redraw:
        return record_drive(
            scene,
            keyboard_teleop.keyboard_driver(state, read_keys, keyboard_teleop.clock(request.speed)),
            f"keyboard:{request.style}",
            out,
            watch=keyboard_teleop.StatusLine(state, redraw),
        )


def _map(request: MapRequest, out: Output) -> int:
    from turtlebag.pipeline.stages.map import build_map
    from turtlebag.reports.metrics.references import References

    return build_map(
        MapInputs(Source.of(request), request.also, request.continued, request.edits),
        out,
        references=References.load(request.truth, request.relations),
        config=request.config,
        settings=request.settings,
        named=request.name,
        explain=request.explain,
    )


def _robot(request: IdentifyRequest | TwinRequest, out: Output) -> int:
    from turtlebag.sim.robots import load_robot

    base = Path(request.robot)
    source, robot = Source.of(request), load_robot(request.robot)
    files = {"robot": base} if base.is_file() else {}
    settings: dict[str, Any] = {"config": request.config, "settings": request.settings, "files": files}
    if isinstance(request, TwinRequest):
        from turtlebag.pipeline.stages.twin import make_twin

        return make_twin(source, robot, out, drives=request.drives, seed=request.seed, **settings)
    from turtlebag.pipeline.stages.identify import identify_robot

    return identify_robot(source, robot, out, **settings)


def _plan(request: PlanRequest, out: Output) -> int:
    from turtlebag.pipeline.stages.plan import PlanStageConfig, Query, plan, planner_settings
    from turtlebag.sim.robots import load_robot

    robot = load_robot(request.robot)
    query = Query(robot, SE2.from_xyt(*request.start), SE2.from_xyt(*request.goal), request.seed)
    settings = request.settings | planner_settings(request.planner)
    config = load_config(PlanStageConfig, request.config, settings)
    return plan(request.map, query, out, config=config, compare=request.compare)


def _navigate(request: NavigateRequest, out: Output) -> int:
    from turtlebag.pipeline.navigation.config import NavigateConfig
    from turtlebag.pipeline.navigation.mission import Request as Drive
    from turtlebag.pipeline.stages.navigate import navigate
    from turtlebag.sim.robots import load_robot
    from turtlebag.sim.worlds import load_world, own_files

    settings = request.settings | ({"avoid.mode": request.mode} if request.mode else {})
    drive = Drive(
        task=request.task,
        seed=request.seed,
        map_path=request.map,
        start=None if request.start is None else SE2.from_xyt(*request.start),
        initial_pose=pose_or_word(request.initial_pose),
        goal=None if request.goal is None else SE2.from_xyt(*request.goal),
        waypoints_path=request.waypoints,
        laps=request.laps,
        timeout_s=request.timeout,
        duration_s=request.duration,
        wiggle=request.wiggle,
        teleop_override=request.teleop_override,
        keepout=_areas(request.keepout),
        keepout_path=None if request.keepout in (None, "none") else Path(request.keepout),
    )
    world = load_world(request.world)
    files = own_files(request.world, request.robot)
    return navigate(
        world,
        load_robot(request.robot or world.robot),
        drive,
        out,
        config=load_config(NavigateConfig, request.config, settings),
        say=say if log.isEnabledFor(logging.INFO) else lambda line: None,
        files=files | ({"config": request.config} if isinstance(request.config, Path) else {}),
    )


def _areas(keepout: Path | str | None) -> tuple[Area, ...] | None:
    """The areas of a file, or none; None: the world's own."""
    from turtlebag.planners.tasks.waypoints import load_keepout

    return load_keepout(keepout) if isinstance(keepout, Path) else None if keepout is None else ()


def _report(request: ReportRequest, out: Output) -> int:
    from turtlebag.pipeline.stages.other_systems import systems_of
    from turtlebag.pipeline.stages.report import make_index, make_report

    if request.index:
        make_index(request.folders, out)
    else:
        others = systems_of(request, request.system)
        make_report(request.folders, out, others=others, animate=request.animate, paper=request.paper)
    return 0
