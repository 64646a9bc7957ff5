"""turtlebag blame: map a recording with one part replaced by the truth."""

from __future__ import annotations

import argparse
from pathlib import Path

from datasets.errors import InputError
from datasets.maps import save_map
from datasets.outputs import Stopwatch, staged_output, write_json, write_manifest
from datasets.trajectories import save_tum
from pipeline.campaign.oracle import PARTS, with_sensors, with_truth
from pipeline.commands.arguments import add_config, add_output
from pipeline.config import config_text, load_config
from pipeline.console import track
from pipeline.slam.slam import SlamConfig, run_slam
from reports.metrics.map import map_metrics
from reports.metrics.trajectory import trajectory_metrics
from reports.stages import load_stage

EXAMPLE = "turtlebag blame data/records/world --replace odometry --out data/blame"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of `turtlebag blame`."""
    parser.add_argument("record", type=Path, metavar="DIR", help="output of record")
    parser.add_argument(
        "--replace", default="none", metavar="PARTS", help=f"by truth: none, or some of {', '.join(PARTS)}"
    )
    add_config(parser)
    add_output(parser)


def run(args: argparse.Namespace) -> int:
    """Write the map outputs with the errors that are left."""
    watch = Stopwatch()
    parts = [] if args.replace == "none" else args.replace.split(",")
    for part in parts:
        if part not in PARTS:
            raise InputError(f"--replace {part}: known are none, {', '.join(PARTS)}")
    record = load_stage(args.record)
    if record.kind != "record" or record.truth is None or record.true_map is None:
        raise InputError(f"{args.record}: blame needs the output of record, with its truth")
    config = with_sensors(load_config(SlamConfig, args.config, args.settings), parts)
    result = run_slam(with_truth(record, parts), config, lambda items, text, total: track(items, text, total))
    with staged_output(args.out, force=args.force) as folder:
        save_map(result.grid, folder)
        save_tum(result.trajectory, folder / "trajectory.tum")
        errors = trajectory_metrics(result.trajectory, record.truth)
        left = {"replaced": parts, **errors, "map": map_metrics(result.grid, record.true_map)}
        write_json(folder / "metrics.json", left)
        (folder / "config.yaml").write_text(config_text(config))
        write_manifest(
            folder,
            stage="blame",
            command=args.command_line,
            inputs={"source": args.record},
            seed=None,
            wall_s=watch.seconds(),
        )
    return 0
