"""How good an estimated trajectory is, by what is known of its log."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.known_logs import Known
from benchmarks.runner import Row, grouped
from turtlebag.datasets.relations import Relations
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Trajectory
from turtlebag.pipeline.stages.map_summary import BAD_M
from turtlebag.reports.metrics.relations import relations_metrics
from turtlebag.reports.metrics.trajectory import PosePairs, summary

FOLD_M = 3.0


def scored(log: Known, found: Trajectory) -> Row:
    """Errors of a log's trajectory by its relations, or else after a rigid fit; none when nobody knows."""
    if len(log.relations):
        return by_relations(found, log.relations)
    return errors(found.poses, log.reference) if np.isfinite(log.reference.xyt).any() else {}


def by_relations(estimate: Trajectory, relations: Relations) -> Row:
    """Mean errors of relations, by metricEvaluator's definition."""
    found = relations_metrics(estimate, relations)["relations"]
    return {"m": found["trans_m"]["mean"], "deg": found["rot_deg"]["mean"], "relations": found["n"]}


def errors(estimate: SE2, reference: SE2) -> Row:
    """Errors against the pose of each scan (n,); scans whose reference is NaN do not count.

    `m`, `deg` (RMSE) and `worst_m` after a rigid fit; `anchored_*` with the first pose as the only anchor.
    `folded` is the share of scans laid over a place they never saw.
    """
    sure = np.isfinite(reference.xyt).all(axis=1)
    estimate, true = estimate[sure], reference[sure]
    number = np.arange(len(true))
    fitted = PosePairs(number, estimate, true).aligned()
    anchored = PosePairs(number, true[0] @ estimate[0].inverse() @ estimate, true)
    fit, first = summary(fitted.position_errors()), summary(anchored.position_errors())
    return {
        "m": fit["rmse"],
        "deg": float(np.degrees(summary(fitted.yaw_errors())["rmse"])),
        "worst_m": fit["max"],
        "anchored_m": first["rmse"],
        "anchored_worst_m": first["max"],
        "folded": _folded(estimate, true),
    }


def _folded(estimate: SE2, true: SE2) -> float:
    """Share of scans with another scan laid within 1 m of them that was truly FOLD_M and more away."""
    step = max(1, len(true) // 3000)
    est, tru = estimate.xy[::step], true.xy[::step]
    near = cKDTree(est).query_ball_point(est, 1.0)
    far = [(np.linalg.norm(tru[others] - tru[i], axis=1) > FOLD_M).any() for i, others in enumerate(near)]
    return float(np.mean(far))


def accuracy(rows: Sequence[Row]) -> Row:
    """Figures of many maps with exact truth; m after a rigid fit."""
    done = [row for row in rows if "error" not in row]
    if not done:
        return {"maps": 0, "errors": len(rows)}
    far = [row for row in done if row["worst_m"] > BAD_M]

    def under(limit: float, key: str) -> int:
        return sum(row[key] <= limit for row in done)

    return {
        "maps": len(done),
        "errors": len(rows) - len(done),
        "median m": float(np.median([row["m"] for row in done])),
        "under 2 cm": under(0.02, "m"),
        "median worst": float(np.median([row["worst_m"] for row in done])),
        "worst": max(row["worst_m"] for row in done),
        "worst under 5 cm": under(0.05, "worst_m"),
        "under 10 cm": under(0.1, "worst_m"),
        "under 10 cm, anchored": under(0.1, "anchored_worst_m"),
        f"beyond {BAD_M} m": len(far),
        "of these good": sum(row["verdict"] == "good" for row in far),
        "others doubtful": sum(row["verdict"] != "good" for row in done if row not in far),
    }


def by(*keys: str) -> Callable[[list[Row]], list[Row]]:
    """A table of `accuracy`: all rows, and those of each value of some columns."""

    def table(rows: list[Row]) -> list[Row]:
        parts = {"all": rows}
        for key in keys:
            for value in dict.fromkeys(row[key].partition(":")[0] for row in rows):
                parts[value] = [row for row in rows if row[key].partition(":")[0] == value]
        return [{"of": name, **accuracy(part)} for name, part in parts.items()]

    return table


def own_errors(relations: Relations) -> Array:
    """Errors (n, 3) of relations themselves: how far those of the same three scans do not close, of which
    each has its share; none where there are no three."""
    T: dict[tuple[int, int], SE2] = {}
    for k, (a, b) in enumerate(zip(relations.stamps_a_ns, relations.stamps_b_ns, strict=True)):
        T[a, b], T[b, a] = relations.T_a_b[k], relations.T_a_b[k].inverse()
    others = grouped(({"a": a, "b": b} for a, b in T), "a")
    beside = {a: {row["b"] for row in rows} for (a,), rows in others.items()}
    closures = [T[a, b] @ T[b, c] @ T[c, a] for a, b in T if a < b for c in beside[a] & beside[b] if c > b]
    return np.array([one.xyt for one in closures] or np.zeros((1, 3))) / np.sqrt(3.0)
