"""The evidence for each step of a track: whether scans, wheels, both or neither observed the motion.

It is written once a log is tracked. Deskewing without odometry, the constraints between key scans, the breaks
of the track and the self-check read it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.motion import fastest, way_and_turn
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.odometry.calibration import Calibration
from turtlebag.pipeline.slam.odometry.track import AGREE, AGREE_M, OdometryNoise, Track, blind, confirms
from turtlebag.pipeline.slam.odometry.trust import distrusted_steps

NO_BORDERS = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Evidence:
    """What scans and wheels each say of n scans and of the steps that end at them, all (n,).

    `seen` says which scans had points to align, `blind` which of them observe only one direction.
    `T_odom_base` are the wheels' poses, None without odometry, and `calibration` their systematic errors;
    `distrusted` says where the scans contradict them, or there are none. `unobserved_m` is the way of each
    step that neither scans nor wheels observed [m]. `borders` (b,) are the first scans of later logs: no step
    leads to them.
    """

    stamps_ns: NDArray[np.int64]
    seen: NDArray[np.bool_]
    blind: NDArray[np.bool_]
    T_odom_base: SE2 | None
    calibration: Calibration
    distrusted: NDArray[np.bool_]
    unobserved_m: Array
    borders: NDArray[np.int64]

    def agreed(self, T_map_base: SE2, before: int, after: int) -> bool:
        """Whether the wheels agree with the motion between two scans by their poses (n,)."""
        T = self.T_odom_base
        if T is None:
            return False
        odometry = self.calibration.corrected((T[before].inverse() @ T[after]).xyt)
        return confirms(odometry, (T_map_base[before].inverse() @ T_map_base[after]).xyt)

    def too_fast(
        self, T_map_base: SE2, before: NDArray[np.int64], after: NDArray[np.int64]
    ) -> NDArray[np.bool_]:
        """Whether the poses (n,) move faster between scans (k,) and later ones (k,) than the robot ever
        drives or turns, (k,)."""
        waits, steps = seconds(np.diff(self.stamps_ns)), way_and_turn(T_map_base.steps())
        seen = (waits > 0.0) & self.seen[1:] & self.seen[:-1]
        if not seen.any():
            return np.zeros(len(before), dtype=bool)
        # stamps jitter, so no step counts as shorter than usual
        least_s = np.median(waits[seen])
        reach = fastest(steps[seen], np.maximum(waits[seen], least_s))
        wait = seconds(self.stamps_ns[after] - self.stamps_ns[before])
        moved = way_and_turn((T_map_base[before].inverse() @ T_map_base[after]).xyt)
        allowed = reach * np.maximum(wait, least_s * (after - before))[:, None] + [AGREE_M, AGREE]
        return np.asarray((wait > 0.0) & (moved > allowed).any(axis=1))

    def jumps(self, T_map_base: SE2, over: int = 1) -> NDArray[np.int64]:
        """Scans and those `over` scans later (k, 2) that by their poses (n,) lie farther apart than the robot
        can drive and than its wheels say, without a border between them."""
        scans = np.arange(over, len(self.stamps_ns))
        pairs = np.column_stack([scans - over, scans])
        log = np.searchsorted(self.borders, pairs, "right")
        pairs = pairs[log[:, 0] == log[:, 1]]
        far = pairs[self.too_fast(T_map_base, *pairs.T)].tolist()
        apart = [pair for pair in far if not self.agreed(T_map_base, *pair)]
        return np.array(apart, dtype=np.int64).reshape(-1, 2)


def evidence_of(
    recording: Recording, track: Track, noise: OdometryNoise, borders: NDArray[np.int64] = NO_BORDERS
) -> Evidence:
    """The evidence for a track. `noise` is that assumed for the odometry; `borders` are the first scans of
    later logs."""
    unseen = blind(track.information)
    doubted = _distrusted(recording, track, unseen, noise, borders)
    return Evidence(
        recording.stamps_ns,
        track.usable,
        unseen,
        recording.T_odom_base,
        track.calibration,
        doubted,
        _way(recording, track) * (unseen & doubted),
        borders,
    )


def _distrusted(
    recording: Recording,
    track: Track,
    unseen: NDArray[np.bool_],
    noise: OdometryNoise,
    borders: NDArray[np.int64],
) -> NDArray[np.bool_]:
    """At which scans (n,) the odometry is distrusted, before or after, or missing."""
    n, T_odom, poses = len(track.T_track_base), recording.T_odom_base, track.T_track_base.xyt
    if T_odom is None:
        return np.ones(n, dtype=bool)
    doubted = np.zeros(n, dtype=bool)
    for order in (np.arange(n), np.arange(n)[::-1]):
        steps, scans = track.calibration.corrected(T_odom[order].steps()), order[1:]
        new = np.isin(scans, borders if order[0] == 0 else borders - 1)
        seen = track.information[scans]
        doubted[scans] |= distrusted_steps(
            steps, poses[scans], seen, ~unseen[scans], new, (noise.floor, noise.share)
        )
    return doubted


def _way(recording: Recording, track: Track) -> Array:
    """Way of each step (n,) [m], by track or odometry, whichever is longer."""
    way = np.append(0.0, way_and_turn(track.T_track_base.steps())[:, 0])
    if recording.T_odom_base is not None:
        steps = track.calibration.corrected(recording.T_odom_base.steps())
        way[1:] = np.maximum(way[1:], way_and_turn(steps)[:, 0])
    return way
