"""`turtlebag bag`: look at bags."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console
from rich.table import Table

from datasets.bags.reader import BagInfo, bag_info
from pipeline.console import log

EXAMPLE = "turtlebag bag info data/record"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The actions and theirs."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    info = actions.add_parser("info", help="topics, counts, rates and gaps")
    info.add_argument("bag", type=Path, metavar="BAG", help="record folder, bag folder or bag file")
    info.set_defaults(act=_info)


def run(args: argparse.Namespace) -> int:
    """Do the action."""
    return int(args.act(args))


def _info(args: argparse.Namespace) -> int:
    _print_info(bag_info(args.bag))
    return 0


def _print_info(info: BagInfo) -> None:
    console = Console(width=120, highlight=False)
    console.print(f"{info.path}  ({info.kind}, {len(info.files)} file{'s' * (len(info.files) != 1)})")
    console.print(
        f"{info.count} messages, {info.duration():.2f} s, "
        f"from {info.start_ns * 1e-9:.3f} to {info.end_ns * 1e-9:.3f} s"
    )
    table = Table(box=None, pad_edge=False)
    for name in ("topic", "type"):
        table.add_column(name, overflow="fold")
    for name in ("messages", "rate, Hz", "longest gap, s"):
        table.add_column(name, justify="right")
    for topic in info.topics:
        rate = f"{topic.rate_hz():.2f}" if topic.count > 1 else "-"
        gap = f"{topic.longest_gap_ns * 1e-9:.3f}" if topic.count > 1 else "-"
        table.add_row(topic.name, topic.msgtype, str(topic.count), rate, gap)
    console.print(table)
    for note in info.notes:
        log.warning("note: %s", note)
