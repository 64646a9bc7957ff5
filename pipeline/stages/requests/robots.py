"""The request for a robot's parameters."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from turtlebag.pipeline.stages.requests.options import (
    ConfigFile,
    LaserPose,
    Name,
    Option,
    Overrides,
    Topics,
    file,
)
from turtlebag.pipeline.stages.requests.request import Request


class IdentifyRequest(Request):
    """The parameters of a robot, from a recording of it."""

    VERB = "identify"
    EXAMPLE = "turtlebag identify data/records/tour --robot burger --out data/robots/tour"

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
