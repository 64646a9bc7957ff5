"""Is this map good? Asked without any truth.

Revisit consistency: two key scans at the same place must see the same walls. Where one saw through
what the other saw as a wall, the map is doubled or folded there. Map entropy: how undecided the cells
are. Lost scans: where neither the walls nor the odometry held the pose.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.align import LEAST_OVERLAP
from turtlebag.pipeline.slam.clouds import GAP_S, Clouds
from turtlebag.pipeline.slam.factors import Constraint
from turtlebag.pipeline.slam.map_uncertainty import position_sigmas, shared_errors
from turtlebag.pipeline.slam.occupancy import Certainty
from turtlebag.pipeline.slam.odometry_trust import jumps, unwitnessed
from turtlebag.pipeline.slam.partners import relative_pose
from turtlebag.pipeline.slam.threads import in_parts
from turtlebag.pipeline.slam.track import HYPOTHESES, OdometryNoise, Track
from turtlebag.pipeline.slam.verdict import Verdict

# A point this near a wall confirms it; a wall that is seen through by so much is denied [m].
WALL_M, THROUGH_M = 0.15, 0.4
# Key scans this near [m], and so many apart in time, are a revisit; so many are looked at. This share of
# denied points marks a place as bad.
NEAR_M, APART_KEYS, MOST_PAIRS, BAD_SHARE = 1.5, 30, 3000, 0.35
# No larger share of the places, or of the scans, than this may be wrong; nor may more key scans than this,
# however long the log, be denied by most of their revisits.
MOST_WRONG, MOST_DENIED = 0.05, 4
# Where the graph knows the places of some scans no better than this [m], one standard deviation, the worst of
# them may be 0.2 m off: it was off by 1.4 to 6 of these (ten logs of 20 m to 2 km with known poses).
LEAST_SURE_M = 0.1


@dataclass(frozen=True, eq=False)
class SelfCheck(Verdict):
    """Numbers of the check and what is wrong, in words; `denied` is (n, 3): key i, key j, share."""

    revisits: int
    denied_mean: float
    bad_places: float
    lost_scans: int
    denied: Array
    position_sigma_m: float
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
            "position_sigma_m": self.position_sigma_m,
            "map_entropy_bits": self.certainty.entropy_bits,
            "wall_share": self.certainty.wall_share,
        }


def check_map(
    recording: Recording,
    clouds: Clouds,
    track: Track,
    T_map_base: SE2,
    T_map_keys: SE2,
    constraints: Sequence[Constraint],
    noise: OdometryNoise,
    breaks: NDArray[np.int64],
    borders: NDArray[np.int64],
    certainty: Certainty,
) -> SelfCheck:
    """Check a finished map: poses of all scans (n,) and of the key scans, and what ties these together.

    The track's `overlap` is that of each scan with the map as it ended. `noise` is what the odometry's is
    taken for, `breaks` are the scans before which nothing confirms the motion, and that no recognised place
    joins to the rest, `borders` the first scans of later recordings; `certainty` is the grid's.
    """
    pairs = _revisits(T_map_keys)
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
    if bad > MOST_WRONG or len(alone) > MOST_DENIED:
        worst = pairs[int(np.argmax(share))]
        x, y = T_map_keys.xy[worst[0]]
        reasons.append(
            f"revisited places contradict each other (worst near x {x:.1f}, y {y:.1f}): "
            "the map is folded or doubled"
        )
    if len(lost) > MOST_WRONG * len(track.usable):
        reasons.append(f"{len(lost)} scans do not fit the map (first: scan {lost[0]})")
    if len(breaks):
        reasons.append(
            f"{len(breaks)} breaks where scans are missing, or fit nothing seen before, and nothing confirms "
            f"the odometry (first: before scan {breaks[0]}): the map after them may be misplaced"
        )
    if recording.turned_over:
        reasons.append(
            "scans and odometry turn in opposite directions, and there is no gyro to decide: "
            "if the scans are right, this map is mirrored"
        )
    empty = np.count_nonzero(~track.usable)
    if empty > MOST_WRONG * len(track.usable):
        reasons.append(f"{empty} scans see no surface")
    reasons += _jumps(recording, track, T_map_base, borders)
    unseen = unwitnessed(recording, track, noise, borders)
    asked, sigmas = position_sigmas(T_map_keys, constraints, shared_errors(track, constraints, unseen))
    sigma = float(sigmas.max())
    if sigma > LEAST_SURE_M:
        x, y = T_map_keys.xy[asked[sigmas.argmax()]]
        blind = f"; neither scans nor odometry show {unseen.sum():.1f} m of the way" if unseen.any() else ""
        reasons.append(
            f"the pose graph leaves the scans near x {x:.1f}, y {y:.1f} uncertain by {sigma:.2f} m (one "
            f"standard deviation): the map may be bent there{blind}"
        )
    denied = np.column_stack([pairs, share]) if len(share) else np.zeros((0, 3))
    return SelfCheck(len(share), mean, bad, len(lost), denied, sigma, certainty, tuple(reasons))


def _revisits(T_map_keys: SE2) -> NDArray[np.int64]:
    pairs = scipy.spatial.cKDTree(T_map_keys.xy).query_pairs(NEAR_M, output_type="ndarray")
    pairs = pairs[np.abs(pairs[:, 1] - pairs[:, 0]) >= APART_KEYS]
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    return np.asarray(pairs[:: max(1, len(pairs) // MOST_PAIRS)], dtype=np.int64)


def contradicted_keys(pairs: NDArray[np.int64], share: Array, limit: float) -> NDArray[np.int64]:
    """Keys denied (by more than `limit`) in more than half of their revisits: however few of a long log,
    they lie where they cannot be."""
    n = int(pairs.max()) + 1 if len(pairs) else 0
    visits = np.bincount(pairs.ravel(), minlength=n)
    denials = np.bincount(pairs[share > limit].ravel(), minlength=n)
    return np.flatnonzero(2 * denials > visits)


def _jumps(recording: Recording, track: Track, T_map_base: SE2, borders: NDArray[np.int64]) -> list[str]:
    """Whether the robot went farther than it can, from scan to scan or for some time."""
    period_s = float(np.median(np.abs(np.diff(recording.stamps_ns)))) * 1e-9 if len(recording) > 1 else GAP_S
    for over in (1, max(1, round(GAP_S / max(period_s, 1e-3)))):
        jumped = jumps(recording, track, T_map_base, borders, over)
        if len(jumped):
            return [f"{len(jumped)} jumps farther than the robot can drive (first: to scan {jumped[0]})"]
    return []


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
        tx, ty, dyaw = relative_pose(poses, b, a)
        c, s = math.cos(dyaw), math.sin(dyaw)
        confirmed, denied = 0, 0
        for r in range(starts[keys[a]], starts[keys[a] + 1]):
            x = tx + c * points[r, 0] - s * points[r, 1]
            y = ty + s * points[r, 0] + c * points[r, 1]
            ex, ey = x - origin[0], y - origin[1]
            distance = math.sqrt(ex * ex + ey * ey)
            bin_ = int((math.atan2(ey, ex) + math.pi) * scale)
            half = min(6, int(wall / max(distance, wall) * scale) + 1)
            nearest2, shortest2, seen = 1e9, 1e9, 0
            for q in range(bin_ - half, bin_ + half + 1):
                row = table[keys[b], q % n_bins]
                if row < 0:
                    continue
                dx, dy = points[row, 0] - x, points[row, 1] - y
                nearest2 = min(nearest2, dx * dx + dy * dy)
                dx, dy = points[row, 0] - origin[0], points[row, 1] - origin[1]
                shortest2 = min(shortest2, dx * dx + dy * dy)
                seen += 1
            if nearest2 < wall * wall:
                confirmed += 1
            elif seen >= 3 and shortest2 > (distance + through) ** 2:
                denied += 1
        if confirmed + denied >= 20:
            out[k] = denied / (confirmed + denied)
    return out


def free_space_violations(
    clouds: Clouds, keys: NDArray[np.int64], poses: Array, pairs: NDArray[np.int64]
) -> Array:
    """Share of points denied in each pair (n, 2) of scans at poses (k, 3) that sees enough of each other, the
    worse of both ways."""
    shares = [
        denied_shares(clouds, keys, poses, way, WALL_M, THROUGH_M)
        for way in (pairs, np.ascontiguousarray(pairs[:, ::-1]))
    ]
    share = np.fmax(*shares)
    return np.asarray(share[np.isfinite(share)])


def hypothesis_shares(track: Track) -> dict[str, float]:
    """How often each start of the front end won."""
    counts = np.bincount(track.source[1:], minlength=len(HYPOTHESES)) if len(track.source) > 1 else [0] * 4
    total = max(int(np.sum(counts)), 1)
    return {name: float(count) / total for name, count in zip(HYPOTHESES, counts, strict=True)}
