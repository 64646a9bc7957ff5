"""The request for a mark in the course."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from turtlebag.pipeline.stages.parser import count
from turtlebag.pipeline.stages.requests.options import Count, Option, file
from turtlebag.pipeline.stages.requests.request import Request


class GradeRequest(Request):
    """The mark of a student's file."""

    VERB = "grade"
    EXAMPLE = "turtlebag grade hw2.py --lesson 2 --out data/grades/hw2"

    source: Annotated[
        Path, file("FILE", "Python file with the class of the lesson", "hw2.py", positional=True)
    ]
    lesson: Annotated[Count, Option("N", "number of the lesson", "2", read=count)]
    salt: Annotated[
        str,
        Field(max_length=200),
        Option("S", "the teacher's word that the hidden cases are made from", "spring"),
    ] = ""
