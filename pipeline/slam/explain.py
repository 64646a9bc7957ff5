"""`map --explain`: every loop candidate, the worst edges, the map before and after."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from turtlebag.datasets.maps import save_map
from turtlebag.datasets.outputs import write_json
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.se3 import SE3
from turtlebag.pipeline.slam.check.verdict import hypothesis_shares
from turtlebag.pipeline.slam.graph.constraints import Constraint, Loop
from turtlebag.pipeline.slam.graph.cost import mahalanobis
from turtlebag.pipeline.slam.grid import make_grid
from turtlebag.pipeline.slam.mapper import SlamConfig, SlamResult
from turtlebag.pipeline.slam.sessions import Session

WORST = 10


def loop_record(result: SlamResult) -> dict[str, Any]:
    """Key scans, and every loop candidate, by distance and by place recognition: scores, verdict, residual at
    the final poses; and the scans before which the track breaks."""
    session = result.session
    return {
        "keys": result.keys,
        "loops": [candidate(loop, result.T_map_keys) for loop in result.loops],
        "recognised": [candidate(place, result.T_map_keys) for place in result.recognised],
        "breaks": [
            {"after_scan": before, "before_scan": after, "bridged": _bridged(session, after)}
            for before, after in session.breaks.gaps.tolist()
        ],
    }


def _bridged(session: Session, scan: int) -> bool:
    step = int(np.searchsorted(session.track.keys, scan)) - 1
    return not bool(session.graph.unbridged[step])


def candidate(found: Loop, T_map_keys: SE2 | SE3) -> dict[str, Any]:
    """A candidate as written, with its residual at the final poses, in the plane or in space."""
    return {
        "i": found.i,
        "j": found.j,
        "T_j_i": type(T_map_keys)(found.T_j_i).vector(),
        **({"gate_m": found.gate_m} if not np.isnan(found.gate_m) else {}),
        "score": found.score,
        "overlap": found.overlap,
        **({"violation": found.violation} if not np.isnan(found.violation) else {}),
        "rmse_m": found.rmse,
        "verdict": found.verdict,
        **_residual(found, T_map_keys),
    }


def _residual(found: Loop, T_map_keys: SE2 | SE3) -> dict[str, float]:
    measured = type(T_map_keys)(found.T_j_i)
    left = measured.inverse() @ T_map_keys[found.j].inverse() @ T_map_keys[found.i]  # type: ignore[operator]
    way, turn = left.size()
    return {"residual_m": float(way), "residual_rad": float(turn)}


def write_explanation(folder: Path, result: SlamResult, config: SlamConfig) -> None:
    """Write `explain.json` (worst edges, contradicting places, hypotheses, calibration), and the map by the
    front end alone, `before.pgm`, to compare with `map.pgm`."""
    session = result.session
    usable = config.usable(*session.recording.lidars)
    before = make_grid(session.recording, session.track.T_track_base, config.grid, usable, session.motion)
    save_map(before, folder, "before")
    write_json(
        folder / "explain.json",
        {
            "worst_edges": worst_edges(result.T_map_keys, result.constraints),
            "contradicting_places": contradicting_places(result),
            "front_end": {
                "winners": hypothesis_shares(result.track),
                "mean_overlap": float(result.track.overlap.mean()),
                "odometry_calibration": vars(result.track.calibration),
                "range_calibration": result.session.ranges.numbers(),
            },
            "moved_by_graph_m": moved(result.T_map_keys.xy - result.track.T_track_base.xy[result.keys]),
        },
    )


def worst_edges(
    T_map_keys: SE2 | SE3, constraints: Sequence[Constraint], most: int = WORST
) -> list[dict[str, Any]]:
    """The constraints with the largest residuals at the final poses, worst first."""
    squared = mahalanobis(T_map_keys, constraints)
    order = np.argsort(-squared, kind="stable")[:most]
    return [
        {
            "i": constraints[k].i,
            "j": constraints[k].j,
            "kind": constraints[k].kind,
            "sigmas": float(np.sqrt(max(squared[k], 0.0))),
        }
        for k in order
    ]


def contradicting_places(result: SlamResult, most: int = WORST) -> list[dict[str, Any]]:
    """The revisits that violate each other's free space most, worst first."""
    violations = result.check.violations
    order = np.argsort(-violations[:, 2], kind="stable")[:most]
    return [
        {"i": int(i), "j": int(j), "violation": float(share), "xy": result.T_map_keys.xy[int(i)]}
        for i, j, share in violations[order]
    ]


def moved(shifts: Array) -> dict[str, float]:
    """How far graph and refinement shifted the key scans, (n, 2) or (n, 3), from their track."""
    shift = np.linalg.norm(shifts, axis=1)
    return {"mean": float(shift.mean()), "max": float(shift.max())}
