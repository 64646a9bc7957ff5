"""Runs what a request asks for: the one way into the stages, of the command line, Python and campaigns."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.stages.command_line import recorded
from turtlebag.pipeline.stages.requests.request import Request

HOMES = {
    "record": "record:record_script",
    "teleop": "record:record_keyboard",
    "map": "map:build_map",
    "localise": "localise:localise",
    "identify": "identify:identify_robot",
    "twin": "twin:make_twin",
    "plan": "plan:plan",
    "navigate": "navigate:navigate_as_asked",
    "report": "report:report",
    "compare": "compare:compare_with_page",
    "grade": "grade:grade_file",
    "bag convert": "bags:convert_bag",
    "bag recover": "bags:recover_bag",
    "program": "program:run_program",
    "studio": "studio:replay_as_asked",
}
"""The module here and the function that does what a verb asks for; it is imported when it is asked for."""


def run(request: Request, out: Output) -> int:
    """Do it and write the output; the exit code: 0 done, 1 the task itself failed, 130 interrupted.

    The manifest records the request. InputError, with nothing written, for what cannot be done.
    """
    module, _, name = HOMES[request.VERB].partition(":")
    home: Any = importlib.import_module(f"turtlebag.pipeline.stages.{module}")
    stage: Callable[[Request, Output], int] = getattr(home, name)
    return stage(request, recorded(request, out))
