"""turtlebag record."""

from __future__ import annotations

import argparse
from pathlib import Path

from turtlebag.pipeline.cli.arguments import named_inputs, output, start_of
from turtlebag.pipeline.cli.parser import Parser
from turtlebag.pipeline.stages.settings import load_config

EXAMPLE = "turtlebag record --world turtlebot3_world --teleop tour --seed 1 --out data/records/world"


def add_arguments(parser: Parser) -> None:
    """Arguments of the command."""
    parser.add_world(1)
    text = "teleop script: a name, a YAML file, or a bag whose /cmd_vel is replayed (default: tour)"
    parser.option("--teleop", "SCRIPT", text, default="tour")
    parser.add_config()
    parser.add_output()


def inputs(args: argparse.Namespace) -> list[Path]:
    """World, robot and settings if they are files, and the bag whose commands are replayed."""
    from turtlebag.pipeline.stages.record import is_recording
    from turtlebag.sim.teleop_scripts import script_names

    replayed = is_recording(args.teleop) and args.teleop not in script_names()
    return [*named_inputs(args), *([Path(args.teleop)] if replayed else [])]


def run(args: argparse.Namespace) -> int:
    """Record a drive."""
    from turtlebag.pipeline.stages.record import RecordOptions, Scene, record

    options = load_config(RecordOptions, args.config, args.settings)
    scene = Scene.load(args.world, args.robot, args.seed, options.sim, start_of(args))
    return record(scene, args.teleop, output(args))
