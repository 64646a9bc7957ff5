"""The request for a twin: a robot in its building, from one recording."""

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


class TwinRequest(Request):
    """Map, world and robot of a recording, and its drive again in the simulator."""

    VERB = "twin"
    EXAMPLE = "turtlebag twin data/records/tour --robot burger --out data/twins/tour"

    source: Annotated[Path, file("BAG", "record folder, bag or CARMEN log", "rec", positional=True)]
    robot: Annotated[
        Name,
        Option(
            "BASE",
            "robot that gives what no bag shows, as shape and masses: a name or a YAML file",
            "burger",
        ),
    ] = "burger"
    drives: Annotated[
        Count,
        Option("N", "how often it drives again, with parameters drawn from their intervals", "5", read=count),
    ] = 3
    seed: Seed = 1
    laser: LaserPose = None
    topic: Annotated[
        Topics,
        Option(
            "NAME",
            "LaserScan topic to use (default: all lidars that have a transform, else /scan or the only one)",
            "/scan",
        ),
    ] = ()
    config: ConfigFile = None
    settings: Overrides = Field({})
