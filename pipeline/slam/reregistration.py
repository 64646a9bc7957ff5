"""Re-registration: a pose for every scan, moved with the refined key scans, then aligned with the nearest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy
from numpy.typing import NDArray
from pydantic import Field

from turtlebag.datasets import se3
from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.threads import in_parts
from turtlebag.pipeline.slam.graph.pose_graph import Poses, relative
from turtlebag.pipeline.slam.odometry.track import Track
from turtlebag.pipeline.slam.scans.align import (
    LEAST_OVERLAP,
    MOST_POINTS,
    NEIGHBOURS,
    Prior,
    align_kernel,
)
from turtlebag.pipeline.slam.scans.clouds import Clouds
from turtlebag.pipeline.slam.scans.correspondences import FINE, Limits
from turtlebag.pipeline.slam.scans.scans import joined_clouds

# Scans whose points are computed together; this takes several times their size in memory.
SCANS_AT_ONCE = 2000
# Gauss-Newton steps of one scan.
ITERATIONS = 5
NO_GAPS = np.zeros((0, 2), dtype=np.int64)
# Standard deviation of a pose interpolated between key scans [m]; of its yaw half as much [rad].
CARRIED_M = 0.003


class ReregistrationConfig(Settings):
    """Alignment of the scans between key scans."""

    enabled: bool = Field(default=True, description="align each with the key scans near it")


def carried_poses(
    T_track: Poses, keys: NDArray[np.int64], T_map_keys: Poses, gaps: NDArray[np.int64] = NO_GAPS
) -> Poses:
    """Each scan of a track moved with the key scans before and after it, their corrections blended.

    Across `gaps` (n, 2), last scan before and first scan after each, the track does not know the motion, or
    jumps: scans before a gap move with the key before it alone, scans after it with the key after it.
    """
    scans = np.arange(len(T_track))
    before = np.maximum(np.searchsorted(keys, scans, side="right") - 1, 0)
    after = np.minimum(before + 1, len(keys) - 1)
    from_before = T_map_keys[before] @ relative(T_track[keys[before]], T_track)
    from_after = T_map_keys[after] @ relative(T_track[keys[after]], T_track)
    fraction = np.maximum(scans - keys[before], 0) / np.maximum(keys[after] - keys[before], 1)
    for last, first in gaps.tolist():
        within = (before == before[last]) & (scans < keys[after[last]])
        fraction[within] = np.clip((scans[within] - last) / (first - last), 0.0, 1.0)
    if isinstance(from_before, SE2):
        return from_before.interpolate(from_after, fraction)
    return se3.interpolate(from_before, from_after, fraction)


def pose_all_scans(
    of_keys: Clouds,
    clouds_of: Callable[[NDArray[np.int64]], Clouds],
    track: Track,
    T_map_keys: SE2,
    config: ReregistrationConfig,
    gaps: NDArray[np.int64],
) -> tuple[SE2, Array]:
    """Poses (n,) of all scans in the map, and the share of each that lies on its surfaces (n,). Key scans
    keep their refined poses. `of_keys` are their clouds, `clouds_of` is as in a session, `gaps` as in
    `carried_poses`."""
    carried = carried_poses(track.T_track_base, track.keys, T_map_keys, gaps)
    if not config.enabled or len(track.keys) < 2:
        return carried, track.overlap
    poses, overlaps = carried.xyt.copy(), track.overlap.copy()
    count = min(NEIGHBOURS, len(track.keys))
    _, nearest = scipy.spatial.cKDTree(T_map_keys.xy).query(carried.xy, k=count)
    near = np.atleast_2d(nearest).reshape(len(poses), count)
    information = np.diag(np.array([CARRIED_M, CARRIED_M, 0.5 * CARRIED_M]) ** -2.0)
    is_key = np.zeros(len(poses), dtype=bool)
    is_key[track.keys] = True
    scans = np.flatnonzero(~is_key & track.usable)

    by_lines = np.zeros(len(poses), dtype=bool)
    limits = FINE._replace(iterations=ITERATIONS, most_points=MOST_POINTS)

    def aligned(some: NDArray[np.int64]) -> list[tuple[Array, Array]]:
        both, numbers = joined_clouds([of_keys, clouds_of(some)]), len(T_map_keys) + np.arange(len(some))
        by_lines[some] = [both.placed_by(k) == "lines" for k in numbers.tolist()]
        return in_parts(
            lambda part: _align_each(
                both, numbers[part], poses[some[part]], near[some[part]], T_map_keys.xyt, information, limits
            ),
            len(some),
        )

    found = [
        one for at in range(0, len(scans), SCANS_AT_ONCE) for one in aligned(scans[at : at + SCANS_AT_ONCE])
    ]
    if not found:
        return carried, overlaps
    new, overlap = (np.concatenate([part[k] for part in found]) for k in (0, 1))
    shift = np.linalg.norm(new[:, :2] - poses[scans, :2], axis=1)
    good = (overlap >= LEAST_OVERLAP) & (shift <= FINE.gate)
    poses[scans[good]] = new[good]
    walls = by_lines[scans]
    overlaps[scans[walls]] = overlap[walls]
    return SE2(poses), overlaps


@njit(cache=True, nogil=True)
def _align_each(
    clouds: Clouds,
    scans: NDArray,
    poses: Array,
    near: NDArray,
    key_poses: Array,
    information: Array,
    limits: Limits,
) -> tuple[Array, Array]:
    """Scans (n,) aligned from their poses with key scans near[k], the first of the clouds: poses (n, 3),
    overlap (n,)."""
    out, overlap = poses.copy(), np.zeros(len(scans))
    for k in range(len(scans)):
        prior = Prior(poses[k], information, 0.0)
        pose, _, matched, usable, _, _, _ = align_kernel(
            clouds, scans[k], poses[k], near[k], key_poses[near[k]], limits, prior
        )
        out[k] = pose
        if usable > 0:
            overlap[k] = matched / usable
    return out, overlap
