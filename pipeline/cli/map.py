"""`turtlebag map`: build a map from a bag or log."""

from __future__ import annotations

import argparse
from pathlib import Path

from turtlebag.pipeline.cli.arguments import laser, output
from turtlebag.pipeline.cli.parser import Parser

EXAMPLE = "turtlebag map data/records/tour --out data/maps/tour --truth data/records/tour/truth"


def add_arguments(parser: Parser) -> None:
    """Arguments of `map`."""
    parser.option("input", "INPUT", "record folder, bag or CARMEN log", Path)
    parser.add_output()
    text = "truth folder of the recording: adds error metrics and decides on verdict and exit code"
    parser.option("--truth", "DIR", text, Path)
    parser.option("--relations", "FILE", "relations file of a benchmark: adds error metrics", Path)
    text = "another recording of the same place to add to the map; may be repeated"
    parser.repeated("--also", "INPUT", text, Path)
    text = "extend an earlier map: INPUT is added to its graph, with the same settings"
    parser.option("--continue", "MAP_DIR", text, Path, dest="continued")
    parser.add_laser("INPUT")
    text = (
        "topic to map: LaserScan for 2D, PointCloud2 for 3D "
        "(default: /scan or the only LaserScan topic; if there is none, the point clouds)"
    )
    parser.option("--topic", "NAME", text)
    parser.option("--name", "NAME", "also save the map as NAME.pgm and NAME.yaml")
    parser.option("--edits", "FILE", "YAML file of loop closures to reject or to add", Path)
    parser.add_config()
    parser.flag("--explain", "also write why each loop closure was accepted or rejected")


def run(args: argparse.Namespace) -> int:
    """Build the map; 0 done, 1 if it is bad by ground truth."""
    from turtlebag.pipeline.stages.map import build_map
    from turtlebag.pipeline.stages.sources import MapInputs, Source
    from turtlebag.reports.metrics.references import References

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
