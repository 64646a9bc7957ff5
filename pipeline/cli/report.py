"""turtlebag report: a page of stage outputs."""

from __future__ import annotations

import argparse
from pathlib import Path

from turtlebag.pipeline.cli.arguments import output, refuse
from turtlebag.pipeline.cli.other_systems import (
    SYSTEM_OPTIONS,
    add_system_options,
    existing_files,
    systems_named,
)
from turtlebag.pipeline.cli.parser import Parser

EXAMPLE = "turtlebag report data/record data/map data/patrol --out data/report"


def add_arguments(parser: Parser) -> None:
    """Arguments of `turtlebag report`."""
    parser.option("folders", "DIR", "outputs of record, map, localise, plan and navigate", Path, nargs="+")
    parser.flag("--paper", "also save each figure as PDF and SVG")
    parser.flag("--index", "make a sortable table of all outputs below DIR instead")
    parser.flag("--no-animation", "leave out the animations, for a smaller page")
    text = "file of another system to show next to ours (see compare); may be repeated"
    parser.repeated("--system", "[NAME=]FILE", text)
    add_system_options(parser)
    parser.add_output()


def inputs(args: argparse.Namespace) -> list[Path]:
    """The inputs: for an index, those found below the folders, which may also hold the index."""
    return [] if args.index else [*args.folders, *existing_files(args.system, args)]


def run(args: argparse.Namespace) -> int:
    """Make the page and print its path."""
    print(make(args))
    return 0


def make(args: argparse.Namespace) -> Path:
    """The page's path."""
    from turtlebag.pipeline.stages.report import make_index, make_report

    if args.index:
        unused = ("paper", "no_animation", "system", *SYSTEM_OPTIONS)
        refuse(args, unused, "has no effect with --index; remove it")
        return make_index(args.folders, output(args))
    others, animate = systems_named(args.system, args), not args.no_animation
    return make_report(args.folders, output(args), others=others, animate=animate, paper=args.paper)
