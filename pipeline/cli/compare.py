"""turtlebag compare: what differs between two outputs of one stage."""

from __future__ import annotations

import argparse
from pathlib import Path

from turtlebag.pipeline.cli.arguments import add_output

EXAMPLE = "turtlebag compare data/maps/a data/maps/b --out data/comparison"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `turtlebag compare`."""
    parser.add_argument("a", type=Path, metavar="A", help="output of record, map or navigate")
    parser.add_argument("b", type=Path, metavar="B", help="another output of the same stage")
    add_output(parser, "also write a page with pictures", required=False)


def run(args: argparse.Namespace) -> int:
    """Print the differences; the page's path last when one was asked for."""
    from turtlebag.pipeline.stages.compare import compare_outputs, write_comparison

    if args.out is None:
        found = compare_outputs(args.a, args.b)
    else:
        found = write_comparison(args.a, args.b, args.out, force=args.force, command=args.command_line)
    for key, a, b in found.settings:
        print(f"{key}: {a} -> {b}")
    width = max((len(row.label) for row in found.rows), default=0)
    if found.rows:
        print(f"{'':{width}}  {'A':>12}  {'B':>12}  {'B - A':>12}")
    for row in found.rows:
        print(f"{row.label:{width}}  {row.a:>12}  {row.b:>12}  {row.difference:>12}  {row.relative}".rstrip())
    print(f"{len(found.same_bytes)} files identical, {len(found.changed)} different")
    if args.out is not None:
        print(args.out / "index.html")
    return 0
