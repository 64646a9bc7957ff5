"""Whether uncertainty and verdict are true: covariances of maps and localisations, and p_bad, by the truth.

    python -m benchmarks.coverage [maps] [disturbed] [localise] [--workers N] [--limit N] [--out DIR]

`maps` are 300 simulated drives in five worlds, each with one of eight mishaps, or none; `disturbed` the same
drives with kinds of disturbance (benchmarks.disturb); `localise` is AMCL along the drives of `maps`, on the
true map. Drives are recorded once, in DIR/drives. Coverage is the share of poses, every 20th, whose 95 %
ellipse (x and y) or ellipsoid (x, y and yaw) holds the truth, without alignment; of a map, the first pose is
fixed.
Kinds of the half `build` are those that p_bad is made of (benchmarks.p_bad); those of `score` only tell how
good it is. A map is bad when after a rigid fit a scan lies more than BAD_M off, or TIMES the median worst
of the undisturbed maps of its world and robot, or fewer than BAD_WALLS of its walls lie within a cell.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.disturb import KINDS, SCORED
from benchmarks.kept_drives import DRIVEN, DRIVES, Drive, about, drive, mishap_of, went_wrong
from benchmarks.runner import Case, Row, Suite, grouped, options, parsed, run, share
from benchmarks.slam_logs import mapped
from turtlebag.datasets.se2 import SE2, Array, wrap
from turtlebag.datasets.seeds import stream
from turtlebag.pipeline.slam.check.p_bad import DOUBTFUL, WEIGHTS, Term, p_bad
from turtlebag.pipeline.slam.mapper import SlamResult
from turtlebag.pipeline.stages.localise import LocaliseConfig, aligned_in_time, run_amcl
from turtlebag.reports.metrics.map import map_metrics
from turtlebag.reports.metrics.trajectory import fit_rigid

EVERY = 20
INSIDE = {2: 5.991, 3: 7.815}
"""Squared Mahalanobis distance that 95 of 100 poses are within, by how many of x, y and yaw count."""
BAD_M, TIMES, BAD_WALLS = 0.2, 5.0, 0.9
FEWEST = 3
WELL_OF = 120
"""Kinds of disturbance come to those of the first drives that went well."""
CODE = ("datasets", "pipeline/slam", "sim", "benchmarks/disturb.py", "benchmarks/kept_drives.py")


def distances(estimate: SE2, covariance: Array, truth: SE2) -> Row:
    """Squared Mahalanobis distances of every 20th pose (n,) from the truth, of x and y, and with yaw."""
    known = np.isfinite(truth.xyt).all(axis=1)
    asked = np.flatnonzero(known)[EVERY::EVERY]
    error = estimate.xyt[asked] - truth.xyt[asked]
    error[:, 2] = wrap(error[:, 2])
    found = {}
    for size in INSIDE:
        e, P = error[:, :size, None], covariance[asked][:, :size, :size]
        squares = (e.transpose(0, 2, 1) @ np.linalg.solve(P, e))[:, 0, 0]
        found[f"d{size}"] = [round(float(square), 3) for square in squares]
    return found


def map_row(number: int, kind: str, folder: Path) -> Row:
    """The map of a drive in a kind of disturbance, its covariances and its check."""
    one = went_wrong(drive(number, folder), kind)
    result, row = mapped(one.log)
    # the first pose is fixed: also where the wheels were not used, and the map does not begin where they do
    poses, true = result.trajectory.poses, one.log.reference
    row |= distances(poses, result.covariance, poses[0] @ true[0].inverse() @ true)
    return row | {"within": walls_within(one, result), "check": result.check.as_metrics()}


def walls_within(one: Drive, result: SlamResult) -> float:
    """The share of the map's walls within a cell of a true one, after the rigid fit of its path."""
    known = np.isfinite(one.log.reference.xyt).all(axis=1)
    fit = fit_rigid(result.trajectory.poses.xy[known], one.log.reference.xy[known])
    grid = replace(result.grid, T_map_grid=fit @ result.grid.T_map_grid)
    return map_metrics(grid, one.true_map)["occupied_error_m"]["within_one_cell"] or 0.0


def localise_row(number: int, folder: Path) -> Row:
    """AMCL along a drive on the true map, and its covariances."""
    one = went_wrong(drive(number, folder), mishap_of(number))
    log = aligned_in_time(one.log.recording)
    found = run_amcl(log, one.true_map, one.log.reference[0], LocaliseConfig(), stream(number, "amcl"))
    poses, true = found.trajectory.poses, one.log.reference
    off = np.hypot(*(poses.xy - true.xy).T)
    summary = {"m": float(np.sqrt(np.mean(off**2))), "worst_m": float(off.max()), "doubt": found.doubt}
    return summary | distances(poses, found.covariance, true)


def map_cases(folder: Path) -> list[Case]:
    """Each drive with its mishap; undisturbed ones are of either half."""
    cases = []
    for number in range(DRIVES):
        kind = mishap_of(number)
        half = "score" if kind == "plain" and number % 2 else "build"
        is_ = about(number) | {"kind": kind, "half": half}
        cases.append(Case(f"{number:03d}", partial(map_row, number, kind, folder), is_))
    return cases


