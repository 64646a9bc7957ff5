"""How good an estimated trajectory is against the exact truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from turtlebag.datasets.se2 import SE2, Array, wrap
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.types import Trajectory
from turtlebag.reports.metrics.trajectory import fit_rigid

PAIRS = 2000
NEAR_M = 2.5
RETURN_M = 10.0
FOLD_M = 3.0


@dataclass(frozen=True)
class Score:
    """Errors in metres and degrees; `folded` is the share of scans laid over a place they never saw.

    `ate` and `ate_worst` have the first pose as their only anchor; after a rigid fit `ate_aligned` and
    `ate_max` are left, and `yaw_deg` of the yaws.
    """

    ate: float
    ate_worst: float
    ate_aligned: float
    ate_max: float
    ate_scaled: float
    scale: float
    yaw_deg: float
    relation_m: float
    relation_deg: float
    return_m: float
    folded: float


def score(estimate: SE2, truth: Trajectory) -> Score:
    """Compare poses (n,) of the scans with the truth.

    Relations are sampled as Kuemmerle et al. (2009) chose theirs by hand: between poses near each
    other in space, half of them successive, half of them returns to a place.
    """
    true = truth.poses
    moved = true[0] @ estimate[0].inverse() @ estimate
    fitted = fit_rigid(estimate.xy, true.xy)
    aligned = np.linalg.norm(fitted @ estimate.xy - true.xy, axis=1)
    near, back = _pairs(true, PAIRS)
    scale, scaled = _scaled((fitted @ estimate.xy), true.xy)
    turned = wrap((fitted @ estimate).yaw - true.yaw)
    anchored = np.linalg.norm(moved.xy - true.xy, axis=1)
    e_near, e_back = _relation_error(estimate, true, near), _relation_error(estimate, true, back)
    both = np.concatenate([e_near, e_back])
    return Score(
        ate=_rms(anchored),
        ate_worst=float(anchored.max()),
        ate_aligned=_rms(aligned),
        ate_max=float(aligned.max()),
        ate_scaled=_rms(scaled),
        scale=scale,
        yaw_deg=float(np.degrees(_rms(turned))),
        relation_m=float(both[:, 0].mean()),
        relation_deg=float(np.degrees(both[:, 1].mean())),
        return_m=float(e_back[:, 0].mean()) if len(e_back) else 0.0,
        folded=_folded(estimate, true),
    )


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(error**2)))


def _scaled(fitted: Array, true: Array) -> tuple[float, Array]:
    """The scale that brings rigidly fitted positions (n, 2) nearest to the true ones, and the errors left."""
    a, b = fitted - fitted.mean(axis=0), true - true.mean(axis=0)
    scale = float(np.sum(a * b) / max(np.sum(a * a), 1e-12))
    return scale, np.linalg.norm(scale * a - b, axis=1)


def _pairs(true: SE2, n: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    rng = stream(1, "relations")
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(true.xy, axis=0), axis=1))])
    a = rng.integers(0, len(path), n)
    ahead = np.searchsorted(path, path[a] + rng.uniform(0.2, 2.0, n))
    ok = ahead < len(path)
    near = np.stack([a[ok], ahead[ok]], axis=1)
    tree = cKDTree(true.xy)
    back = []
    for i in a:
        others = np.array(tree.query_ball_point(true.xy[i], NEAR_M))
        others = others[np.abs(path[others] - path[i]) > RETURN_M]
        if len(others):
            back.append((i, rng.choice(others)))
    return near, np.array(back, dtype=np.int64).reshape(-1, 2)


def _relation_error(estimate: SE2, true: SE2, pairs: NDArray[np.int64]) -> Array:
    """Norm [m] and angle [rad] of each relation's error, (n, 2)."""
    i, j = pairs[:, 0], pairs[:, 1]
    wanted = true[i].inverse() @ true[j]
    error = (wanted.inverse() @ (estimate[i].inverse() @ estimate[j])).xyt
    return np.stack([np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2])], axis=1)


def _folded(estimate: SE2, true: SE2) -> float:
    """Share of scans with another scan laid within 1 m of them that was truly FOLD_M and more away."""
    step = max(1, len(true) // 3000)
    est, tru = estimate.xy[::step], true.xy[::step]
    tree = cKDTree(est)
    wrong = 0
    for i, others in enumerate(tree.query_ball_point(est, 1.0)):
        wrong += bool((np.linalg.norm(tru[others] - tru[i], axis=1) > FOLD_M).any())
    return wrong / len(est)
