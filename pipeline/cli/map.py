"""`turtlebag map`: build a map from a bag or log."""

from __future__ import annotations

import argparse
from pathlib import Path

from turtlebag.pipeline.cli.arguments import (
    REPEATED,
    add_config,
    add_laser,
    add_output,
    flag,
    laser,
    option,
    output,
)

EXAMPLE = "turtlebag map data/records/tour --out data/maps/tour --truth data/records/tour/truth"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `map`."""
    option(parser, "input", "INPUT", "record folder, bag or CARMEN log", Path)
    add_output(parser)
    text = "truth folder of the recording: adds error metrics and decides on verdict and exit code"
    option(parser, "--truth", "DIR", text, Path)
    option(parser, "--relations", "FILE", "relations file of a benchmark: adds error metrics", Path)
    text = "another recording of the same place to add to the map; may be repeated"
    option(parser, "--also", "INPUT", text, Path, **REPEATED)
    text = "extend an earlier map: INPUT is added to its graph, with the same settings"
    option(parser, "--continue", "MAP_DIR", text, Path, dest="continued")
    add_laser(parser, "INPUT")
    text = (
        "topic to map: LaserScan for 2D, PointCloud2 for 3D "
        "(default: /scan or the only LaserScan topic; if there is none, the point clouds)"
    )
    option(parser, "--topic", "NAME", text)
    option(parser, "--name", "NAME", "also save the map as NAME.pgm and NAME.yaml")
    option(parser, "--edits", "FILE", "YAML file of loop closures to reject or to add", Path)
    add_config(parser)
    flag(parser, "--explain", "also write why each loop closure was accepted or rejected")


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
