"""What commands cost as whole processes: mapping, the demo's chain with report and verify, the first sign.

python -m benchmarks.commands [SUITE ...] [--out DIR]

Suites:
  map    the arena's tour, Intel, and ACES there and back to 20,000 scans (TURTLEBAG_DATA)
  demo   the arena recorded, mapped, patrolled and reported, and verify, which does all that again
  first  until the first words on a terminal

Seconds are those of the processor, user and system, a compiler's not among them.
"""

from __future__ import annotations

import os
import pty
import select
import signal
import sys
from argparse import Namespace
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from llvmlite.binding import get_host_cpu_name

from benchmarks.runner import Case, Row, Suite, every, options, parsed, public_log, run
from benchmarks.slam_cost import COSTS, GROWN, driven_row, log_row, metered

COMMAND = [sys.executable, "-m", "pipeline"]
WAIT_S = 60.0


def chain(folder: Path) -> dict[str, list[str]]:
    """The demo's commands by their verbs; each reads what those before it wrote."""
    record, drawn, patrol, page = (str(folder / name) for name in ("record", "map", "patrol", "page"))
    world, patrolled = ["--world", "turtlebot3_world"], ["--task", "patrol", "--initial-pose", "start"]
    return {
        "record": ["record", *world, "--teleop", "tour", "--out", record],
        "map": ["map", record, "--truth", f"{record}/truth", "--out", drawn],
        "navigate": ["navigate", *world, *patrolled, "--map", f"{drawn}/map.yaml", "--out", patrol],
        "report": ["report", record, drawn, patrol, "--out", page],
        "verify": ["verify", page],
    }


def demo(folder: Path) -> Row:
    """Seconds of each command of the demo; twice, as the first time may compile, and the second counts."""
    for _ in range(2):
        row = {}
        for verb, words in chain(folder).items():
            force = [] if verb == "verify" else ["--force"]
            row[verb], _ = metered([*COMMAND, *words, "-q", *force])
    return row | {"verify by stages": row["verify"] / (sum(row.values()) - row["verify"])}


def first(verb: str, folder: Path) -> Row:
    """Seconds until a command's first words on a terminal; what it needs must be there, or it says so."""
    words = chain(folder)[verb]
    command = [*COMMAND, *words, *([] if verb == "verify" else ["--force"])]
    return {"first_s": round(min(_until_words(command) for _ in range(3)), 2)}


def _until_words(command: Sequence[str]) -> float:
    child, terminal = pty.fork()
    if child == 0:
        os.execv(command[0], command)
    select.select([terminal], [], [], WAIT_S)
    ticks = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()[11:13]
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    os.close(terminal)
    return sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")


def suites(args: Namespace) -> dict[str, Suite]:
    """A table each."""
    folder = args.out.absolute() / "demo"
    logs = {"Intel": public_log("intel"), GROWN: public_log("aces")}
    maps = [Case("arena, tour", partial(driven_row, "turtlebot3_world", "burger", 1))]
    maps += [Case(name, partial(log_row, log, name == GROWN)) for name, log in logs.items() if log]
    return {
        "map": Suite(maps, ("case", *COSTS, "error")),
        "demo": Suite([Case("arena", partial(demo, folder))]),
        "first": Suite(every(partial(first, folder=folder), verb=tuple(chain(folder)))),
    }


if __name__ == "__main__":
    print(f"{get_host_cpu_name()}, {os.cpu_count()} cores")
    run(*parsed(options(__doc__, "data/benchmarks/commands"), suites))
