"""`turtlebag localise`: AMCL over a bag or log."""

from __future__ import annotations

import argparse
from pathlib import Path

from turtlebag.pipeline.cli.arguments import (
    add_config,
    add_laser,
    add_map,
    add_output,
    add_seed,
    initial_pose,
    laser,
    option,
    output,
)

EXAMPLE = (
    "turtlebag localise data/world/bag --map data/maps/map_world.yaml --initial-pose=-2,-0.5,0 --out data/loc"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the verb."""
    option(parser, "bag", "BAG", "record folder, bag or CARMEN log", Path)
    add_map(parser, "localise")
    text = "where on the map the robot starts; global: search the whole map"
    option(parser, "--initial-pose", "X,Y,YAW|global", text)
    add_laser(parser, "BAG")
    option(parser, "--truth", "DIR", "truth folder to measure errors against", Path)
    add_seed(parser, 1)
    add_config(parser)
    add_output(parser)


def run(args: argparse.Namespace) -> int:
    """Localise; 0 done, 1 lost at the end or rejected."""
    from turtlebag.pipeline.stages.localise import load_localise_config, localise
    from turtlebag.pipeline.stages.sources import Source

    return localise(
        Source(args.bag, *laser(args.laser)),
        args.map,
        output(args),
        initial_pose=initial_pose(args.initial_pose, "global"),
        truth=args.truth,
        config=load_localise_config(args.config, args.settings),
        seed=args.seed,
    )
