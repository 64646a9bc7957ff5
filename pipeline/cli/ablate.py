"""turtlebag ablate: map a recording, and drive on the map, with parts replaced by ground truth."""

from __future__ import annotations

import argparse
from pathlib import Path

from turtlebag.pipeline.campaign.parts import PARTS
from turtlebag.pipeline.cli.arguments import add_config, add_output, flag, option, output

EXAMPLE = "turtlebag ablate data/records/world --replace odometry --out data/ablation"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `turtlebag ablate`."""
    option(parser, "record", "DIR", "output of record", Path)
    text = f"what to replace with ground truth: none, or a comma-separated list of {', '.join(PARTS)}"
    option(parser, "--replace", "PARTS", text, default="none")
    flag(parser, "--patrol", "also drive the tutorial's patrol on the map, with the same parts replaced")
    add_config(parser)
    add_output(parser)


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
