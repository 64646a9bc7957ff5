"""`turtlebag map`: build a map from a bag or log."""

from __future__ import annotations

import argparse
from pathlib import Path

from turtlebag.pipeline.cli.arguments import add_config, add_laser, add_output, laser

EXAMPLE = "turtlebag map data/records/tour --out data/maps/tour --truth data/records/tour/truth"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `map`."""
    parser.add_argument("input", type=Path, metavar="INPUT", help="record folder, bag or CARMEN log")
    add_output(parser)
    parser.add_argument(
        "--truth",
        type=Path,
        metavar="DIR",
        help="truth folder of a record: adds errors to the metrics",
    )
    parser.add_argument(
        "--relations",
        type=Path,
        metavar="FILE",
        help="relations of a benchmark: adds errors to the metrics",
    )
    parser.add_argument(
        "--also",
        type=Path,
        action="append",
        default=[],
        metavar="INPUT",
        help="another recording of the same place, joined into the same map; may be repeated",
    )
    parser.add_argument(
        "--continue",
        dest="continued",
        type=Path,
        metavar="MAP_DIR",
        help="continue an earlier map: INPUT is joined to its graph, tracked with the same settings",
    )
    add_laser(parser, "INPUT")
    parser.add_argument(
        "--topic",
        metavar="NAME",
        help="scans to map: a LaserScan topic in 2D, a PointCloud2 topic in 3D "
        "(default: /scan or the only LaserScan; without one, the point clouds)",
    )
    parser.add_argument("--name", metavar="NAME", help="also save the map as NAME.pgm and NAME.yaml")
    add_config(parser)
    parser.add_argument(
        "--no-cache",
        action="store_true",
        help="do every step anew, also what was done before",
    )
    parser.add_argument("--explain", action="store_true", help="also write why each loop was closed or not")


def run(args: argparse.Namespace) -> int:
    """Build the map."""
    from turtlebag.datasets.stage_cache import StageCache, default_cache
    from turtlebag.pipeline.stages.map import build_map

    placed, upside_down = laser(args.laser)
    return build_map(
        args.input,
        args.out,
        truth=args.truth,
        relations=args.relations,
        config=args.config,
        settings=args.settings,
        laser=placed,
        upside_down=upside_down,
        also=args.also,
        continued=args.continued,
        topic=args.topic,
        named=args.name,
        explain=args.explain,
        force=args.force,
        command=args.command_line,
        cache=StageCache() if args.no_cache else default_cache(),
    )
