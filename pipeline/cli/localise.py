"""`turtlebag localise`: AMCL over a bag or log."""

from __future__ import annotations

import argparse
from pathlib import Path

from turtlebag.pipeline.cli.arguments import initial_pose, laser, output
from turtlebag.pipeline.cli.parser import Parser

EXAMPLE = (
    "turtlebag localise data/world/bag --map data/maps/map_world.yaml --initial-pose=-2,-0.5,0 --out data/loc"
)


def add_arguments(parser: Parser) -> None:
    """Arguments of the verb."""
    parser.option("bag", "BAG", "record folder, bag or CARMEN log", Path)
    parser.add_map("localise")
    text = "where on the map the robot starts; global: search the whole map"
    parser.option("--initial-pose", "X,Y,YAW|global", text)
    parser.add_laser("BAG")
    parser.option("--truth", "DIR", "truth folder to measure errors against", Path)
    parser.add_seed(1)
    parser.add_config()
    parser.add_output()


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
