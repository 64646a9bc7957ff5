"""What an episode of the navigation benchmark leaves: a row of the CSV, and lines of the tables."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.intervals import clopper_pearson, wilson
from benchmarks.navigate_cases import Case
from turtlebag.datasets.runlog import RunLog
from turtlebag.pipeline.navigation.episode import Episode
from turtlebag.reports.metrics.navigation import collision_episodes

COLUMNS = (
    "scenario",
    "seed",
    "world",
    "robot",
    "success",
    "reached",
    "goals",
    "reasons",
    "visible",
    "low",
    "own_speed",
    "worst_error_m",
    "worst_error_rad",
    "min_clearance_m",
    "localisation_rmse_m",
    "distance_m",
    "seen_m2",
    "seen_share",
    "time_s",
    "score",
    "x_real_time",
    "replay",
)
MOVING_M, MOVING_RAD = 0.002, 0.01
"""Wheels that turned the robot more than this in the tick before a contact make it the robot's own."""


def row_of(case: Case, episode: Episode, cpu_s: float) -> dict[str, Any]:
    """The row of an episode. Success: every goal ended as wanted, and nothing was touched at own speed.

    Reached means truly there: a robot that believes so in the wrong place has failed. `own_speed` counts
    the contacts that began while the robot's own wheels moved it: a person who walks into a robot that
    stands still is not its collision.
    """
    m = episode.metrics
    reached = [g for g in m["goals"] if g["status"] == "reached"]
    others = [g for g in m["goals"] if g["status"] != case.wanted or not _truly_there(g, case)]
    own = own_contacts(episode.log)
    standing_still = case.world.movers and not own
    # Without a map nobody can know of what is too low for the lidar: counted, but apart.
    unknown = case.request.task in ("avoid", "explore")
    counted = m["collisions"]["visible"] + (0 if unknown else m["collisions"]["low"])
    touched = counted > 0 and not standing_still
    localisation = m["localisation_error_m"]
    share = m.get("area", {}).get("share", math.nan)
    unseen = share < case.seen
    return {
        **blank_row(case),
        "success": int(not others and not touched and not unseen),
        "reached": len(reached),
        "goals": len(m["goals"]),
        "reasons": "; ".join([*(_why(g) for g in others), *["saw too little of the floor"] * unseen]),
        "visible": m["collisions"]["visible"],
        "low": m["collisions"]["low"],
        "own_speed": own,
        "worst_error_m": max((g["error_m"] for g in reached), default=math.nan),
        "worst_error_rad": max((g["error_rad"] for g in reached), default=math.nan),
        "min_clearance_m": m["min_clearance_m"],
        "localisation_rmse_m": math.nan if localisation is None else localisation["rmse"],
        "distance_m": m["distance_m"],
        "seen_m2": m.get("area", {}).get("seen_m2", math.nan),
        "seen_share": share,
        "time_s": m["time_s"],
        "score": math.nan if case.score is None else case.score(m),
        "x_real_time": round(m["time_s"] / max(cpu_s, 1e-9), 1),
    }


def _truly_there(goal: dict[str, Any], case: Case) -> bool:
    """Whether a goal that counts as reached is so by the truth."""
    if goal["status"] != "reached":
        return True
    return bool(goal["error_m"] <= case.within[0] and goal["error_rad"] <= case.within[1])


def refused_row(case: Case, why: str) -> dict[str, Any]:
    """The row of an episode that was refused at the door: a failure as any other."""
    return {**blank_row(case), "success": 0, "reached": 0, "goals": 1, "reasons": f"refused {why}"}


def blank_row(case: Case) -> dict[str, Any]:
    """Which episode it is, and how to see it again."""
    row: dict[str, Any] = dict.fromkeys(COLUMNS, math.nan)
    row.update(visible=0, low=0, own_speed=0, reasons="", distance_m=0.0, time_s=0.0)
    row.update(scenario=case.name, seed=case.seed, world=case.world.name, robot=case.robot.name)
    row["replay"] = f'python -m benchmarks.navigate --replay "{case.name}" {case.seed}'
    return row


