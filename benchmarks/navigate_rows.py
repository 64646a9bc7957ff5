"""What an episode of the navigation benchmark leaves: a row, and lines of the tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import binomtest

from benchmarks.navigate_cases import Case
from benchmarks.runner import Row, interval
from turtlebag.datasets.runlog import RunLog
from turtlebag.pipeline.navigation.episode import Episode
from turtlebag.reports.metrics.navigation import collision_episodes

MOVING_M, MOVING_RAD = 0.002, 0.01
"""Wheels that turned the robot more than this in the tick before a contact make it the robot's own."""


def row_of(case: Case, episode: Episode, cpu_s: float) -> Row:
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
    area = m.get("area", {"share": None, "seen_m2": None})
    unseen = area["share"] is not None and area["share"] < case.seen
    return about(case) | {
        "success": int(not others and not touched and not unseen),
        "reached": len(reached),
        "goals": len(m["goals"]),
        "reasons": "; ".join([*(_why(g) for g in others), *["saw too little of the floor"] * unseen]),
        "visible": m["collisions"]["visible"],
        "low": m["collisions"]["low"],
        "own_speed": own,
        "worst_error_m": max((g["error_m"] for g in reached), default=None),
        "worst_error_rad": max((g["error_rad"] for g in reached), default=None),
        "min_clearance_m": m["min_clearance_m"],
        "localisation_rmse_m": (m["localisation_error_m"] or {}).get("rmse"),
        "distance_m": m["distance_m"],
        "seen_m2": area["seen_m2"],
        "seen_share": area["share"],
        "time_s": m["time_s"],
        "score": None if case.score is None else case.score(m),
        "x_real_time": round(m["time_s"] / max(cpu_s, 1e-9), 1),
    }


def about(case: Case) -> Row:
    """Which episode it is, and how to see it again."""
    name, seed = case.name, case.request.seed
    replay = f'python -m benchmarks.navigate --replay "{name}" {seed}'
    world, robot = case.world.name, case.robot.name
    return {"scenario": name, "seed": seed, "world": world, "robot": robot, "replay": replay}


def refused_row(case: Case, why: str) -> Row:
    """The row of an episode that was refused at the door: a failure as any other."""
    nothing = dict.fromkeys(("success", "reached", "visible", "low", "own_speed", "distance_m"), 0)
    return about(case) | nothing | {"goals": 1, "reasons": f"refused {why}"}


def _truly_there(goal: dict[str, Any], case: Case) -> bool:
    """Whether a goal that counts as reached is so by the truth."""
    if goal["status"] != "reached":
        return True
    return bool(goal["error_m"] <= case.within[0] and goal["error_rad"] <= case.within[1])


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


def summary(name: str, rows: Sequence[Row]) -> Row:
    """One line of the table."""
    n, ok = len(rows), sum(row["success"] for row in rows)
    wilson, exact = interval(ok, n), binomtest(ok, n).proportion_ci(method="exact")

    def of(key: str) -> list[float]:
        return [row[key] for row in rows if row.get(key) is not None] or [math.nan]

    return {
        "scenario": name,
        "seeds": spans([row["seed"] for row in rows]),
        "success": f"{ok}/{n}",
        "rate": f"{ok / n:.3f}",
        "Wilson 95 %": f"{wilson[0]:.3f}..{wilson[1]:.3f}",
        "Clopper-Pearson 95 %": f"{exact.low:.3f}..{exact.high:.3f}",
        "visible contacts": sum(of("visible")),
        "low contacts": sum(of("low")),
        "at own speed": sum(of("own_speed")),
        "worst error m": max(of("worst_error_m")),
        "worst yaw error rad": max(of("worst_error_rad")),
        "least clearance m": min(of("min_clearance_m")),
        "driven m": f"{sum(of('distance_m')):.0f}",
        "mean s": f"{np.mean(of('time_s')):.1f}",
        "seen share": float(np.mean(of("seen_share"))),
        "score": float(np.mean(of("score"))),
        "x real time": f"{np.median(of('x_real_time')):.0f}",
    }


def spans(numbers: Sequence[int]) -> str:
    """Whole numbers as runs: `0..9, 20..29`."""
    ordered = np.unique(numbers)
    runs = np.split(ordered, np.flatnonzero(np.diff(ordered) > 1) + 1)
    return ", ".join(f"{run[0]}..{run[-1]}" for run in runs)


def failures(rows: Sequence[Row]) -> list[str]:
    """A line for each episode that failed, with the command that shows it again."""
    return [
        f"- {row['scenario']}, seed {row['seed']} ({row['world']}, {row['robot']}): "
        f"{row['reasons'] or 'touched something'}; contacts {row['visible']} visible {row['low']} low, "
        f"{row['own_speed']} at own speed: `{row['replay']} --out DIR`"
        for row in rows
        if not row["success"]
    ]
