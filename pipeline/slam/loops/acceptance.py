"""Loop acceptance: the checks of a loop by distance before it enters the graph.

The search has left out low scores before (`by_distance`). Recognised places are judged one by one, then
accepted in sets that agree: `by_appearance.judge_place` and `accepted_sets`.
"""

from __future__ import annotations

import numpy as np

from turtlebag.datasets.se2 import SE2, Array, between
from turtlebag.pipeline.slam.loops.free_space import contradicts, mean_violation
from turtlebag.pipeline.slam.loops.matcher import Stretch
from turtlebag.pipeline.slam.scans.align import Alignment
from turtlebag.pipeline.slam.scans.clouds import Clouds

# An alignment that ends farther than this from the search result [m], [rad] has moved to another place.
PEAK = 0.15


def loop_verdict(
    found: Alignment,
    searched: Array,
    clouds: Clouds,
    stretches: tuple[Stretch, Stretch],
    min_overlap: float,
) -> str:
    """ "accepted", or the reason against it, for a stretch aligned with another one, from the pose (3,) at
    which the search placed it."""
    query, place = stretches
    T_j_i = found.T_map_base.xyt
    if not found.possible or found.agreement < min_overlap:
        return "low overlap"
    if np.abs(between(searched, T_j_i)).max() > PEAK:
        return "alignment left the peak"
    if contradicts(_violation(clouds, query, place, T_j_i)):
        return "free-space violations"
    return "accepted"


def _violation(clouds: Clouds, query: Stretch, place: Stretch, T_j_i: Array) -> float:
    """Mean share of free-space violations between two stretches, `query` at a pose (3,) in `place`."""
    scans = np.concatenate([query.scans, place.scans])
    poses = np.vstack([(SE2(T_j_i) @ SE2(query.T_about_scans)).xyt, place.T_about_scans])
    a, b = np.arange(len(query.scans)), len(query.scans) + np.arange(len(place.scans))
    pairs = np.stack(np.meshgrid(a, b, indexing="ij"), axis=-1).reshape(-1, 2)
    return mean_violation(clouds, scans, poses, pairs, 0.0)
