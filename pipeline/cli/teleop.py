"""turtlebag teleop."""

from __future__ import annotations

import argparse
import sys

from turtlebag.pipeline.cli.arguments import output, positive, start_of
from turtlebag.pipeline.cli.parser import Parser
from turtlebag.pipeline.stages.settings import load_config

EXAMPLE = "turtlebag teleop --world turtlebot3_world --out data/records/mine"


def add_arguments(parser: Parser) -> None:
    """Arguments of the command."""
    parser.add_world(1)
    text = "keys: W A S D (default); turtlebot3: the keys of turtlebot3_teleop"
    parser.add_argument("--style", choices=("keys", "turtlebot3"), default="keys", help=text)
    parser.option("--speed", "X", "speed relative to real time (default: 1)", positive, default=1.0)
    parser.add_config()
    parser.add_output()


def run(args: argparse.Namespace) -> int:
    """Drive with the keyboard until Q or Ctrl-C."""
    from turtlebag.pipeline.stages.record import RecordOptions, Scene, record_drive
    from turtlebag.pipeline.terminal import keyboard_teleop
    from turtlebag.pipeline.terminal.messages import redrawn

    options = load_config(RecordOptions, args.config, args.settings)
    scene = Scene.load(args.world, args.robot, args.seed, options.sim, start_of(args))
    state = keyboard_teleop.KeyState(scene.robot.limits, args.style)
    keyboard_teleop.show(keyboard_teleop.TABLES[args.style] + "\n")
    with keyboard_teleop.keys_of(sys.stdin.fileno()) as read_keys, redrawn() as redraw:
        return record_drive(
            scene,
            keyboard_teleop.keyboard_driver(state, read_keys, keyboard_teleop.clock(args.speed)),
            f"keyboard:{args.style}",
            output(args),
            watch=keyboard_teleop.StatusLine(state, redraw),
        )
