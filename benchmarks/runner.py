"""The frame of the benchmarks: suites of cases, their rows (one JSON line each, kept), and their tables."""

from __future__ import annotations

import argparse
import ast
import csv
import fnmatch
import itertools
import json
import math
import multiprocessing
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from queue import SimpleQueue
from typing import Any, get_args

from turtlebag.datasets.outputs import sha256_text
from turtlebag.reports.metrics.statistics import share_interval

Row = dict[str, Any]
ROOT = Path(__file__).parents[1]
SPAWN = multiprocessing.get_context("spawn")


def options(
    doc: str, out: str = "data/benchmarks", quick: str = "", *, sensors: bool = False, **numbers: int
) -> argparse.ArgumentParser:
    """The command line of a benchmark: `--out`, `--quick` where it has a sample, `--sensors` where its tables
    lie in a folder of each set, and some numbers."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawTextHelpFormatter)
    parser.set_defaults(quick=False, sensors="")
    if quick:
        parser.add_argument("--quick", action="store_true", help=quick)
    if sensors:
        from turtlebag.sim.simulator import Sensors  # each process of a campaign would load Bullet, too

        parser.add_argument("--sensors", choices=get_args(Sensors), default="realistic")
    parser.add_argument("--out", type=Path, default=Path(out), metavar="DIR", help=f"default: {out}")
    for name, default in numbers.items():
        parser.add_argument(f"--{name}", type=int, default=default, metavar="N", help=f"default: {default}")
    return parser


def public(*names: str) -> Path | None:
    """A file or folder of the public data, below TURTLEBAG_DATA; None when it is not there."""
    root = os.environ.get("TURTLEBAG_DATA")
    path = Path(root, *names) if root else None
    return path if path is not None and path.exists() else None


def public_log(name: str) -> Path | None:
    """A log of the public data by its name; None when it is not there."""
    return public("radish", f"{name}.clf.bz2") or public("wild", f"{name}.clf.bz2")


def held_mb(process: int | str = "self") -> float:
    """Memory that a process holds now [MB]."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


@dataclass(frozen=True)
class Case:
    """What is measured: `measure` gives the figures, `about` says what it is. Both go to another process."""

    name: str
    measure: Callable[[], Row]
    about: Row = field(default_factory=dict)


def each(measure: Callable[..., Row], names: Iterable[str], rows: Iterable[Iterable[Any]]) -> list[Case]:
    """A case for each row of values of some arguments of `measure`."""
    names = tuple(names)
    abouts = [dict(zip(names, row, strict=True)) for row in rows]
    return [Case(" ".join(map(str, about.values())), partial(measure, **about), about) for about in abouts]


def every(measure: Callable[..., Row], **levels: Iterable[Any]) -> list[Case]:
    """A case for each combination of the levels of some arguments of `measure`."""
    return each(measure, levels, itertools.product(*levels.values()))


@dataclass(frozen=True)
class Suite:
    """Cases with one table, of which the first `quick` are a sample.

    `summary` makes a second table of all rows, and `complete` adds to each row what only all of them tell.
    Rows stand while the `code` in these folders and files of the project is the same; without, none stands.
    """

    cases: Sequence[Case]
    columns: tuple[str, ...] = ()
    summary: Callable[[list[Row]], list[Row]] | None = None
    complete: Callable[[list[Row]], list[Row]] = list
    quick: int = 0
    code: tuple[str, ...] | None = None
    show: bool = True


def code_of(places: tuple[str, ...], root: Path = ROOT) -> str:
    """Fingerprint of the code in folders and files of the project; comments do not count."""
    found = [path for place in places for path in (root / place, *(root / place).rglob("*.py"))]
    files = sorted(path for path in found if path.is_file())
    read = [(path.relative_to(root).as_posix(), _bare(path.read_text())) for path in files]
    return sha256_text(repr(read))[:16]


@cache
def _bare(source: str) -> str:
    """Code without comments."""
    return ast.dump(ast.parse(source))


