"""turtlebag compare: the differences between two outputs of one stage, or between ours and other systems'."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.plurals import counted
from turtlebag.pipeline.cli.arguments import output, refuse
from turtlebag.pipeline.cli.other_systems import (
    SYSTEM_OPTIONS,
    add_system_options,
    existing_files,
    systems_named,
)
from turtlebag.pipeline.cli.parser import Parser
from turtlebag.pipeline.terminal.messages import print_table, say

if TYPE_CHECKING:
    from turtlebag.reports.compare import Comparison
    from turtlebag.reports.system_comparison import SystemComparison

EXAMPLE = "turtlebag compare data/maps/a cartographer=poses.tum cartographer=map.yaml --out data/comparison"


def add_arguments(parser: Parser) -> None:
    """Arguments of `turtlebag compare`."""
    parser.option("a", "A", "output of record, map, localise, plan or navigate", Path)
    text = (
        "another output of the same stage; or files of other systems: trajectories (TUM, KITTI, EuRoC csv) "
        "and maps (yaml), the two of one system under one NAME"
    )
    parser.option("b", "B|[NAME=]FILE", text, nargs="+")
    add_system_options(parser)
    parser.add_output("also write a page with figures", required=False)


def inputs(args: argparse.Namespace) -> list[Path]:
    """The inputs."""
    return [*([args.a] if args.a.exists() else []), *existing_files(args.b, args)]


def run(args: argparse.Namespace) -> int:
    """Print the differences; the page's path last, if there is a page."""
    from turtlebag.reports.system_comparison import SystemComparison

    found = make(args)
    if isinstance(found, SystemComparison):
        _print_systems(found)
    else:
        _print_outputs(found)
    if args.out is not None:
        say(args.out / "index.html")
    return 0


def make(args: argparse.Namespace) -> Comparison | SystemComparison:
    """The comparison of two outputs, or of ours and other systems'."""
    from turtlebag.pipeline.stages.compare import compare_outputs, compare_with_systems

    for word in args.b:
        if "=" not in word and not Path(word).exists():
            raise InputError(f"{word}: no such output, trajectory or map")
    out = None if args.out is None else output(args)
    if not any(Path(word).is_dir() for word in args.b):
        return compare_with_systems(args.a, systems_named(args.b, args), out)
    if len(args.b) > 1:
        raise InputError("compare takes two outputs, or one output and files of other systems")
    refuse(args, SYSTEM_OPTIONS, f"only for files of other systems; {args.b[0]} is an output of turtlebag")
    return compare_outputs(args.a, Path(args.b[0]), out)


def _print_outputs(found: Comparison) -> None:
    for key, one, other in found.settings:
        say(f"{key}: {one} -> {other}")
    rows = [(row.label, row.a, row.b, row.difference, row.relative) for row in found.rows]
    print_table([("", "A", "B", "B - A", ""), *rows] if rows else [])
    say(f"{counted(len(found.same_bytes), 'file')} identical, {len(found.changed)} different")


def _print_systems(found: SystemComparison) -> None:
    for name, note in found.notes:
        say(f"{name}: {note}")
    texts = [(row.spec.label, *row.texts, row.spec.evo) for row in found.rows]
    print_table([("", *found.names, "evo"), *texts], left=(0, -1))
    say(found.sentence)