def own_contacts(log: RunLog) -> int:
    """Contact episodes that began while the wheels moved the robot."""
    episodes = collision_episodes(log.t_ns, log.contact_visible | log.contact_low)
    count = 0
    for first, _ in episodes:
        k = int(np.searchsorted(log.t_ns, first))
        before = log.T_odom_base[max(k - 1, 0)].inverse() @ log.T_odom_base[k]
        x, y, yaw = before.xyt.tolist()
        count += math.hypot(x, y) > MOVING_M or abs(yaw) > MOVING_RAD
    return count


def _why(goal: dict[str, Any]) -> str:
    if goal["status"] == "reached":
        return f"reached, but truly {goal['error_m']:.2f} m and {goal['error_rad']:.2f} rad off"
    return f"{goal['status']} {goal.get('reason', '')}".strip()


class Table:
    """The CSV of a campaign: rows are added as they come, and read again when it goes on."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.rows: list[dict[str, Any]] = []
        if path.exists():
            with path.open(newline="") as file:
                self.rows = [_numbers(row) for row in csv.DictReader(file)]
        else:
            with path.open("w", newline="") as file:
                csv.DictWriter(file, COLUMNS, lineterminator="\n").writeheader()

    def has(self, name: str, seed: int) -> bool:
        """Whether that episode was run."""
        return any(row["scenario"] == name and row["seed"] == seed for row in self.rows)

    def add(self, row: dict[str, Any]) -> None:
        """Append a row; it is on disk when this returns."""
        self.rows.append(row)
        with self._path.open("a", newline="") as file:
            csv.DictWriter(file, COLUMNS, lineterminator="\n").writerow(row)

    def of(self, name: str) -> list[dict[str, Any]]:
        """Rows of a scenario."""
        return [row for row in self.rows if row["scenario"] == name]


def _numbers(row: dict[str, str]) -> dict[str, Any]:
    words = ("scenario", "world", "robot", "reasons", "replay")
    whole = ("seed", "success", "reached", "goals", "visible", "low", "own_speed")
    found: dict[str, Any] = {}
    for key, text in row.items():
        number = math.nan if not text else None
        found[key] = text if key in words else number or (int(float(text)) if key in whole else float(text))
    return found


HEAD = (
    "| scenario | seeds | success | rate | Wilson 95 % | Clopper-Pearson 95 % | visible contacts "
    "| low contacts | at own speed | worst error m | driven m | seen share | score | x real time |\n"
    + "|---" * 14
    + "|"
)


def summary(name: str, rows: Sequence[dict[str, Any]]) -> str:
    """One line of the table."""
    n, ok = len(rows), sum(row["success"] for row in rows)
    w, c = wilson(ok, n), clopper_pearson(ok, n)
    return (
        f"| {name} | {spans([row['seed'] for row in rows])} | {ok}/{n} | {ok / n:.3f} "
        f"| {w[0]:.3f}..{w[1]:.3f} | {c[0]:.3f}..{c[1]:.3f} "
        f"| {sum(r['visible'] for r in rows)} | {sum(r['low'] for r in rows)} "
        f"| {sum(r['own_speed'] for r in rows)} | {_of(np.max, rows, 'worst_error_m', 3)} "
        f"| {sum(r['distance_m'] for r in rows):.0f} | {_of(np.mean, rows, 'seen_share', 3)} "
        f"| {_of(np.mean, rows, 'score', 3)} | {_of(np.median, rows, 'x_real_time', 0)} |"
    )


def spans(numbers: Sequence[int]) -> str:
    """Whole numbers as runs: `0..9, 20..29`."""
    found: list[list[int]] = []
    for number in sorted(set(numbers)):
        if found and number == found[-1][1] + 1:
            found[-1][1] = number
        else:
            found.append([number, number])
    return ", ".join(f"{a}..{b}" for a, b in found)


def failures(rows: Sequence[dict[str, Any]]) -> list[str]:
    """A line for each episode that failed, with the command that shows it again."""
    return [
        f"- {row['scenario']}, seed {row['seed']} ({row['world']}, {row['robot']}): "
        f"{row['reasons'] or 'touched something'}; contacts {row['visible']} visible {row['low']} low, "
        f"{row['own_speed']} at own speed: `{row['replay']} --out DIR`"
        for row in rows
        if not row["success"]
    ]


def _of(what: Any, rows: Sequence[dict[str, Any]], key: str, digits: int) -> str:
    values = [row[key] for row in rows if math.isfinite(row[key])]
    return f"{what(values):.{digits}f}" if values else ""
