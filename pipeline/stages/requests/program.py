"""A request for somebody else's program: only campaigns make it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field

from turtlebag.pipeline.stages.requests.request import Request

# A path below the program's folder; a campaign's file may say it in braces, and for some levels nothing.
FileName = Annotated[
    Annotated[str, Field(pattern=r"^(\w[\w.-]*(/\w[\w.-]*)*|\{[^{}]*\})$")] | None,
    BeforeValidator(lambda name: None if name == "" else name),
]


class ProgramRequest(Request):
    """A program that makes a trajectory or a map of a recording.

    `{out}` in a word of `command` is the folder to write into; `trajectory` and `map` name what it leaves
    there: poses in the TUM format, and a map yaml. `odometry` are its poses before any loop is closed.
    """

    VERB = "program"
    EXAMPLE = ""

    command: Annotated[tuple[str, ...], Field(min_length=1)]
    trajectory: FileName = None
    map: FileName = None
    odometry: FileName = None
    truth: Path | None = None
    relations: Path | None = None
    time_limit_s: float = Field(default=600.0, gt=0.0, allow_inf_nan=False)