class Rows:
    """Rows by case in a file of JSON lines that only grows: a row is on disk when `add` returns.

    A row of other code counts with `keep` only. A line that was cut when the power went is none.
    """

    def __init__(self, file: Path, code: str = "", *, keep: bool = False) -> None:
        self._file, self._code = file, code
        file.parent.mkdir(parents=True, exist_ok=True)
        text = file.read_text() if file.exists() else ""
        self._cut = not text.endswith("\n") and text != ""
        rows: list[Row] = []
        for line in text.splitlines():
            with suppress(json.JSONDecodeError):
                rows.append(json.loads(line))

        # Of two rows of a case one of this code counts, whichever was first.
        rows.sort(key=lambda row: row.get("code", "") == code)
        self._found = {row["case"]: row for row in rows if keep or row.get("code", "") == code}

    def get(self, case: str) -> Row | None:
        """The row of a case, if it was measured."""
        return self._found.get(case)

    @property
    def all(self) -> list[Row]:
        """Every row, in the order in which cases were first measured."""
        return list(self._found.values())

    def add(self, case: str, row: Row) -> Row:
        """Keep the row of a case."""
        row = {"case": case, **row} | ({"code": self._code} if self._code else {})
        with self._file.open("a") as file:
            file.write(("\n" if self._cut else "") + json.dumps(row) + "\n")
        self._cut = False
        self._found[case] = row
        return row

    def of(self, cases: Iterable[Case]) -> list[Row]:
        """The rows there are, in the order of the cases."""
        return [self._found[case.name] for case in cases if case.name in self._found]


def measured(case: Case, limit_s: float) -> Row:
    """The row of a case; one that raises has a row that says so, the process of a late one is ended."""
    signal.setitimer(signal.ITIMER_REAL, limit_s)
    try:
        return {**case.about, **case.measure()}
    except Exception as error:
        return {**case.about, "error": f"{type(error).__name__}: {error}"}
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def in_processes(cases: Sequence[Case], count: int, limit_s: float) -> Iterator[tuple[Case, Row]]:
    """Cases and their rows as they come, from `count` processes; none takes longer than `limit_s` [s].

    A case that hangs, raises or dies ends none but itself: each process is a pool of its own, and where one
    has ended, the next case has a new one.
    """
    idle: SimpleQueue[ProcessPoolExecutor] = SimpleQueue()
    for _ in range(count):
        idle.put(ProcessPoolExecutor(1, SPAWN))

    def measure(case: Case) -> tuple[Case, Row]:
        pool, begun = idle.get(), time.monotonic()
        try:
            return case, pool.submit(measured, case, limit_s).result()
        except BrokenProcessPool:
            late, pool = time.monotonic() - begun >= limit_s, ProcessPoolExecutor(1, SPAWN)
            why = f"took more than {limit_s:.0f} s" if late else "its process died"
            return case, {**case.about, "error": why}
        finally:
            idle.put(pool)

    with ThreadPoolExecutor(count) as threads:
        try:
            for done in as_completed([threads.submit(measure, case) for case in cases]):
                yield done.result()
        finally:  # also when nobody wants the rest any more
            threads.shutdown(cancel_futures=True)
            while not idle.empty():
                idle.get().shutdown()