def disturbed_cases(folder: Path) -> list[Case]:
    """Drives that went well, in each kind in turn, and undisturbed."""
    well = [k for k in range(WELL_OF) if DRIVEN[k % len(DRIVEN)] == "plain" and mishap_of(k) != "plain"]
    kinds = [*KINDS, "plain", "plain", "plain", "plain", "plain"]
    cases = []
    for turn in range(7):
        for k, kind in enumerate(kinds):
            number = well[(13 * turn + 7 * k) % len(well)]
            half = "score" if kind in SCORED or kind == "plain" else "build"
            is_ = about(number) | {"kind": kind, "half": half}
            cases.append(Case(f"{kind}-{turn}-{k}", partial(map_row, number, kind, folder), is_))
    return cases


def localise_cases(folder: Path) -> list[Case]:
    """Drives of `map_cases`, a third of them: each world, robot and mishap."""
    cases = []
    for number in range(0, DRIVES, 3):
        is_ = about(number) | {"kind": mishap_of(number)}
        cases.append(Case(f"{number:03d}", partial(localise_row, number, folder), is_))
    return cases


def judged(rows: Sequence[Row]) -> list[Row]:
    """The rows with `bad`, whether the map is, and the limit of its worst scan; a row without a map stays.

    A world and robot with fewer than FEWEST undisturbed maps is judged by BAD_M and the walls alone.
    """
    plains = [row for row in rows if row["kind"] == "plain" and "error" not in row]
    limits = {
        of: min(BAD_M, TIMES * float(np.median([row["worst_m"] for row in part])))
        for of, part in grouped(plains, "world", "robot").items()
        if len(part) >= FEWEST
    }
    found = []
    for row in rows:
        limit = limits.get((row["world"], row["robot"]), BAD_M)
        if "error" not in row:
            # where people walk, they are drawn, and no wall of the true map is there
            elsewhere = row["within"] < BAD_WALLS and row["kind"] != "people"
            bad = bool(row["worst_m"] > limit or elsewhere)
            sizes = row["check"]["terms"]
            said = p_bad([Term(name, sizes.get(name, 0.0), "") for name in WEIGHTS])
            verdict = "doubtful" if said >= DOUBTFUL else "good"
            row = {**row, "limit_m": limit, "bad": bad, "p_bad": said, "verdict": verdict}
        found.append(row)
    return found


def coverage(rows: Sequence[Row]) -> list[Row]:
    """How many poses the 95 % ellipses hold: of all, by world, by kind, and of maps that are not bad."""
    done = [row for row in rows if "d2" in row]
    parts = {"all": done}
    if any("bad" in row for row in done):
        parts["not bad"] = [row for row in done if not row["bad"]]
    for key in ("world", "robot", "kind"):
        parts |= {of[0]: part for of, part in grouped(done, key).items()}
    table = []
    for name, part in parts.items():
        columns: Row = {"of": name, "drives": len(part)}
        for size, inside in INSIDE.items():
            squares = np.concatenate([row[f"d{size}"] for row in part])
            columns[("xy", "xy and yaw")[size - 2]] = share(int((squares < inside).sum()), len(squares))
        table.append(columns)
    return table


def detection(rows: Sequence[Row]) -> list[Row]:
    """Missed bad maps and false alarms of judged rows: of all, of each half and of each kind."""
    found = [row for row in rows if "bad" in row]
    parts = {"all": found}
    for key in ("half", "kind"):
        parts |= {str(of[0]): part for of, part in grouped(found, key).items()}
    table = []
    for name, part in parts.items():
        bad, good = ([row for row in part if row["bad"] is is_bad] for is_bad in (True, False))
        missed = share(sum(row["verdict"] == "good" for row in bad), len(bad))
        alarms = share(sum(row["verdict"] == "doubtful" for row in good), len(good))
        table.append({"maps": name, "n": len(part), "bad ones missed": missed, "false alarms": alarms})
    return table


def both(rows: list[Row]) -> list[Row]:
    """Coverage and detection of maps in one table."""
    return [*coverage(rows), *detection(rows)]


def suites(args: Namespace) -> dict[str, Suite]:
    """Maps with mishaps, maps with kinds of disturbance, localisations."""
    folder = args.out.absolute() / "drives"
    columns = ("case", "world", "robot", "kind", "worst_m", "within", "verdict", "error")
    return {
        "maps": Suite(map_cases(folder), columns, both, judged, 24, CODE, show=False),
        "disturbed": Suite(disturbed_cases(folder), columns, detection, judged, 24, CODE, show=False),
        "localise": Suite(
            localise_cases(folder), columns, coverage, list, 8, (*CODE, "pipeline/localisation"), show=False
        ),
    }


if __name__ == "__main__":
    quick = "24 maps of each suite, 8 localisations"
    run(*parsed(options(__doc__, "data/benchmarks/coverage", quick), suites))
