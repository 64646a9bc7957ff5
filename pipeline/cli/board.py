"""turtlebag board: the standard drives, our systems on them, and the score of anybody's result."""

from __future__ import annotations

import argparse
from pathlib import Path

from turtlebag.datasets.errors import InputError
from turtlebag.pipeline.cli.arguments import output
from turtlebag.pipeline.stages.parser import Parser, add_action, count
from turtlebag.pipeline.terminal.messages import say, starting

EXAMPLE = "turtlebag board --out data/board"
SUBMITTED = "turtlebag board submit poses.tum --input house-realistic-1 --out data/submission"


def add_arguments(parser: Parser) -> None:
    """Arguments of the command, and of its action."""
    parser.add_output(required=False)
    text = "make rows only of inputs whose names fit, such as 'arena-*' or 'barn-*-1' (default: all)"
    parser.option("--inputs", "PATTERN", text, default="*", dest="pattern")
    parser.option("--workers", "N", "local processes (default: one per core)", count)
    actions = parser.add_subparsers(dest="action", metavar="ACTION")
    text = "score poses of yours against the truth of an input, which is made again for it"
    sub = add_action(actions, "submit", text, SUBMITTED)
    sub.option("poses", "TUM", "poses of the robot's base, in the TUM format", Path)
    sub.option("--input", "ID", "the input that they are of, as the page names it", required=True)
    sub.add_output()
    sub.set_defaults(run=_submit)


def run(args: argparse.Namespace) -> int:
    """Run what is left of the board, and print the path of its page."""
    if args.out is None:
        raise InputError("board: --out DIR is needed")
    starting()
    from turtlebag.pipeline.board.board import PAGE, board

    code = board(output(args), inputs=args.pattern, workers=args.workers)
    say(str(args.out / PAGE))
    return code


def _submit(args: argparse.Namespace) -> int:
    from turtlebag.pipeline.board.submit import submit
    from turtlebag.pipeline.terminal.messages import log
    from turtlebag.reports.numbers import shown

    found = submit(args.poses, args.input, output(args))
    if not found["same_input"]:
        log.warning(f"{args.input}: this machine makes another bag of it than the stated one; compare sha256")
    rmse, largest = (shown(found["ate_m"][key], "mm") for key in ("rmse", "max"))
    say(f"trajectory error {rmse} RMSE, {largest} at most")
    say(f"after alignment {shown(found['ate_aligned_m']['rmse'], 'mm')} RMSE")
    say(f"drift per metre {shown(found['rpe']['trans_m'], 'cm/m')}")
    say(f"{found['poses']} poses, over {shown(found['covered'], 'percent')} of the drive")
    return 0
