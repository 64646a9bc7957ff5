"""`turtlebag bag`: inspect, play, repair and convert bags."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.plurals import counted
from turtlebag.pipeline.cli.arguments import output
from turtlebag.pipeline.stages.parser import Parser, add_action, positive
from turtlebag.pipeline.terminal.messages import log_notes, print_table, say

if TYPE_CHECKING:
    from turtlebag.datasets.bags.reader import BagInfo
    from turtlebag.datasets.types import Recording

EXAMPLE = "turtlebag bag info data/record"


def add_arguments(parser: Parser) -> None:
    """The actions and their arguments."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)

    def action(name: str, act: Callable[[argparse.Namespace], int], text: str, example: str) -> Parser:
        sub = add_action(actions, name, text, example)
        sub.option("bag", "BAG", "record folder, bag folder or bag file", Path)
        sub.set_defaults(run=act)
        return sub

    action("info", _info, "show topics, counts, rates and gaps", "turtlebag bag info data/record")
    action(
        "doctor",
        _doctor,
        "check a bag for defects and say what each one breaks (exit code 1 on errors)",
        "turtlebag bag doctor my_robot.bag",
    )
    sub = action(
        "play",
        _play,
        "play a recording as lines of text: clock, pose, speeds, nearest reading",
        "turtlebag bag play data/record --rate 4",
    )
    text = "playback speed (default: 1, the speed of the recording)"
    sub.option("--rate", "R", text, positive, default=1.0)
    for verb, act, text, example in (
        (
            "recover",
            _recover,
            "recover the intact messages of a truncated, damaged or unfinished bag",
            "turtlebag bag recover data/record.partial --out data/record",
        ),
        (
            "convert",
            _convert,
            "convert a bag of ROS 1 or 2 or a CARMEN log to rosbag2, whole or in part",
            "turtlebag bag convert data/record --from 10 --to 60 --out data/part",
        ),
    ):
        sub = add_action(actions, verb, text, example)
        sub.set_defaults(run=act)
        sub.later = _add_options


def _add_options(parser: Parser) -> None:
    from turtlebag.pipeline.stages.command_line import add_request
    from turtlebag.pipeline.stages.requests.table import REQUESTS

    verb = parser.prog.removeprefix("turtlebag ")
    add_request(parser, REQUESTS[verb])
    if verb == "bag convert":
        parser.add_output("folder to write the rosbag2 bag to")
    else:
        parser.add_output()


def _info(args: argparse.Namespace) -> int:
    from turtlebag.datasets.bags.reader import bag_info
    from turtlebag.datasets.bags.source import is_carmen_log

    if is_carmen_log(args.bag):
        from turtlebag.datasets.recordings import load_recording

        _print_log(load_recording(args.bag))
    else:
        _print_info(bag_info(args.bag))
    return 0


def _print_log(log_read: Recording) -> None:
    lidar, (x, y, yaw) = log_read.lidar, log_read.T_base_lidar.xyt.tolist()
    first, last = math.degrees(lidar.angles[0]), math.degrees(lidar.angles[-1])
    say(f"{log_read.source}  (CARMEN log)")
    say(f"{len(log_read)} scans, {log_read.duration():.2f} s, one every {lidar.scan_time:.3f} s")
    say(f"{lidar.n_beams} beams from {first:.1f} to {last:.1f} degrees, up to {lidar.range_max:g} m")
    say(f"laser at x {x:g} m, y {y:g} m, yaw {yaw:g} rad on the robot")
    log_notes(log_read.notes)


def _print_info(info: BagInfo) -> None:
    say(f"{info.path}  ({info.kind}, {counted(len(info.files), 'file')})")
    say(
        f"{info.count} messages, {info.duration():.2f} s, "
        f"from {info.start_ns * 1e-9:.3f} to {info.end_ns * 1e-9:.3f} s"
    )
    if info.custom:
        say(", ".join(f"{key} {value}" for key, value in info.custom.items()))
    rows = [("topic", "type", "messages", "rate, Hz", "longest gap, s")]
    for topic in info.topics:
        rate = f"{topic.rate_hz():.2f}" if topic.count > 1 else "-"
        gap = f"{topic.longest_gap_ns * 1e-9:.3f}" if topic.count > 1 else "-"
        rows.append((topic.name, topic.msgtype, str(topic.count), rate, gap))
    print_table(rows, left=(0, 1))
    log_notes(info.notes)


def _doctor(args: argparse.Namespace) -> int:
    from turtlebag.datasets.bags.doctor import examine

    findings = examine(args.bag)
    for finding in findings:
        say(f"{finding.severity}: {finding.kind}: {finding.what}")
        if finding.breaks:
            say(f"    breaks: {finding.breaks}")
        if finding.remedy:
            say(f"    here: {finding.remedy}")
        if finding.first_ns is not None:
            say(f"    first: at {finding.first_ns * 1e-9:.3f} s")
    errors, warnings = (
        counted(sum(finding.severity == severity for finding in findings), severity)
        for severity in ("error", "warning")
    )
    say(f"{errors}, {warnings}" if any(f.breaks for f in findings) else "no defect found")
    return 1 if any(finding.severity == "error" for finding in findings) else 0


def _play(args: argparse.Namespace) -> int:
    from turtlebag.pipeline.terminal.play import Player, play

    player = Player(args.bag)
    log_notes(player.recording.notes)
    # A line each recorded second.
    play(player, lambda frame: print(frame.status, flush=True), rate=args.rate, every_s=1.0 / args.rate)
    return 0


def _recover(args: argparse.Namespace) -> int:
    from turtlebag.pipeline.stages.command_line import request_of
    from turtlebag.pipeline.stages.requests.bags import RecoverRequest
    from turtlebag.pipeline.stages.run import run

    return run(request_of(RecoverRequest, args), output(args))


def _convert(args: argparse.Namespace) -> int:
    from turtlebag.pipeline.stages.command_line import request_of
    from turtlebag.pipeline.stages.requests.bags import ConvertRequest
    from turtlebag.pipeline.stages.run import run

    request = request_of(ConvertRequest, args)
    if args.out.suffix in (".gz", ".bz2"):
        raise InputError(f"--out {args.out}: bags are written unpacked; leave out {args.out.suffix}")
    if args.out.suffix == ".bag":
        source = args.bag / "bag" if (args.bag / "bag").is_dir() else args.bag
        way = f"use `rosbags-convert --src {quote(str(source))} --dst {quote(str(args.out))}`"
        raise InputError(f"--out {args.out}: ROS 1 bags are read but not written; {way}")
    return run(request, output(args))
