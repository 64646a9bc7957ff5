"""Is this map good? Asked without any truth.

Revisit consistency: two key scans at the same place must see the same walls. Where one saw through
what the other saw as a wall, the map is doubled or folded there. Map entropy: how undecided the cells
are. Lost scans: where neither the walls nor the odometry held the pose.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from datasets.kernels import njit
from datasets.se2 import SE2, Array
from datasets.types import Recording
from pipeline.slam.align import LEAST_OVERLAP
from pipeline.slam.clouds import Clouds
from pipeline.slam.occupancy import Certainty
from pipeline.slam.threads import in_parts
from pipeline.slam.track import HYPOTHESES, OdometryNoise, Track
from pipeline.slam.verdict import Verdict
from pipeline.slam.witnesses import agree, too_fast, unwitnessed

# A way [m] that nobody saw, at a speed that is known from before, may be this long.
UNSEEN_M = 1.5
# A point this near a wall confirms it; a wall that is seen through by so much is denied [m].
WALL_M, THROUGH_M = 0.15, 0.4
# Key scans this near [m] are one place; so many pairs of them are looked at. This share of denied points
# marks a place as bad.
NEAR_M, MOST_PAIRS, BAD_SHARE = 1.5, 3000, 0.35


class SelfCheckConfig(BaseModel):
    """When a map is called doubtful."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    apart_keys: int = Field(default=30, gt=0, description="and this far apart in time are a revisit")
    max_denied: float = Field(default=0.08, gt=0.0, description="share of denied points, mean over revisits")
    max_bad_places: float = Field(default=0.05, gt=0.0, description="share of such places")
    min_contradicted: int = Field(
        default=5, gt=0, description="key scans that most of their revisits deny, to doubt a map"
    )
    min_wall_share: float = Field(
        default=0.3, ge=0.0, description="of the beams that meet a wall's cells, returned by them"
    )
    max_lost: float = Field(default=0.02, gt=0.0, description="share of lost scans")


@dataclass(frozen=True, eq=False)
class SelfCheck(Verdict):
    """Numbers of the check and what is wrong, in words; `denied` is (n, 3): key i, key j, share."""

    revisits: int
    denied_mean: float
    bad_places: float
    lost_scans: int
    denied: Array
    certainty: Certainty
    reasons: tuple[str, ...]

    @property
    def numbers(self) -> dict[str, Any]:
        """Of the places seen twice, the scans and the cells."""
        return {
            "revisits": self.revisits,
            "denied_mean": self.denied_mean,
            "bad_places": self.bad_places,
            "lost_scans": self.lost_scans,
            "map_entropy_bits": self.certainty.entropy_bits,
            "wall_share": self.certainty.wall_share,
        }


def check_map(
    recording: Recording,
    clouds: Clouds,
    track: Track,
    T_map_base: SE2,
    T_map_keys: SE2,
    config: SelfCheckConfig,
    noise: OdometryNoise,
    breaks: NDArray[np.int64],
    borders: NDArray[np.int64],
    certainty: Certainty,
) -> SelfCheck:
    """Check a finished map: poses of all scans (n,) and of the key scans.

    The track's `overlap` is that of each scan with the map as it ended. `noise` is what the odometry's is
    taken for, `breaks` are the scans before which nothing confirms the motion, and that no recognised place
    joins to the rest, `borders` the first scans of later recordings; `certainty` is the grid's.
    """
    pairs = _revisits(T_map_keys, config)
    # Either visit may be the one that saw through the other's walls.
    both_ways = np.concatenate([pairs, pairs[:, ::-1]])
    found = in_parts(
        lambda part: denied_shares(clouds, track.keys, T_map_keys.xyt, both_ways[part], WALL_M, THROUGH_M),
        len(both_ways),
    )
    share = np.fmax(*np.concatenate(found).reshape(2, -1))
    known = np.isfinite(share)
    pairs, share = pairs[known], share[known]
    mean = float(share.mean()) if len(share) else 0.0
    bad = float(np.mean(share > BAD_SHARE)) if len(share) else 0.0
    lost = np.flatnonzero(track.usable & (track.overlap < LEAST_OVERLAP))
    reasons = []
    alone = contradicted_keys(pairs, share, BAD_SHARE)
    if mean > config.max_denied or bad > config.max_bad_places or len(alone) >= config.min_contradicted:
        worst = pairs[int(np.argmax(share))]
        x, y = T_map_keys.xy[worst[0]]
        reasons.append(
            f"revisited places contradict each other (worst near x {x:.1f}, y {y:.1f}): folded or doubled"
        )
    if certainty.wall_share < config.min_wall_share:
        reasons.append(
            f"beams pass through the walls: they return {certainty.wall_share:.0%} of those that meet them"
        )
    if len(lost) > config.max_lost * max(len(track.usable), 1):
        reasons.append(f"{len(lost)} scans do not fit the map (first: scan {lost[0]})")
    if len(breaks):
        reasons.append(
            f"{len(breaks)} breaks where scans are missing and nothing confirms the odometry "
            f"(first: before scan {breaks[0]}): what follows may lie anywhere"
        )
    if recording.turned_over:
        reasons.append(
            "scans and odometry turn opposite ways, and no gyro tells which is right: "
            "if it is the scans, this map is mirrored"
        )
    blind = int(np.count_nonzero(~track.usable))
    if blind > 0.1 * len(track.usable):
        reasons.append(f"{blind} scans see no surface")
    reasons += _unlikely_motion(recording, track, T_map_base, noise, borders)
    longest = _longest_blind(track)
    if longest is not None and track.odometry_steps is None:
        reasons.append(f"scans {longest[0]}..{longest[1]} see one direction only and no odometry helps")
    denied = np.column_stack([pairs, share]) if len(share) else np.zeros((0, 3))
    return SelfCheck(len(share), mean, bad, len(lost), denied, certainty, tuple(reasons))


