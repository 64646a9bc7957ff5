"""Requests for other bags of a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator

from turtlebag.pipeline.stages.parser import seconds
from turtlebag.pipeline.stages.requests.options import NotNegative, Option, file
from turtlebag.pipeline.stages.requests.request import Request

Bag = Annotated[Path, file("BAG", "record folder, bag folder or bag file", "rec", positional=True)]
Frame = Annotated[str, AfterValidator(lambda text: text.lstrip("/"))]
"""A frame's name without ROS 1's leading slash."""


class ConvertRequest(Request):
    """A bag in another format, or a part of it."""

    VERB = "bag convert"
    EXAMPLE = "turtlebag bag convert data/record --from 10 --to 60 --out data/part"

    bag: Bag
    storage: Annotated[
        Literal["mcap", "sqlite3"] | None,
        Option("", "storage format (default: mcap)", "sqlite3", choices=("mcap", "sqlite3")),
    ] = None
    exclude: Annotated[tuple[str, ...], Option("TOPIC", "topic to leave out", "/imu")] = ()
    exclude_frame: Annotated[
        tuple[Frame, ...],
        Option(
            "FRAME",
            "drop every transform whose child is FRAME, in /tf and /tf_static",
            "wheel_left_link",
        ),
    ] = ()
    start: Annotated[
        NotNegative | None,
        Option(
            "S",
            "copy from this time on, from the bag's beginning (default: 0)",
            "10",
            "s",
            read=seconds,
            name="--from",
        ),
    ] = None
    end: Annotated[
        NotNegative | None,
        Option(
            "S",
            "copy up to this time, from the bag's beginning (default: its end)",
            "60",
            "s",
            read=seconds,
            name="--to",
        ),
    ] = None


class RecoverRequest(Request):
    """What is intact of a damaged or unfinished bag."""

    VERB = "bag recover"
    EXAMPLE = "turtlebag bag recover data/record.partial --out data/record"

    bag: Bag
