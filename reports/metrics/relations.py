"""The SLAM benchmark by relations (Kuemmerle et al. 2009), by both published definitions."""

from __future__ import annotations

from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.relations import Relations
from turtlebag.datasets.se2 import Array, wrap
from turtlebag.datasets.types import Stamps, Trajectory

# Relations name scans by stamp, some with fewer decimals than the log.
MATCH_NS = 1_000_000


def relation_errors(estimate: Trajectory, relations: Relations) -> tuple[Array, Array, Array, Array]:
    """Errors of the relations whose two stamps have a pose, (n,) each.

    (translation [m], rotation [rad]) by metricEvaluator's definition - component-wise difference of
    the two relative poses - and the same two by Cartographer's: norm and angle of
    (p_a^-1 p_b) * expected^-1.
    """
    a, found_a = nearest(estimate.stamps_ns, relations.stamps_a_ns)
    b, found_b = nearest(estimate.stamps_ns, relations.stamps_b_ns)
    both = found_a & found_b
    T_est = estimate.poses[a[both]].inverse() @ estimate.poses[b[both]]
    T_true = relations.T_a_b[both]
    translation = np.linalg.norm(T_est.xy - T_true.xy, axis=1)
    rotation = np.abs(wrap(T_est.yaw - T_true.yaw))
    error = T_est @ T_true.inverse()
    return translation, rotation, np.linalg.norm(error.xy, axis=1), np.abs(error.yaw)


class Moments(TypedDict):
    """Mean, standard deviation and mean square; None where no relation matched."""

    mean: float | None
    std: float | None
    sq_mean: float | None


class Relation(TypedDict):
    """Errors of `n` relations by one definition."""

    n: int
    trans_m: Moments
    rot_deg: Moments


class RelationErrors(TypedDict, total=False):
    """Both definitions."""

    relations: Relation
    relations_cartographer: Relation


def relations_metrics(estimate: Trajectory, relations: Relations) -> RelationErrors:
    """The errors of the relations whose two scans have a pose."""
    trans, rot, trans_c, rot_c = relation_errors(estimate, relations)
    return {"relations": _summary(trans, rot), "relations_cartographer": _summary(trans_c, rot_c)}


def nearest(
    stamps: Stamps, wanted: Stamps, within_ns: int = MATCH_NS
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """For each wanted stamp the index of the nearest (in any order), and whether it is near enough."""
    order = np.argsort(stamps, kind="stable")
    ordered = stamps[order]
    right = np.clip(np.searchsorted(ordered, wanted), 1, max(len(ordered) - 1, 1))
    right = np.minimum(right, len(ordered) - 1)
    left = np.maximum(right - 1, 0)
    nearer_left = np.abs(wanted - ordered[left]) <= np.abs(ordered[right] - wanted)
    best = np.where(nearer_left, left, right)
    return order[best], np.abs(ordered[best] - wanted) <= within_ns


def _summary(trans: Array, rot: Array) -> Relation:
    return {"n": len(trans), "trans_m": _moments(trans), "rot_deg": _moments(np.rad2deg(rot))}


def _moments(errors: Array) -> Moments:
    if len(errors) == 0:
        return {"mean": None, "std": None, "sq_mean": None}
    return {"mean": float(errors.mean()), "std": float(errors.std()), "sq_mean": float((errors**2).mean())}
