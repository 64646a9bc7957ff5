"""Requests for maps, and for what is done on them without driving."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, get_args

from pydantic import Field

from turtlebag.datasets.parts import part_of
from turtlebag.pipeline.stages.requests.options import (
    POSE,
    RAD,
    XYT,
    ConfigFile,
    LaserPose,
    MapFile,
    Name,
    Option,
    OrOwn,
    Overrides,
    Pose,
    Seed,
    Topics,
    file,
    flag,
    on_map,
    pose_or,
)
from turtlebag.pipeline.stages.requests.request import Request
from turtlebag.planners.planner_names import PlannerName

PLANNERS = (*get_args(PlannerName), "lattice")


class MapRequest(Request):
    """A map of a recording."""

    VERB = "map"
    EXAMPLE = "turtlebag map data/records/tour --out data/maps/tour --truth data/records/tour/truth"

    source: Annotated[Path, file("INPUT", "record folder, bag or CARMEN log", "rec", positional=True)]
    truth: Annotated[
        Path | None,
        file(
            "DIR",
            "truth folder of the recording: adds error metrics and decides on verdict and exit code",
            "rec/truth",
        ),
    ] = None
    relations: Annotated[
        Path | None, file("FILE", "relations file of a benchmark: adds error metrics", "intel.relations")
    ] = None
    also: Annotated[
        tuple[Path, ...],
        file("INPUT", "another recording of the same place to add to the map", "rec2"),
    ] = ()
    continued: Annotated[
        Path | None,
        file(
            "MAP_DIR",
            "extend an earlier map: INPUT is added to its graph, with the same settings",
            "map",
            name="--continue",
        ),
    ] = None
    laser: LaserPose = None
    topic: Annotated[
        Topics,
        Option(
            "NAME",
            "topic to map: LaserScan for 2D (more than one for several lidars), PointCloud2 for 3D "
            "(default: all lidars that have a transform, else /scan or the only LaserScan topic; "
            "if there is none, the point clouds)",
            "/scan",
        ),
    ] = ()
    name: Annotated[str | None, Option("NAME", "also save the map as NAME.pgm and NAME.yaml", "hall")] = None
    edits: Annotated[
        Path | None,
        file(
            "FILE",
            "YAML file of loop closures to reject or to add, and of walls to draw or erase",
            "edits.yaml",
        ),
    ] = None
    config: ConfigFile = None
    settings: Overrides = Field({})
    explain: Annotated[bool, flag("also write why each loop closure was accepted or rejected")] = False


class LocaliseRequest(Request):
    """Where a recorded robot was on a map."""

    VERB = "localise"
    EXAMPLE = (
        "turtlebag localise data/world/bag --map data/maps/map_world.yaml --initial-pose=-2,-0.5,0 "
        "--out data/loc"
    )

    source: Annotated[Path, file("BAG", "record folder, bag or CARMEN log", "rec", positional=True)]
    map: Annotated[MapFile, on_map("localise")]
    initial_pose: Annotated[
        XYT | Literal["global"] | None,
        pose_or("global"),
        Option(
            f"{POSE}|global",
            "where on the map the robot starts; global: search the whole map",
            "-2,-0.5,0",
            RAD,
        ),
    ] = None
    laser: LaserPose = None
    topic: Annotated[
        Topics,
        Option(
            "NAME",
            "LaserScan topic to use, more than one for several lidars "
            "(default: all lidars that have a transform, else /scan or the only one)",
            "/scan",
        ),
    ] = ()
    truth: Annotated[Path | None, file("DIR", "truth folder to measure errors against", "rec/truth")] = None
    seed: Seed = 1
    config: ConfigFile = None
    settings: Overrides = Field({})


class PlanRequest(Request):
    """A path over a map."""

    VERB = "plan"
    EXAMPLE = (
        "turtlebag plan --map data/maps/map_world.yaml --robot burger --start=-2,-0.5,0 --goal 1.5,1.5,0 "
        "--out data/plans/first"
    )

    map: Annotated[MapFile, on_map("plan")]
    robot: Annotated[Name, Option("R", "robot: a name or a YAML file", "burger")] = "burger"
    start: Annotated[Pose, Option(POSE, "start pose", "-2,-0.5,0", RAD)]
    goal: Annotated[Pose, Option(POSE, "goal pose", "1.5,1.5,0", RAD)]
    planner: Annotated[
        Annotated[str, part_of(*PLANNERS)] | None,
        Option(
            "P",
            f"OMPL planner (default: BITstar), `lattice`, which needs no OMPL, or your own class "
            f"(module:Class): {', '.join(PLANNERS)}",
            "RRTstar",
            choices=OrOwn(PLANNERS),
        ),
    ] = None
    compare: Annotated[bool, flag("run every planner and compare the paths")] = False
    seed: Seed = 1
    config: ConfigFile = None
    settings: Overrides = Field({})
