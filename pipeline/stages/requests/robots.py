"""Requests for what one recording says of its robot: the robot itself, and its twin."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from turtlebag.pipeline.stages.parser import count
from turtlebag.pipeline.stages.requests.options import (
    ConfigFile,
    Count,
    LaserPose,
    Name,
    Option,
    Overrides,
    Seed,
    Topics,
    file,
)
from turtlebag.pipeline.stages.requests.request import Request


class _RobotRequest(Request):
    """A recording, and the robot that gives what it does not show."""

    source: Annotated[Path, file("BAG", "record folder, bag or CARMEN log", "rec", positional=True)]
    robot: Annotated[
        Name,
        Option(
            "BASE",
            "robot that gives what no bag shows, as shape and masses: a name or a YAML file",
            "burger",
        ),
    ] = "burger"
    laser: LaserPose = None
    topic: Annotated[
        Topics,
        Option(
            "NAME",
            "LaserScan topic to use, more than one for several lidars; the first is identified "
            "(default: all lidars that have a transform, else /scan or the only one)",
            "/scan",
        ),
    ] = ()
    config: ConfigFile = None
    settings: Overrides = Field({})


class IdentifyRequest(_RobotRequest):
    """The parameters of a robot, from a recording of it."""

    VERB = "identify"
    EXAMPLE = "turtlebag identify data/records/tour --robot burger --out data/robots/tour"


class TwinRequest(_RobotRequest):
    """Map, world and robot of a recording, and its drive again in the simulator."""

    VERB = "twin"
    EXAMPLE = "turtlebag twin data/records/tour --robot burger --out data/twins/tour"

    drives: Annotated[
        Count,
        Option("N", "how often it drives again, with parameters drawn from their intervals", "5", read=count),
    ] = 3
    seed: Seed = 1
