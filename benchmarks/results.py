"""The page of results: a median and a worst over at least ten seeds in each line, of one version of the code.

python -m benchmarks.results [ROW ...] [--runs N] [--limit N] [--workers N] [--out DIR]

Rows `arena`, `house`, `maze` and `office` are maps of simulated drives; `arena-pose` and `house-pose` AMCL on
a map made by SLAM; `patrol`, `goals`, `new-worlds` and `kidnap` runs in closed loop (benchmarks.navigate).
All have realistic sensors, and seeds that nothing was tuned on. `intel`, `fr079` and `mit-csail`
are public logs from the folder in TURTLEBAG_DATA: as they were recorded, and ten times with more noise.

The same command goes on where it was stopped; rows of other code are measured again. Both tables are printed
and written to DIR/results.md, with the commit that they were measured with.
"""

from __future__ import annotations

import os
import subprocess
from argparse import Namespace
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial

import numpy as np

from benchmarks.drives import PLACES, Maps
from benchmarks.known_logs import Known
from benchmarks.localise import accuracy
from benchmarks.navigate import about, episode_row, scenarios
from benchmarks.runner import (
    ROOT,
    Case,
    Row,
    Rows,
    Suite,
    code_of,
    each,
    every,
    options,
    parsed,
    public_log,
    rows_file,
    run,
)  # fmt: skip
from benchmarks.slam_logs import DRIVE, PUBLISHED, RADISH, by_name, drive_row, mapped
from turtlebag.datasets.seeds import stream

FIRST, RUNS = 9101, 10
"""The first seed, and how many; runs in closed loop are cheaper, and there are more of them."""
DRIVEN_S = 180.0
RANGE_M, WHEELS = 0.01, 0.01
"""Noise added to a public log: of each range [m], and of each step of the odometry, as a share."""
SCENARIOS = {
    "patrol": "patrol",
    "goals": "house waffle_pi",
    "new-worlds": "new worlds",
    "kidnap": "kidnap, house",
}
CODE = ("datasets", "pipeline", "planners", "sim", "reports/metrics", "benchmarks")


@dataclass(frozen=True)
class Line:
    """A line of the table: one figure of the cases of a row, scaled to its unit. With `least` the smallest is
    the worst."""

    row: str
    what: str
    key: str
    unit: str
    scale: float = 1.0
    least: bool = False


LINES = (
    Line("arena", "map of the arena: position of the scans, RMSE", "anchored_m", "mm", 1e3),
    Line("arena", "the same map: walls within 5 cm of a true surface", "within", "%", 100.0, least=True),
    Line("house", "map of the house: position of the scans, RMSE", "anchored_m", "mm", 1e3),
    Line("house", "the same map: walls within 5 cm of a true surface", "within", "%", 100.0, least=True),
    Line("maze", "map of a maze, a new one for each seed: RMSE", "anchored_m", "mm", 1e3),
    Line("office", "map of an office, a new one for each seed: RMSE", "anchored_m", "mm", 1e3),
    Line("arena-pose", "AMCL in the arena on a SLAM map: position, RMSE", "position_cm", "cm"),
    Line("house-pose", "AMCL in the house on a SLAM map: position, RMSE", "position_cm", "cm"),
    Line("patrol", "patrol: largest distance from a waypoint", "worst_error_m", "cm", 100.0),
    Line("goals", "random goal in the house: distance from it", "worst_error_m", "cm", 100.0),
    Line("new-worlds", "random goal in a new office or maze", "worst_error_m", "cm", 100.0),
    Line("kidnap", "random goal in the house, kidnapped on the way", "worst_error_m", "cm", 100.0),
)


def noisier(log: Known, seed: int) -> Known:
    """A log with more noise, of its ranges and of its wheels; seed 0 is the log as it was recorded."""
    if seed == 0:
        return log
    rng, ranges, steps = stream(seed, "noisier"), log.recording.ranges, log.odometry.steps()
    noised = np.maximum(ranges + RANGE_M * rng.standard_normal(ranges.shape), 0.05)
    again = log.with_ranges(np.where(np.isfinite(ranges), noised, ranges))
    return again.with_steps(steps * (1.0 + WHEELS * rng.standard_normal(steps.shape)))


def log_row(log: str, seed: int) -> Row:
    """A public log with the noise of a seed, mapped, against its relations."""
    return mapped(noisier(by_name(log), seed))[1]


