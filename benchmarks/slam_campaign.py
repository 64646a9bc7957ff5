"""The campaign of the mapper: logs, drives and disturbances that nobody tuned on, row by row.

python -m benchmarks.slam_campaign [SUITE ...] [--quick] [--limit N] [--only PATTERN] [--workers N]
                                   [--minutes M] [--keep] [--out DIR]

Suites:
  logs       the public logs, with what others published
  disturbed  the Radish logs with relations in fifteen modes (benchmarks.disturb)
  drives     300 simulated drives: five places, two robots, every script, unseen seeds
  fast50     house, burger, `fast`, seeds 1001-1050, realistic and clean sensors
  synthetic  the synthetic logs (benchmarks.slam_logs), as they are and with four other lidars
  detector   the self-check on good and bad maps (benchmarks.slam_detector)
  worlds     the drives of docs/results.md
  ablation   each part of the mapper switched off or exchanged
  parts      the exchangeable parts on public logs and drives
  numbers    the numbers that matter most, halved and doubled (benchmarks.slam_parts)
  online     the mapper that works while the robot drives, beside the offline one
  growth     CPU seconds and memory of the whole command, by size of the log

Public logs are read from the folder in TURTLEBAG_DATA (its folders `radish` and `wild`). The order of a
suite's cases is fixed, and any first part of it (--limit) is a fair sample; --quick takes a small one of
the first six. Every map is a row, a JSON line in DIR/rows: the same command goes on where it was stopped.
Rows of other code are measured again, unless --keep. Errors [m, deg]
are those of the relations where a log has any, else after a rigid fit (`anchored`: with the first pose as
the only anchor). CPU seconds are those of mapping alone.
"""

from __future__ import annotations

import fnmatch
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.rows import Case, Row, Rows, code_of, options, public, shown, write
from benchmarks.slam_cases import drive_cases, fast_cases, synthetic_cases, world_cases
from benchmarks.slam_detector import by, detection, detector_cases, judged
from benchmarks.slam_growth import COSTS, growth_cases
from benchmarks.slam_online import COLUMNS as ONLINE
from benchmarks.slam_online import online_cases
from benchmarks.slam_parts import CHOICES, PARTS, ablation_cases, ablation_table, number_cases, number_table
from benchmarks.slam_public import COLUMNS, disturbed_cases, log_cases
from benchmarks.workers import in_processes

MAPPER = ("datasets", "pipeline/slam", "benchmarks/slam_scores.py")
SIMULATED = (*MAPPER, "sim")
DISTURBED = (*MAPPER, "benchmarks/known.py", "benchmarks/disturb.py")
SYNTHETIC = (*DISTURBED, "sim", *(f"benchmarks/slam_{name}.py" for name in ("logs", "drives", "plans")))
LIMIT_MINUTES = 30.0
BASICS = ("case", "scans", "m", "deg", "worst_m")
ENDS = ("verdict", "reasons", "loops", "cpu_s", "error")
EXACT = (*BASICS, "scaled_m", "anchored_m", "anchored_worst_m")
WORLD = (*EXACT, "within", "iou", "walls", "stuck")
RELATIONS = ("case", "scans", "m", "deg", "before_m", "before_deg", "ratio", "scored by")
MADE = (*EXACT, "near_deg", "folded", "driven_m", "odometry_m")


@dataclass(frozen=True)
class Suite:
    """Cases with one table, of which `quick` are a sample.

    `summary` makes a second table of all rows, and `complete` adds to each row what only all of them tell.
    """

    cases: Sequence[Case]
    columns: tuple[str, ...]
    summary: Callable[[list[Row]], list[Row]] | None = None
    complete: Callable[[list[Row]], list[Row]] = list
    quick: int = 0
    code: tuple[str, ...] = MAPPER


