"""`turtlebag map`: build a map from a bag or log."""

from __future__ import annotations

import argparse
from pathlib import Path

from turtlebag.pipeline.cli.arguments import add_config, add_laser, add_output, laser, output

EXAMPLE = "turtlebag map data/records/tour --out data/maps/tour --truth data/records/tour/truth"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `map`."""
    parser.add_argument("input", type=Path, metavar="INPUT", help="record folder, bag or CARMEN log")
    add_output(parser)
    text = "truth folder of the recording: adds error metrics and decides on verdict and exit code"
    parser.add_argument("--truth", type=Path, metavar="DIR", help=text)
    text = "relations file of a benchmark: adds error metrics"
    parser.add_argument("--relations", type=Path, metavar="FILE", help=text)
    parser.add_argument(
        "--also",
        type=Path,
        action="append",
        default=[],
        metavar="INPUT",
        help="another recording of the same place to add to the map; may be repeated",
    )
    parser.add_argument(
        "--continue",
        dest="continued",
        type=Path,
        metavar="MAP_DIR",
        help="extend an earlier map: INPUT is added to its graph, with the same settings",
    )
    add_laser(parser, "INPUT")
    parser.add_argument(
        "--topic",
        metavar="NAME",
        help="topic to map: LaserScan for 2D, PointCloud2 for 3D "
        "(default: /scan or the only LaserScan topic; if there is none, the point clouds)",
    )
    parser.add_argument("--name", metavar="NAME", help="also save the map as NAME.pgm and NAME.yaml")
    parser.add_argument(
        "--edits", type=Path, metavar="FILE", help="YAML file of loop closures to reject or to add"
    )
    add_config(parser)
    parser.add_argument(
        "--explain", action="store_true", help="also write why each loop closure was accepted or rejected"
    )


def run(args: argparse.Namespace) -> int:
    """Build the map; 0 done, 1 when the truth says that it is bad."""
    from turtlebag.pipeline.stages.map import build_map
    from turtlebag.pipeline.stages.map_references import References
    from turtlebag.pipeline.stages.sources import MapInputs, Source

    source = Source(args.input, *laser(args.laser), args.topic)
    return build_map(
        MapInputs(source, args.also, args.continued, args.edits),
        output(args),
        references=References.load(args.truth, args.relations),
        config=args.config,
        settings=args.settings,
        named=args.name,
        explain=args.explain,
    )
