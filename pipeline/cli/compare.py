"""turtlebag compare: what differs between two outputs of one stage, or between ours and other systems'."""

from __future__ import annotations

import argparse
from pathlib import Path

from turtlebag.datasets.errors import InputError
from turtlebag.pipeline.cli.arguments import add_output, option, output
from turtlebag.pipeline.cli.rivals import add_rival_options, existing_rivals, rivals
from turtlebag.pipeline.terminal.messages import number_of

EXAMPLE = "turtlebag compare data/maps/a cartographer=poses.tum cartographer=map.yaml --out data/comparison"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `turtlebag compare`."""
    option(parser, "a", "A", "output of record, map, localise, plan or navigate", Path)
    text = (
        "another output of the same stage; or files of other systems: trajectories (TUM, KITTI, EuRoC csv) "
        "and maps (yaml), the two of one system under one NAME"
    )
    option(parser, "b", "B|[NAME=]FILE", text, nargs="+")
    add_rival_options(parser)
    add_output(parser, "also write a page with pictures", required=False)


def inputs(args: argparse.Namespace) -> list[Path]:
    """What is read."""
    return [*([args.a] if args.a.exists() else []), *existing_rivals(args.b, args)]


def run(args: argparse.Namespace) -> int:
    """Print the differences; the page's path last when one was asked for."""
    for word in args.b:
        if "=" not in word and not Path(word).exists():
            raise InputError(f"{word}: no such output, trajectory or map")
    if any(Path(word).is_dir() for word in args.b):
        _compare_outputs(args)
    else:
        _compare_rivals(args)
    if args.out is not None:
        print(args.out / "index.html")
    return 0


def _compare_outputs(args: argparse.Namespace) -> None:
    from turtlebag.pipeline.stages.compare import compare_outputs

    if len(args.b) > 1:
        raise InputError("compare takes two outputs, or one output and files of other systems")
    if args.rival_base or args.rival_times or args.rival_shift:
        raise InputError(f"{args.b[0]}: is an output of ours; --rival options are for others' files")
    b = Path(args.b[0])
    found = compare_outputs(args.a, b, None if args.out is None else output(args))
    for key, one, other in found.settings:
        print(f"{key}: {one} -> {other}")
    width = max((len(row.label) for row in found.rows), default=0)
    if found.rows:
        print(f"{'':{width}}  {'A':>12}  {'B':>12}  {'B - A':>12}")
    for row in found.rows:
        print(f"{row.label:{width}}  {row.a:>12}  {row.b:>12}  {row.difference:>12}  {row.relative}".rstrip())
    print(f"{number_of(len(found.same_bytes), 'file')} identical, {len(found.changed)} different")


def _compare_rivals(args: argparse.Namespace) -> None:
    from turtlebag.pipeline.stages.compare import compare_rivals

    out = None if args.out is None else output(args)
    found = compare_rivals(args.a, rivals(args.b, args), out)
    for name, note in found.notes:
        print(f"{name}: {note}")
    sections = found.sections
    labels = [row.spec.label for _, _, rows in sections for row in rows]
    width, columns = max(map(len, labels), default=0), [max(len(name), 10) for name in found.names]
    heads = [f"{name:>{wide}}" for name, wide in zip(found.names, columns, strict=True)]
    print("  ".join([" " * width, *heads, "evo"]))
    for _, _, rows in sections:
        for row in rows:
            texts = [f"{cell.text:>{wide}}" for cell, wide in zip(row.cells, columns, strict=True)]
            print("  ".join([f"{row.spec.label:{width}}", *texts, row.evo]).rstrip())
    print(found.sentence)
