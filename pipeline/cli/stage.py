"""The verbs that run a stage: their options are those of its request."""

from __future__ import annotations

import argparse
from pathlib import Path

from turtlebag.pipeline.cli.arguments import output
from turtlebag.pipeline.stages.command_line import add_request, request_of
from turtlebag.pipeline.stages.parser import Parser
from turtlebag.pipeline.stages.requests.table import REQUESTS
from turtlebag.pipeline.terminal.messages import say, starting


def example(verb: str) -> str:
    """A line of the help, for copying."""
    return REQUESTS[verb].EXAMPLE


def add_arguments(parser: Parser, verb: str) -> None:
    """An option for each field of the request; a comparison may be without an output."""
    add_request(parser, REQUESTS[verb])
    compared = verb == "compare"
    text = "also write a page with figures" if compared else "folder to write the results to"
    parser.add_output(text, required=not compared)


def inputs(args: argparse.Namespace) -> list[Path]:
    """What the stage may read; the request of the arguments is made here."""
    args.request = request_of(REQUESTS[args.verb], args)
    return args.request.files()


def run(args: argparse.Namespace) -> int:
    """Run the stage; what it found is printed of pages and comparisons."""
    starting()
    from turtlebag.pipeline.stages.run import run as run_stage

    if args.verb == "compare":
        from turtlebag.pipeline.cli.comparison import print_comparison
        from turtlebag.pipeline.stages.compare import compare_as_asked

        print_comparison(compare_as_asked(args.request, None if args.out is None else output(args)))
        code = 0
    else:
        code = run_stage(args.request, output(args))
    if args.verb in ("report", "compare") and args.out is not None:
        say(str(args.out / "index.html"))
    return code
