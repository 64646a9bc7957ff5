"""The steps of the command line as functions: same stages, same settings, same bytes.

All of them take `out`, a folder for the result (it must not exist, unless `force` replaces it); without it
nothing is kept. Their other keyword arguments are fields of a request, and so are the options of the command.
`config` is a YAML file of settings, and `settings` changes single ones by their dotted names, as
`--config` and `--set` do: `{"loops.match": "open3d"}`. For a part of your own, pass its class.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from turtlebag.api import given
from turtlebag.api.given import PathLike, Pose
from turtlebag.api.making import TemporaryFolder, made, takes
from turtlebag.api.other_systems import Systems, fields_of
from turtlebag.api.outputs import Bag, Map, as_map, robot_for
from turtlebag.api.results import Comparison, Identification, Localisation, Plan, Report, Run, Twin
from turtlebag.api.tasks import Task, keepout_field, task_fields
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.stages.compare import compare_as_asked
from turtlebag.pipeline.stages.requests.drives import TAKEN_BY, NavigateRequest, RecordRequest
from turtlebag.pipeline.stages.requests.maps import LocaliseRequest, MapRequest, PlanRequest
from turtlebag.pipeline.stages.requests.pages import SYSTEM_OPTIONS, CompareRequest, ReportRequest
from turtlebag.pipeline.stages.requests.request import Request
from turtlebag.pipeline.stages.requests.robots import IdentifyRequest, TwinRequest
from turtlebag.reports.system_comparison import SystemComparison


@takes(RecordRequest)
def record(
    world: PathLike | type,
    robot: PathLike | None = None,
    *,
    out: PathLike | None = None,
    force: bool = False,
    **options: Any,
) -> Bag:
    """Drive a simulated robot and record its sensor data.

    `world` is a name, a file or a class. If the robot gets stuck, the recording is kept, and its `notes` say
    so. InputError for unknown names and a start in an obstacle.
    """
    asked = RecordRequest.checked(world=world, robot=robot, **options)
    return Bag.of(made(asked, out, force, *options.values()))


@takes(MapRequest)
def map(
    source: PathLike,
    *,
    front_end: str | type | None = None,
    laser: Pose | None = None,
    upside_down: bool = False,
    out: PathLike | None = None,
    force: bool = False,
    **options: Any,
) -> Map:
    """Build a map from a recording: a Bag, a folder, a bag file or a CARMEN log.

    `front_end` is a name or a class (its contract: `turtlebag.pipeline.slam.odometry.front_end`). `truth` (a
    recording) adds error metrics and decides on the verdict, `relations` (a benchmark's file) only adds
    metrics. `also` are later recordings of the
    same place, `continued` an earlier map that the recording is added to. `laser` and `upside_down` override
    the laser's pose on the robot. InputError for what cannot be mapped.
    """
    if front_end is not None:
        options["settings"] = {**(options.get("settings") or {}), "front_end": front_end}
    asked = MapRequest.checked(source=source, laser=_placed(laser, upside_down), **options)
    return Map.of(made(asked, out, force, source, *options.values()))


@takes(LocaliseRequest)
def localise(
    source: PathLike,
    map: PathLike,
    *,
    laser: Pose | None = None,
    upside_down: bool = False,
    out: PathLike | None = None,
    force: bool = False,
    **options: Any,
) -> Localisation:
    """Localise a recorded robot on a map, scan by scan (AMCL).

    `initial_pose` is its first pose on the map, or "global" to search the whole map; without one the result
    is rejected. `truth` is a recording; it only adds error metrics. InputError for a recording without
    odometry or a map without walls.
    """
    asked = LocaliseRequest.checked(source=source, map=map, laser=_placed(laser, upside_down), **options)
    return Localisation.of(made(asked, out, force, source, map, *options.values()))


@takes(IdentifyRequest)
def identify(
    source: PathLike,
    robot: PathLike = "burger",
    *,
    laser: Pose | None = None,
    upside_down: bool = False,
    out: PathLike | None = None,
    force: bool = False,
    **options: Any,
) -> Identification:
    """Estimate the parameters of the robot that made a recording: lidar, wheels, motors and IMU.

    `robot` is a name or a file, and gives what no recording shows. InputError for a recording without scans,
    odometry or motion.
    """
    asked = IdentifyRequest.checked(source=source, robot=robot, laser=_placed(laser, upside_down), **options)
    return Identification.of(made(asked, out, force, source, *options.values()))


@takes(TwinRequest)
def twin(
    source: PathLike,
    robot: PathLike = "burger",
    *,
    laser: Pose | None = None,
    upside_down: bool = False,
    out: PathLike | None = None,
    force: bool = False,
    **options: Any,
) -> Twin:
    """Make map, world and robot of a recording, drive it again, and compare real with simulated.

    `robot` is a name or a file, and gives what no recording shows; `drives` is how often it drives again.
    InputError for a recording without scans, odometry or motion.
    """
    asked = TwinRequest.checked(source=source, robot=robot, laser=_placed(laser, upside_down), **options)
    return Twin.of(made(asked, out, force, source, *options.values()))


def _placed(laser: Pose | None, upside_down: bool) -> list[Any] | None:
    if upside_down and laser is None:
        raise InputError("upside_down: give laser, the pose of the laser on the robot, with it")
    return None if laser is None else [*given.pose(laser, "laser").xyt.tolist(), upside_down]


@takes(PlanRequest)
def plan(
    map: PathLike,
    start: Pose,
    goal: Pose,
    *,
    robot: PathLike | None = None,
    out: PathLike | None = None,
    force: bool = False,
    **options: Any,
) -> Plan:
    """Plan a path on a map from one pose to another, both in the map's frame.

    `robot` is a name or a file (default: the one that made the map, else burger), `planner` one of OMPL's or
    a class; `compare` runs all of OMPL's. If there is no path, `success` is False and the verdict gives the
    reason. InputError for a start or goal off the map or in an obstacle.
    """
    by = robot_for(as_map(map), robot)
    asked = PlanRequest.checked(map=map, start=start, goal=goal, robot=by, **options)
    return Plan.of(made(asked, out, force, map))


@takes(ReportRequest, but=("folders", "index", "system", *SYSTEM_OPTIONS))
def report(
    *outputs: PathLike,
    systems: Systems | None = None,
    out: PathLike | None = None,
    force: bool = False,
    **options: Any,
) -> Report:
    """Make one page about recordings, maps, runs, localisations and plans, with figures and numbers.

    `systems` are other systems to show beside ours: files or `System`s by name. `animate=False` leaves out
    the animations, `paper=True` adds every figure as PDF and PNG. InputError for anything that is not such an
    output, and for systems that cannot be compared with it. `turtlebag verify` needs the outputs themselves:
    give them an `out` to keep them.
    """
    if not outputs:
        raise InputError("report: give one or more outputs: recordings, maps, runs, localisations, plans")
    files, rest = fields_of(systems)
    asked = ReportRequest.checked(folders=outputs, system=files, **rest, **options)
    return Report.of(made(asked, out, force, *outputs))


def compare(
    output: PathLike,
    other: PathLike | None = None,
    *,
    systems: Systems | None = None,
    out: PathLike | None = None,
    force: bool = False,
) -> Comparison:
    """Compare two outputs of one step, or ours with other systems' results for one recording.

    Each may also be a folder of outputs, one for each run: then the differences are judged by the spread.
    `systems` are files or `System`s by the systems' names, instead of `other`. InputError for outputs of two
    kinds, and for systems that cannot be read or compared.
    """
    files, rest = fields_of(systems)
    if (other is None) == (not files):
        raise InputError("compare: give another output, or other systems by their names")
    asked = CompareRequest.checked(a=output, b=files if other is None else [("", other)], **rest)
    notes: list[str] = []

    def compared(request: Request, place: Output) -> int:
        found = compare_as_asked(asked, place)
        if isinstance(found, SystemComparison):
            notes.extend(f"{name}: {note}" for name, note in found.notes)
        return 0

    done = made(asked, out, force, output, other, run=compared)
    return Comparison.of(replace(done, notes=(*done.notes, *notes)))


@takes(NavigateRequest, but=("goal", *(name for name in TAKEN_BY if name != "wiggle")))
def navigate(
    map: PathLike | None = None,
    *,
    task: Task | type,
    world: PathLike | type | None = None,
    robot: PathLike | None = None,
    initial_pose: Pose | Literal["start", "global"] | None = "start",
    teleop_override: PathLike | None = None,
    keepout: PathLike | Sequence[Any] | None = None,
    out: PathLike | None = None,
    force: bool = False,
    **options: Any,
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
    on, files = None if map is None else as_map(map), TemporaryFolder()
    scene = world if world is not None or on is None else on.world
    if scene is None:
        raise InputError("world: give the world to drive in; the map does not say where it was made")
    asked = NavigateRequest.checked(
        world=scene,
        robot=robot if robot is not None or on is None else on.robot,
        map=None if on is None else on.yaml,
        initial_pose=None if on is None else initial_pose,
        **task_fields(task, files.path),
        # the command line's words are files' names here, as any others
        teleop_override=None if teleop_override is None else Path(teleop_override).absolute(),
        keepout=keepout_field(keepout, files.path),
        **options,
    )
    return Run.of(made(asked, out, force, map, files))
