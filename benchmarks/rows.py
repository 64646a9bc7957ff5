"""The frame of the benchmarks: command lines, cases, their rows (one JSON line each, kept), and tables."""

from __future__ import annotations

import argparse
import ast
import csv
import json
import math
import os
from collections.abc import Callable, Collection, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from turtlebag.datasets.fingerprints import fingerprint
from turtlebag.reports.metrics.statistics import share_interval

Row = dict[str, Any]
ROOT = Path(__file__).parents[1]


def options(
    doc: str, out: str = "data/benchmarks", quick: str = "", **numbers: int
) -> argparse.ArgumentParser:
    """The command line of a benchmark: `--out`, `--quick` where it has a sample, and some numbers."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawTextHelpFormatter)
    if quick:
        parser.add_argument("--quick", action="store_true", help=quick)
    parser.add_argument("--out", type=Path, default=Path(out), metavar="DIR", help=f"default: {out}")
    for name, default in numbers.items():
        parser.add_argument(f"--{name}", type=int, default=default, metavar="N", help=f"default: {default}")
    return parser


def parts_of(parser: argparse.ArgumentParser, parts: Collection[str]) -> None:
    """Words of the command line that say which parts of a benchmark are wanted: without any, all."""

    def known(word: str) -> str:
        if word not in parts:
            raise argparse.ArgumentTypeError(f"no {word!r}: there are {', '.join(parts)}")
        return word

    told = f"of {', '.join(parts)} (default: all)"
    parser.add_argument("parts", nargs="*", type=known, default=list(parts), metavar="PART", help=told)


def public(*names: str) -> Path | None:
    """A file or folder of the public data, below TURTLEBAG_DATA; None when it is not there."""
    root = os.environ.get("TURTLEBAG_DATA")
    path = Path(root, *names) if root else None
    return path if path is not None and path.exists() else None


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


def code_of(places: tuple[str, ...]) -> str:
    """Fingerprint of the code in folders and files of the project; comments and docstrings do not count."""
    found = [path for place in places for path in (ROOT / place, *(ROOT / place).rglob("*.py"))]
    files = sorted(path for path in found if path.is_file())
    return fingerprint([(path.relative_to(ROOT).as_posix(), _bare(path)) for path in files])[:16]


@cache
def _bare(path: Path) -> str:
    """The code of a file without comments and docstrings."""
    tree = ast.parse(path.read_text())
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [  # type: ignore[attr-defined]
                line
                for line in body
                if not (isinstance(line, ast.Expr) and isinstance(getattr(line.value, "value", None), str))
            ]
    return ast.dump(tree)


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

        def mine(row: Row) -> bool:
            return bool(row.get("code", "") == code)

        # Of two rows of a case one of this code counts, whichever was first.
        self._found = {row["case"]: row for row in sorted(rows, key=mine) if keep or mine(row)}

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


def markdown(rows: list[Row], columns: Iterable[str] = ()) -> str:
    """A table of rows; without `columns` those of the first."""
    columns = list(columns) or list(rows[0])
    lines = ["| " + " | ".join(columns) + " |", "|" + " --- |" * len(columns)]
    lines += ["| " + " | ".join(shown(row.get(c)).replace("|", "/") for c in columns) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def as_they_come(rows: Iterable[Row]) -> list[Row]:
    """The rows, each of them printed as soon as it is there."""
    found = []
    for row in rows:
        print("  ", row, flush=True)
        found.append(row)
    return found


def write(out: Path, name: str, rows: list[Row], columns: Iterable[str] = (), *, show: bool = True) -> None:
    """A CSV file with all of the rows and, with `show`, `columns` of it as a markdown table, printed too."""
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
    text = markdown(rows, columns)
    (out / f"{name}.md").write_text(text)
    print(f"\n{name}\n\n{text}", flush=True)