def interval(successes: int, n: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share; all of 0..1 when there is nothing."""
    found = share_interval(successes, n)
    return found.low or 0.0, 1.0 if found.high is None else found.high


def share(successes: int, n: int) -> str:
    """A share as counts, with its interval."""
    low, high = interval(successes, n)
    return f"{successes} of {n} ({100 * low:.1f}..{100 * high:.1f} %)"


def grouped(rows: Iterable[Row], *keys: str) -> dict[tuple, list[Row]]:
    """Rows by the values of some columns, in the order in which those come first."""
    groups: dict[tuple, list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return groups


def shown(value: Any) -> str:
    """A value as a table shows it."""
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.4f}" if abs(value) < 10.0 else f"{value:.1f}"
    if isinstance(value, list):
        return "; ".join(map(str, value))
    return "" if value is None else str(value)


def write(out: Path, name: str, rows: list[Row], columns: Iterable[str] = (), *, show: bool = True) -> None:
    """A CSV file with all of the rows and, with `show`, a markdown table of `columns` (without: those of the
    first row), printed too."""
    if not rows:
        return
    everything = list(dict.fromkeys(key for row in rows for key in row))
    out.mkdir(parents=True, exist_ok=True)
    with (out / f"{name}.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, everything, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    if not show:
        return
    columns = list(columns) or [key for key in rows[0] if key != "code"]
    lines = [columns, ["---"] * len(columns)]
    lines += [[shown(row.get(column)).replace("|", "/") for column in columns] for row in rows]
    text = "".join(f"| {' | '.join(line)} |\n" for line in lines)
    (out / f"{name}.md").write_text(text)
    print(f"\n{name}\n\n{text}", flush=True)


def rows_file(out: Path, suite: str) -> Path:
    """Where the rows of a suite are kept."""
    return out / "rows" / f"{suite}.jsonl"


def parsed(
    parser: argparse.ArgumentParser,
    suites: Callable[[argparse.Namespace], dict[str, Suite]],
    argv: Sequence[str] | None = None,
    *,
    workers: int = 1,
) -> tuple[argparse.Namespace, dict[str, Suite]]:
    """The command line of `run`, with the suites asked for named, and all suites."""
    parser.add_argument("suites", nargs="*", metavar="SUITE", help="these suites (default: all)")
    parser.add_argument("--limit", type=int, metavar="N", help="the first N cases of each suite")
    parser.add_argument("--only", default="*", metavar="PATTERN", help="cases whose names fit, say 'intel *'")
    parser.add_argument("--workers", type=int, default=workers, metavar="N", help="processes")
    late = "a case that takes longer is an error"
    parser.add_argument("--minutes", type=float, default=30.0, metavar="M", help=late)
    parser.add_argument("--keep", action="store_true", help="rows of other code count, too")
    args = parser.parse_args(argv)
    if args.workers < 1 or (args.limit is not None and args.limit < 1) or args.minutes <= 0.0:
        parser.error("--workers, --limit and --minutes must be positive")
    known = suites(args)
    if wrong := [name for name in args.suites if name not in known]:
        parser.error(f"no suite {wrong[0]!r}: there are {', '.join(known)}")
    args.suites = args.suites or [name for name, suite in known.items() if suite.quick or not args.quick]
    return args, known


def run(args: argparse.Namespace, known: dict[str, Suite]) -> dict[str, list[Row]]:
    """Measure what has no row yet of the suites of a command line, write their tables; the rows of each."""
    args.out /= args.sensors
    found: dict[str, list[Row]] = {}
    with tempfile.TemporaryDirectory(prefix="turtlebag-") as scratch:
        os.environ["TMPDIR"] = scratch  # of the workers: what one that is killed leaves goes with it
        for name in args.suites:
            suite = known[name]
            cases = [case for case in suite.cases if fnmatch.fnmatch(case.name, args.only)]
            cases = cases[: suite.quick if args.quick and args.limit is None else args.limit]
            rows = Rows(rows_file(args.out, name), code_of(suite.code or ()), keep=args.keep)
            waiting = [case for case in cases if suite.code is None or rows.get(case.name) is None]
            print(f"{name}: {len(cases)} cases, {len(waiting)} to measure", flush=True)
            try:
                for case, row in in_processes(waiting, args.workers, 60.0 * args.minutes):
                    told = ", ".join(
                        f"{key} {shown(row[key])}" for key in row if row[key] != case.about.get(key)
                    )
                    print(f"  {case.name}: {told}", flush=True)
                    rows.add(case.name, row)
            except KeyboardInterrupt:
                print("stopped; the same command goes on from here", file=sys.stderr)
                raise SystemExit(130) from None
            found[name] = suite.complete(rows.of(cases))
            write(args.out, name, found[name], suite.columns, show=suite.show)
            if suite.summary and found[name]:
                write(args.out, f"{name}-summary", suite.summary(found[name]))
    return found
