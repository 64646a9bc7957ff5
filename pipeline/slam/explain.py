"""Why the map is as it is: every loop candidate, the worst edges, the map before and after."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from datasets.maps import save_map
from datasets.outputs import write_json
from datasets.se2 import SE2
from datasets.types import Recording
from pipeline.slam.loops import Loop
from pipeline.slam.occupancy import make_grid
from pipeline.slam.pose_graph import mahalanobis
from pipeline.slam.selfcheck import hypothesis_shares
from pipeline.slam.slam import SlamConfig, SlamResult

WORST = 10


def loop_record(result: SlamResult) -> dict[str, Any]:
    """Key scans, and every loop candidate: scores, verdict, what is left of it at the final poses."""
    return {
        "keys": result.keys,
        "loops": [_loop(loop, result.T_map_keys) for loop in result.loops],
    }


def _loop(loop: Loop, T_map_keys: SE2) -> dict[str, Any]:
    final = T_map_keys[loop.j].inverse() @ T_map_keys[loop.i]
    left = (SE2(loop.T_j_i).inverse() @ final).xyt
    return {
        "i": loop.i,
        "j": loop.j,
        "T_j_i": loop.T_j_i,
        "gate_m": loop.gate_m,
        "score": loop.score,
        "overlap": loop.overlap,
        "rmse_m": loop.rmse,
        "verdict": loop.verdict,
        "residual_m": float(np.hypot(left[0], left[1])),
        "residual_rad": float(abs(left[2])),
    }


def write_explanation(folder: Path, recording: Recording, result: SlamResult, config: SlamConfig) -> None:
    """Write `explain.json` (worst edges, contradicting places, hypotheses, calibration) and the map that
    the front end alone would have drawn, `before.pgm`, to hold beside `map.pgm`."""
    usable = min(recording.lidar.range_max, config.usable_range_m)
    save_map(make_grid(recording, result.track.T_track_base, config.grid, usable), folder, "before")
    write_json(
        folder / "explain.json",
        {
            "worst_edges": worst_edges(result),
            "contradicting_places": _contradictions(result),
            "front_end": {
                "winners": hypothesis_shares(result.track),
                "mean_overlap": float(result.track.overlap.mean()),
                "odometry_calibration": vars(result.track.calibration),
            },
            "moved_by_graph_m": _moved(result),
        },
    )


def worst_edges(result: SlamResult, count: int = WORST) -> list[dict[str, Any]]:
    """The constraints that fit the final poses least, worst first."""
    squared = mahalanobis(result.T_map_keys, result.constraints)
    order = np.argsort(-squared, kind="stable")[:count]
    return [
        {
            "i": result.constraints[k].i,
            "j": result.constraints[k].j,
            "kind": result.constraints[k].kind,
            "sigmas": float(np.sqrt(max(squared[k], 0.0))),
        }
        for k in order
    ]


def _contradictions(result: SlamResult) -> list[dict[str, Any]]:
    denied = result.check.denied
    order = np.argsort(-denied[:, 2], kind="stable")[:WORST]
    return [
        {"i": int(i), "j": int(j), "denied": float(share), "xy": result.T_map_keys.xy[int(i)]}
        for i, j, share in denied[order]
    ]


def _moved(result: SlamResult) -> dict[str, float]:
    """How far graph and refinement moved the key scans from where the front end had them."""
    shift = np.linalg.norm(result.T_map_keys.xy - result.track.T_track_base.xy[result.keys], axis=1)
    return {"mean": float(shift.mean()), "max": float(shift.max())}
