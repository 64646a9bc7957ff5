"""turtlebag blame: map a recording, and drive on the map, with parts replaced by the truth."""

from __future__ import annotations

import argparse
from pathlib import Path

from turtlebag.pipeline.campaign.parts import PARTS
from turtlebag.pipeline.cli.arguments import add_config, add_output, output

EXAMPLE = "turtlebag blame data/records/world --replace odometry --out data/blame"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `turtlebag blame`."""
    parser.add_argument("record", type=Path, metavar="DIR", help="output of record")
    parser.add_argument(
        "--replace",
        default="none",
        metavar="PARTS",
        help=f"what to replace with ground truth: none, or a comma-separated list of {', '.join(PARTS)}",
    )
    parser.add_argument(
        "--patrol",
        action="store_true",
        help="then drive the tutorial's patrol on the map, with the same parts replaced",
    )
    add_config(parser)
    add_output(parser)


def run(args: argparse.Namespace) -> int:
    """Write the map outputs with the errors that are left."""
    from turtlebag.pipeline.campaign.blame import blame

    return blame(
        args.record,
        output(args),
        replace=args.replace,
        patrol=args.patrol,
        config=args.config,
        settings=args.settings,
    )