def _revisits(T_map_keys: SE2, config: SelfCheckConfig) -> NDArray[np.int64]:
    pairs = scipy.spatial.cKDTree(T_map_keys.xy).query_pairs(NEAR_M, output_type="ndarray")
    pairs = pairs[np.abs(pairs[:, 1] - pairs[:, 0]) >= config.apart_keys]
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    return np.asarray(pairs[:: max(1, len(pairs) // MOST_PAIRS)], dtype=np.int64)


def contradicted_keys(pairs: NDArray[np.int64], share: Array, limit: float) -> NDArray[np.int64]:
    """Keys denied (by more than `limit`) in more than half of their revisits: however few of a long log,
    they lie where they cannot be."""
    n = int(pairs.max()) + 1 if len(pairs) else 0
    visits = np.bincount(pairs.ravel(), minlength=n)
    denials = np.bincount(pairs[share > limit].ravel(), minlength=n)
    return np.flatnonzero(2 * denials > visits)


def _unlikely_motion(
    recording: Recording, track: Track, T_map_base: SE2, noise: OdometryNoise, borders: NDArray[np.int64]
) -> list[str]:
    """What is wrong with the way the robot took: jumps, and stretches that nobody saw."""
    reasons, scans = [], np.setdiff1d(np.arange(len(recording) - 1), borders - 1)
    fast = too_fast(recording, track, T_map_base, scans, scans + 1)
    jumps = [k for k in scans[fast].tolist() if not agree(recording, track, k, k + 1, T_map_base)]
    if jumps:
        reasons.append(f"{len(jumps)} jumps farther than the robot can drive (first: to scan {jumps[0] + 1})")
    way = unwitnessed(recording, track, noise, borders)
    total = np.cumsum(way)
    # of a stretch: what was gathered since the last scan that is none of it
    stretch = total - np.maximum.accumulate(np.where(way > 0.0, 0.0, total))
    if len(stretch) and stretch.max() > UNSEEN_M:
        last = int(stretch.argmax())
        reasons.append(
            f"nothing vouches for {stretch[last]:.1f} m up to scan {last}: the scans are blind there, and "
            "the odometry was wrong just before or after"
        )
    return reasons


def _longest_blind(track: Track) -> tuple[int, int] | None:
    """Longest run of scans (at least 25) that are blind in one direction, (first, last)."""
    least = np.linalg.eigvalsh(track.information[:, :2, :2])
    blind = track.usable & (least[:, 0] < 0.002 * np.maximum(least[:, 1], 1e-9))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], blind.astype(int), [0]])))
    runs = edges.reshape(-1, 2)
    if len(runs) == 0:
        return None
    first, end = runs[int(np.argmax(runs[:, 1] - runs[:, 0]))]
    return (int(first), int(end) - 1) if end - first >= 25 else None


@njit(cache=True, nogil=True)
def denied_shares(
    clouds: Clouds, keys: NDArray, poses: Array, pairs: NDArray, wall: float, through: float
) -> Array:
    """Per pair: of i's points that j confirms or denies, the share denied; NaN when fewer than 20."""
    points, starts, table, origin = clouds.points, clouds.starts, clouds.table, clouds.origin
    n_bins = table.shape[1]
    scale = n_bins / (2.0 * math.pi)
    out = np.full(len(pairs), np.nan)
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        c, s = math.cos(poses[b, 2]), math.sin(poses[b, 2])
        dx, dy = poses[a, 0] - poses[b, 0], poses[a, 1] - poses[b, 1]
        tx, ty = c * dx + s * dy, -s * dx + c * dy
        dyaw = poses[a, 2] - poses[b, 2]
        c, s = math.cos(dyaw), math.sin(dyaw)
        confirmed, denied = 0, 0
        for r in range(starts[keys[a]], starts[keys[a] + 1]):
            x = tx + c * points[r, 0] - s * points[r, 1]
            y = ty + s * points[r, 0] + c * points[r, 1]
            ex, ey = x - origin[0], y - origin[1]
            distance = math.sqrt(ex * ex + ey * ey)
            bin_ = int((math.atan2(ey, ex) + math.pi) * scale)
            half = min(6, int(wall / max(distance, wall) * scale) + 1)
            nearest, shortest, seen = 1e9, 1e9, 0
            for q in range(bin_ - half, bin_ + half + 1):
                row = table[keys[b], q % n_bins]
                if row < 0:
                    continue
                px, py = points[row, 0], points[row, 1]
                nearest = min(nearest, math.hypot(px - x, py - y))
                shortest = min(shortest, math.hypot(px - origin[0], py - origin[1]))
                seen += 1
            if nearest < wall:
                confirmed += 1
            elif seen >= 3 and shortest > distance + through:
                denied += 1
        if confirmed + denied >= 20:
            out[k] = denied / (confirmed + denied)
    return out


def hypothesis_shares(track: Track) -> dict[str, float]:
    """How often each start of the front end won."""
    counts = np.bincount(track.source[1:], minlength=len(HYPOTHESES)) if len(track.source) > 1 else [0] * 4
    total = max(int(np.sum(counts)), 1)
    return {name: float(count) / total for name, count in zip(HYPOTHESES, counts, strict=True)}
