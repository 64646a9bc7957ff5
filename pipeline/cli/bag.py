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
from turtlebag.pipeline.cli.arguments import output, positive, refuse, seconds
from turtlebag.pipeline.cli.parser import Parser, add_action
from turtlebag.pipeline.terminal.messages import log, log_notes, print_table, say

if TYPE_CHECKING:
    from turtlebag.datasets.bags.reader import BagInfo
    from turtlebag.datasets.bags.selection import Selection
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
    sub = action(
        "recover",
        _recover,
        "recover the intact messages of a truncated, damaged or unfinished bag",
        "turtlebag bag recover data/record.partial --out data/record",
    )
    sub.add_output()
    sub = action(
        "convert",
        _convert,
        "convert a bag of ROS 1 or 2 or a CARMEN log to rosbag2, whole or in part",
        "turtlebag bag convert data/record --from 10 --to 60 --out data/part",
    )
    sub.add_output("folder to write the rosbag2 bag to")
    text = "storage format (default: mcap)"
    sub.add_argument("--storage", choices=("mcap", "sqlite3"), help=text)
    sub.repeated("--exclude", "TOPIC", "topic to leave out; may be repeated")
    text = "drop every transform whose child is FRAME, in /tf and /tf_static; may be repeated"
    sub.repeated("--exclude-frame", "FRAME", text, _frame)
    text = "copy from this time on, in seconds from the bag's beginning (default: 0)"
    sub.option("--from", "S", text, seconds)
    text = "copy up to this time, in seconds from the bag's beginning (default: its end)"
    sub.option("--to", "S", text, seconds)


def _info(args: argparse.Namespace) -> int:
    from turtlebag.datasets.bags.reader import bag_info

    if _is_log(args.bag):
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
    from turtlebag.datasets.bags.recover import recover

    out = output(args)
    with out.staged() as folder:
        saved = recover(args.bag, folder / "bag")
        out.finish(folder, "bag recover", {"bag": args.bag})
    log_notes(saved.notes)
    span = (saved.end_ns - saved.start_ns) * 1e-9
    log.info(f"saved {counted(saved.messages, 'message')} over {span:.2f} s -> {args.out}")
    return 0


def _frame(text: str) -> str:
    """A frame's name without ROS 1's leading slash."""
    return text.lstrip("/")


def _convert(args: argparse.Namespace) -> int:
    from turtlebag.datasets.bags import convert
    from turtlebag.datasets.bags.selection import Selection

    if not args.bag.exists():
        raise InputError(f"{args.bag}: no such file or folder")
    if args.out.suffix in (".gz", ".bz2"):
        raise InputError(f"--out {args.out}: bags are written unpacked; leave out {args.out.suffix}")
    if args.out.suffix == ".bag":
        source = args.bag / "bag" if (args.bag / "bag").is_dir() else args.bag
        way = f"use `rosbags-convert --src {quote(str(source))} --dst {quote(str(args.out))}`"
        raise InputError(f"--out {args.out}: ROS 1 bags are read but not written; {way}")
    if _is_log(args.bag):
        why = "a CARMEN log is converted whole; convert it, then the bag that it becomes"
        refuse(args, ("exclude", "exclude_frame", "from", "to"), why)
    start_s, end_s = getattr(args, "from") or 0.0, math.inf if args.to is None else args.to
    if end_s <= start_s:
        raise InputError(f"--to {end_s:g}: must be later than --from {start_s:g}")
    selection = Selection(tuple(args.exclude), tuple(args.exclude_frame), start_s, end_s)
    out = output(args)
    with out.staged() as folder:
        count, notes = _to_folder(args, folder / "bag", selection)
        convert.require_messages(args.bag, count, notes)
        out.finish(folder, "bag convert", {"bag": args.bag})
    log_notes(notes)
    log.info(f"{counted(count, 'message')} -> {args.out}")
    return 0


def _to_folder(args: argparse.Namespace, folder: Path, selection: Selection) -> tuple[int, list[str]]:
    from turtlebag.datasets.bags import convert
    from turtlebag.datasets.recordings import load_recording

    if args.storage == "sqlite3":
        return convert.to_sqlite3(_a_bag(args.bag), folder, selection)
    if _is_log(args.bag):
        return convert.carmen_to_mcap(load_recording(args.bag), folder)
    return convert.to_mcap(args.bag, folder, selection)


def _is_log(path: Path) -> bool:
    from turtlebag.datasets.bags.source import is_bag

    names = path.name.lower().split(".")
    return path.is_file() and not is_bag(path) and bool({"clf", "log", "carmen"} & set(names[1:]))


def _a_bag(path: Path) -> Path:
    if _is_log(path):
        raise InputError(f"{path}: a CARMEN log can only be converted to rosbag2 with mcap storage")
    return path
