"""Benchmark logs as OMPL writes them; OMPL's own reader makes of them the database for Planner Arena."""

from __future__ import annotations

import contextlib
import io
import math
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path

SEED = 7
"""Of the first query of each map; the next have the next."""
STATUS = (
    "Unknown status", "Invalid start", "Invalid goal", "Unrecognized goal type", "Timeout",
    "Approximate solution", "Exact solution",
)  # fmt: skip
TIMEOUT, EXACT = STATUS.index("Timeout"), STATUS.index("Exact solution")
PROPERTIES = {
    "solved": "BOOLEAN",
    "correct solution": "BOOLEAN",
    "approximate solution": "BOOLEAN",
    "status": "ENUM",
    "time": "REAL",
    "simplification time": "REAL",
    "solution length": "REAL",
    "length over shortest": "REAL",
    "solution clearance": "REAL",
}
"""Measured of each run; every time includes the smoothing of the path."""


def write_log(
    path: Path, experiment: str, robot: str, setup: str, runs: Mapping[str, Sequence[Mapping[str, float]]]
) -> None:
    """One experiment: `runs` of each planner are rows of solved, correct, time_ms ... clearance_m.

    Without host and date, so that only the times differ when it is repeated.
    """
    count = max(len(rows) for rows in runs.values())
    lines = [
        f"OMPL version {version('ompl')}", f"Experiment {experiment}", "1 experiment properties",
        f"robot TEXT = {robot}", "Running on -", "Starting at -", "<<<|", setup, "|>>>",
        f"{SEED} is the random seed", "0 seconds per run", "0 MB per run", f"{count} runs per planner",
        "0 seconds spent to collect the data", "1 enum type", "|".join(("status", *STATUS)),
        f"{len(runs)} planners",
    ]  # fmt: skip
    for planner, rows in runs.items():
        lines += [f"geometric_{planner}", "0 common properties", f"{len(PROPERTIES)} properties for each run"]
        lines += [f"{name} {kind}" for name, kind in PROPERTIES.items()]
        lines += [f"{len(rows)} runs", *(_values(row) for row in rows), "."]
    path.write_text("\n".join(lines) + "\n")


def _values(row: Mapping[str, float]) -> str:
    solved = bool(row["solved"])
    values = [solved, row["correct"], 0, EXACT if solved else TIMEOUT, row["time_ms"] / 1e3, 0.0]
    values += [row["length_m"], row["ratio"], row["clearance_m"]] if solved else [math.nan] * 3
    return "".join(f"{value:g}; " for value in values)


def write_database(path: Path, logs: Sequence[Path]) -> None:
    """The SQLite database of some logs, with the views of the best planners."""
    from ompl.tools import computeViews, readBenchmarkLog

    path.unlink(missing_ok=True)
    with contextlib.redirect_stdout(io.StringIO()):
        readBenchmarkLog(str(path), [str(log) for log in logs], False)
        computeViews(str(path), False)
