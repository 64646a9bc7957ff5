"""turtlebag ablate: map a recording, and drive on the map, with parts replaced by ground truth."""

from __future__ import annotations

import argparse
from pathlib import Path

from turtlebag.pipeline.campaign.parts import PARTS
from turtlebag.pipeline.cli.arguments import output
from turtlebag.pipeline.stages.parser import Parser

EXAMPLE = "turtlebag ablate data/records/world --replace odometry --out data/ablation"


def add_arguments(parser: Parser) -> None:
    """Arguments of `turtlebag ablate`."""
    parser.option("record", "DIR", "output of record", Path)
    text = f"what to replace with ground truth: none, or a comma-separated list of {', '.join(PARTS)}"
    parser.option("--replace", "PARTS", text, default="none")
    parser.flag("--patrol", "also drive the tutorial's patrol on the map, with the same parts replaced")
    parser.add_config()
    parser.add_output()


def run(args: argparse.Namespace) -> int:
    """Write the map outputs with the remaining errors."""
    from turtlebag.pipeline.campaign.ablation import ablate

    return ablate(
        args.record,
        output(args),
        replace=args.replace,
        patrol=args.patrol,
        config=args.config,
        settings=args.settings,
    )