def suites(args: Namespace) -> dict[str, Suite]:
    """A suite a row; a public log that is not there has no cases."""
    out, seeds = args.out.absolute(), range(FIRST, FIRST + RUNS)
    worlds = {place: [(*PLACES[place], "tour", seed, "realistic") for seed in seeds] for place in PLACES}
    for place in ("maze", "office"):
        worlds[place] = [(f"{place}:{seed}", "burger", "tour", seed, "realistic") for seed in seeds]
    known = {place: Suite(each(drive_row, DRIVE, drives), code=CODE) for place, drives in worlds.items()}
    pose = partial(accuracy, model="default", sensors="realistic", seconds=DRIVEN_S, out=out)
    for place in PLACES:
        known[f"{place}-pose"] = Suite(every(pose, place=(place,), map=("slam",), seed=seeds), code=CODE)
    driven = scenarios(Maps(out / "maps", "realistic"), False)
    for row, name in SCENARIOS.items():
        episodes = [
            Case(f"{name} {k}", partial(episode_row, driven[name], k), about(driven[name], k))
            for k in range(FIRST, FIRST + args.runs)
        ]
        known[row] = Suite(episodes, code=CODE, show=False)
    for log in RADISH:
        cases = every(log_row, log=(log,), seed=range(RUNS + 1)) if public_log(log) else []
        known[log] = Suite(cases, code=CODE)
    return known


def number(value: float) -> str:
    """Three digits that mean something."""
    return f"{value:.1f}" if value < 99.95 else f"{value:.0f}"


def command(row: str) -> str:
    """What measures a row again."""
    return f"`python -m benchmarks.results {row}`"


def simulated(rows: dict[str, list[Row]]) -> Iterable[list[str]]:
    """The lines of the table of simulated runs; a row without enough runs has none."""
    yield ["measured", "runs", "median", "worst", "command"]
    for line in LINES:
        cases = rows.get(line.row, [])
        figures = [line.scale * row[line.key] for row in cases if row.get(line.key) is not None]
        if len(cases) < RUNS or not figures:
            continue
        arrived = sum(row.get("success", 0) for row in cases)
        runs = f"{arrived} of {len(cases)} arrived" if line.row in SCENARIOS else f"{len(figures)}"
        failed = sum("error" in row for row in cases)
        worst = min(figures) if line.least else max(figures)
        told = [f"{number(value)} {line.unit}" for value in (float(np.median(figures)), worst)]
        yield [line.what, runs + f", {failed} failed" * bool(failed), *told, command(line.row)]


def logs(rows: dict[str, list[Row]]) -> Iterable[list[str]]:
    """The lines of the table of public logs [m / deg]; a log without all its runs has none."""
    published = ("Cartographer", "Graph Mapping", "gmapping")
    yield ["log", "as recorded", "median", "worst", *published, "command"]
    for log in RADISH:
        cases = {row["seed"]: row for row in rows.get(log, []) if "m" in row}
        if len(cases) <= RUNS:
            continue
        errors = np.array([(cases[seed]["m"], cases[seed]["deg"]) for seed in sorted(cases)])
        told = [errors[0], np.median(errors[1:], axis=0), errors[1:].max(axis=0)]
        _, gmapping, graph_mapping, cartographer = PUBLISHED[log]
        ours = [f"{m:.4f} / {deg:.3f}" for m, deg in told]
        yield [log, *ours, cartographer, graph_mapping, gmapping, command(log)]


def table(lines: Iterable[list[str]]) -> str:
    """Lines of cells as markdown, the first one as the head."""
    head, *rest = lines
    return "".join(f"| {' | '.join(line)} |\n" for line in [head, ["---"] * len(head), *rest])


def commit() -> str:
    """The commit that is checked out."""
    told = subprocess.run(
        ["git", "-C", str(ROOT), "describe", "--always", "--dirty", "--exclude=*"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    return told.stdout.strip() or "no commit"


def main() -> None:
    """Measure what has no row yet, print and write both tables of all rows that this code has."""
    parser = options(__doc__, "data/benchmarks/results", runs=30)
    args, known = parsed(parser, suites, workers=os.cpu_count() or 1)
    out = args.out
    run(args, known)
    code = code_of(CODE)
    rows = {name: Rows(rows_file(out, name), code).of(suite.cases) for name, suite in known.items()}
    text = f"Measured with commit {commit()}.\n\n{table(simulated(rows))}\n{table(logs(rows))}"
    (out / "results.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