def suites(out: Path, data: Path | None) -> dict[str, Suite]:
    """Every suite by name; without the public logs those that need them have no cases."""
    logs, disturbed = (log_cases(data, out), disturbed_cases(data)) if data else ([], [])
    drives = by("world", "robot", "teleop")
    grown = (*SYNTHETIC, "pipeline/stages/map.py", "benchmarks/slam_growth.py")
    return {
        "logs": Suite(logs, (*BASICS, *COLUMNS, *ENDS), quick=99),
        "disturbed": Suite(disturbed, (*RELATIONS, *ENDS), quick=15, code=DISTURBED),
        "drives": Suite(drive_cases(), (*WORLD, *ENDS), drives, quick=12, code=SIMULATED),
        "fast50": Suite(fast_cases(), (*EXACT, *ENDS), by("sensors"), quick=6, code=SIMULATED),
        "synthetic": Suite(synthetic_cases(out), (*MADE, *ENDS), by("lidar"), quick=20, code=SYNTHETIC),
        "detector": Suite(
            detector_cases(), ("half", *EXACT, "limit_m", "bad", *ENDS), detection, judged, 26, SYNTHETIC
        ),
        "worlds": Suite(world_cases(out), (*WORLD, "near_deg", *ENDS), code=SIMULATED),
        "ablation": Suite(ablation_cases(data), (*EXACT, *ENDS), ablation_table, code=SYNTHETIC),
        "parts": Suite(ablation_cases(data, CHOICES, PARTS), (*EXACT, *ENDS), ablation_table, code=SYNTHETIC),
        "numbers": Suite(number_cases(data), (*EXACT, *ENDS), number_table, code=SYNTHETIC),
        "online": Suite(online_cases(data), ONLINE, quick=8, code=SYNTHETIC),
        "growth": Suite(growth_cases(data), ("case", *COSTS, "error"), code=grown),
    }


def chosen(suite: Suite, limit: int | None, pattern: str) -> Suite:
    """The suite's first cases of those that fit a pattern."""
    cases = [case for case in suite.cases if fnmatch.fnmatch(case.name, pattern)]
    return replace(suite, cases=cases[:limit])


def measure(name: str, suite: Suite, rows: Rows, workers: int, limit_s: float) -> None:
    """Measure what has no row yet."""
    waiting = [case for case in suite.cases if rows.get(case.name) is None]
    print(f"{name}: {len(suite.cases)} cases, {len(waiting)} to measure", flush=True)
    for case, row in in_processes(waiting, workers, limit_s):
        row = rows.add(case.name, row)
        keys = ("error",) if "error" in row else ("m", "worst_m", "anchored_worst_m", "verdict", "cpu_s")
        told = ", ".join(f"{key} {shown(row[key])}" for key in keys if row.get(key) is not None)
        print(f"  {case.name}: {told}", flush=True)


def tables(out: Path, name: str, suite: Suite, rows: list[Row]) -> None:
    """Write and print a suite's tables."""
    write(out, name, suite.complete(rows), suite.columns)
    if suite.summary and rows:
        write(out, f"{name}-summary", suite.summary(rows))


def main(argv: Sequence[str] | None = None) -> None:
    """Measure what is asked for, print and write the tables."""
    parser = options(__doc__, "data/benchmarks/slam", "a sample that takes less than 20 minutes")
    parser.add_argument("suites", nargs="*", metavar="SUITE", help="these suites (default: all)")
    parser.add_argument("--limit", type=int, metavar="N", help="the first N cases of each suite")
    parser.add_argument("--only", default="*", metavar="PATTERN", help="cases whose names fit, say 'intel-*'")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, metavar="N", help="processes")
    late = "a case that takes longer is an error"
    parser.add_argument("--minutes", type=float, default=LIMIT_MINUTES, metavar="M", help=late)
    parser.add_argument("--keep", action="store_true", help="rows of other code count, too")
    args = parser.parse_args(argv)
    data = public() if public("radish") else None
    known = suites(args.out.absolute(), data)
    names = args.suites or [name for name, suite in known.items() if suite.quick or not args.quick]
    if wrong := [name for name in names if name not in known]:
        parser.error(f"no suite {wrong[0]!r}: there are {', '.join(known)}")
    if args.workers < 1 or (args.limit is not None and args.limit < 1) or args.minutes <= 0.0:
        parser.error("--workers, --limit and --minutes must be positive")
    if data is None:
        print("TURTLEBAG_DATA names no folder with a folder `radish`: public logs are left out", flush=True)
    with tempfile.TemporaryDirectory(prefix="turtlebag-") as scratch:
        os.environ["TMPDIR"] = scratch  # of the workers: what one that is killed leaves goes with it
        for name in names:
            limit = known[name].quick if args.quick and args.limit is None else args.limit
            suite = chosen(known[name], limit, args.only)
            rows = Rows(args.out / "rows" / f"{name}.jsonl", code_of(suite.code), keep=args.keep)
            try:
                measure(name, suite, rows, args.workers, 60.0 * args.minutes)
            except KeyboardInterrupt:
                print("stopped; the same command goes on from here", file=sys.stderr)
                raise SystemExit(130) from None
            tables(args.out, name, suite, rows.of(suite.cases))


if __name__ == "__main__":
    main()
