"""Self-check of a 3D map, without ground truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.motion import gaps_between
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.se3 import SE3
from turtlebag.pipeline.slam.check.base import Verdict
from turtlebag.pipeline.slam.check.verdict import APART_KEYS, MOST_WRONG
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind
from turtlebag.pipeline.slam.graph.cost import residuals
from turtlebag.pipeline.slam3d.cloud_tracking import Track3d
from turtlebag.pipeline.slam3d.surfels import LEAST_OVERLAP

MOST_LOST, MOST_EMPTY = 0.02, 0.2
"""Shares of clouds that fit nothing, of clouds with too few points; of revisits no more than MOST_WRONG may
disagree."""
APART_VOXELS = 0.5
"""A revisit that is off by more disagrees."""


@dataclass(frozen=True, eq=False)
class SelfCheck3d(Verdict):
    """Measurements of the check - revisits, clouds - and the reasons for doubt."""

    revisits: int
    disagreeing: float
    lost_scans: int
    empty_scans: int
    reasons: tuple[str, ...]


def check_map(
    stamps_ns: NDArray[np.int64],
    track: Track3d,
    T_map_keys: Array,
    constraints: Sequence[Constraint],
    voxel: float,
) -> SelfCheck3d:
    """Check a finished map."""
    empty = int(np.count_nonzero(~track.usable))
    lost: NDArray[np.int64] = np.flatnonzero(track.usable & (track.overlap < LEAST_OVERLAP))
    seen = [c for c in constraints if c.kind in (Kind.PAIR, Kind.LOOP) and abs(c.j - c.i) >= APART_KEYS]
    left = np.linalg.norm(residuals(SE3(T_map_keys), seen)[:, 3:], axis=1)
    disagreeing = float(np.mean(left > APART_VOXELS * voxel)) if len(left) else 0.0
    reasons = []
    if empty > MOST_EMPTY * len(track.T):
        reasons.append(f"{empty} of {len(track.T)} clouds hold too few points")
    if len(lost) > MOST_LOST * len(track.T):
        reasons.append(f"{len(lost)} clouds fit nothing before them")
    reasons += _broken(stamps_ns, track, lost, constraints)
    if disagreeing > MOST_WRONG:
        reasons.append(f"{100 * disagreeing:.0f} % of the revisits disagree")
    return SelfCheck3d(len(seen), disagreeing, len(lost), empty, tuple(reasons))


def _broken(
    stamps_ns: NDArray[np.int64], track: Track3d, lost: NDArray[np.int64], constraints: Sequence[Constraint]
) -> list[str]:
    """What cannot be bridged without odometry: a lost cloud, and a time without clouds.

    A match across such a time starts at a guess that may be far off; only a recognised place is evidence.
    """
    if track.T_odom is not None:
        return []
    keys, reasons = np.array(track.keys), []
    tied = [
        (*sorted((keys[c.i], keys[c.j])), c.kind) for c in constraints if c.kind in (Kind.PAIR, Kind.LOOP)
    ]
    alone = [index for index in lost.tolist() if not any(a < index < b for a, b, _ in tied)]
    if alone:
        reasons.append(f"cloud {alone[0]} fits nothing before it, and no later match connects the two parts")
    places = [(a, b) for a, b, kind in tied if kind is Kind.LOOP]
    gaps = gaps_between(stamps_ns, track.usable)[:, 1].tolist()
    unknown = [after for after in gaps if not any(a < after <= b for a, b in places)]
    if unknown:
        reasons.append(
            f"a gap without clouds or odometry before cloud {unknown[0]}: the map after it may be misplaced"
        )
    return reasons
