"""Is this 3D map good? Asked without any truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.slam.factors import Constraint
from turtlebag.pipeline.slam.pose_graph import residuals
from turtlebag.pipeline.slam.verdict import Verdict
from turtlebag.pipeline.slam3d.cloud_tracking import Track3d


class SelfCheck3dConfig(BaseModel):
    """When a map is called doubtful."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    min_overlap: float = Field(default=0.35, gt=0.0, description="of a cloud with those before it, not lost")
    max_lost: float = Field(default=0.02, gt=0.0, description="share of lost clouds")
    max_empty: float = Field(default=0.2, gt=0.0, description="share of clouds with too few points")
    apart_keys: int = Field(default=30, gt=0, description="pairs this far apart in time are a revisit")
    apart_voxels: float = Field(default=0.5, gt=0.0, description="a revisit that is off by more disagrees")
    max_disagreeing: float = Field(default=0.05, gt=0.0, description="share of such revisits")


@dataclass(frozen=True, eq=False)
class SelfCheck3d(Verdict):
    """Numbers of the check, and what is wrong in words."""

    revisits: int
    disagreeing: float
    lost_scans: int
    empty_scans: int
    reasons: tuple[str, ...]

    @property
    def numbers(self) -> dict[str, Any]:
        """Of the places seen twice and the clouds."""
        return {
            "revisits": self.revisits,
            "disagreeing": self.disagreeing,
            "lost_scans": self.lost_scans,
            "empty_scans": self.empty_scans,
        }


def check_map(
    track: Track3d,
    T_map_keys: Array,
    constraints: Sequence[Constraint],
    voxel: float,
    config: SelfCheck3dConfig,
) -> SelfCheck3d:
    """Check a finished map."""
    empty = int(np.count_nonzero(~track.usable))
    lost: NDArray[np.int64] = np.flatnonzero(track.usable & (track.overlap < config.min_overlap))
    seen = [c for c in constraints if c.kind in ("pair", "loop") and abs(c.j - c.i) >= config.apart_keys]
    left = np.linalg.norm(residuals(T_map_keys, seen)[:, 3:], axis=1)
    disagreeing = float(np.mean(left > config.apart_voxels * voxel)) if len(left) else 0.0
    reasons = []
    if empty == len(track.T):
        reasons.append("no cloud holds enough points to map with")
    elif empty > config.max_empty * len(track.T):
        reasons.append(f"{empty} of {len(track.T)} clouds hold too few points")
    if len(lost) > config.max_lost * len(track.T):
        reasons.append(f"{len(lost)} clouds fit nothing before them")
    reasons += _broken(track, lost, constraints)
    if disagreeing > config.max_disagreeing:
        reasons.append(f"{100 * disagreeing:.0f} % of the revisits disagree")
    return SelfCheck3d(len(seen), disagreeing, len(lost), empty, tuple(reasons))


def _broken(track: Track3d, lost: NDArray[np.int64], constraints: Sequence[Constraint]) -> list[str]:
    """A lost cloud that nothing bridges: neither odometry nor any constraint from before to after it."""
    if track.T_odom is not None or len(lost) == 0:
        return []
    keys = np.array(track.keys)
    bridges = [(keys[min(c.i, c.j)], keys[max(c.i, c.j)]) for c in constraints if c.kind in ("pair", "loop")]
    for index in lost.tolist():
        if not any(a < index < b for a, b in bridges):
            return [f"cloud {index} fits nothing before it, and nothing later ties the two parts together"]
    return []
