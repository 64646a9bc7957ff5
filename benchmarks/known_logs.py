"""Logs together with what is known of them, relations and true poses, and how to change both alike.

What is done to the scans of a log, to its odometry and to its time is done to its truth as well, so that the
new log is scored as the old one was.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.relations import Relations
from turtlebag.datasets.se2 import SE2, Array, wrap
from turtlebag.datasets.types import Recording, Trajectory
from turtlebag.reports.metrics.relations import nearest

Mask = NDArray[np.bool_]
NO_RELATIONS = Relations(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), SE2.identity(0))


@dataclass(frozen=True, eq=False)
class Known:
    """A log and what is known of it.

    `reference` holds a pose for each scan (n,), NaN where nobody knows it; `which` says which of the
    undisturbed log's relations are left.
    """

    recording: Recording
    reference: SE2
    relations: Relations = NO_RELATIONS
    which: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @property
    def truth(self) -> Trajectory:
        """The reference as a trajectory."""
        return Trajectory(self.recording.stamps_ns, self.reference)

    @property
    def odometry(self) -> SE2:
        """Odometry at each scan; ValueError when the log has none."""
        if self.recording.T_odom_base is None:
            raise ValueError(f"{self.recording.source}: no odometry to disturb")
        return self.recording.T_odom_base

    @property
    def times(self) -> Array:
        """Seconds since the first scan, (n,)."""
        stamps = self.recording.stamps_ns
        return np.asarray((stamps - stamps[0]) * 1e-9)

    def recorded(self, **changes: Any) -> Known:
        """The log with something else in its recording."""
        return replace(self, recording=replace(self.recording, **changes))

    def with_scans(self, keep: Mask | slice) -> Known:
        """The log with these scans only, and the relations whose two scans are left."""
        r = self.recording
        T_odom_base = None if r.T_odom_base is None else r.T_odom_base[keep]
        recording = replace(r, stamps_ns=r.stamps_ns[keep], ranges=r.ranges[keep], T_odom_base=T_odom_base)
        pairs = self.relations
        left = np.ones(len(pairs), dtype=bool)
        for wanted in (pairs.stamps_a_ns, pairs.stamps_b_ns):
            left &= nearest(recording.stamps_ns, wanted)[1]
        reference, relations = self.reference[keep], chosen(pairs, left)
        return replace(
            self, recording=recording, reference=reference, relations=relations, which=self.which[left]
        )

    def places(self, count: int, rng: np.random.Generator | None = None) -> list[int]:
        """Up to `count` scans far apart in time: where the robot turns most, or with `rng` anywhere."""
        t, n = self.times, len(self.recording)
        turn = np.convolve(np.abs(self.odometry.steps()[:, 2]), np.ones(15), "same")
        order = np.argsort(-turn, kind="stable") if rng is None else rng.permutation(len(turn))
        margin, apart = min(60, n // 10), min(60.0, self.recording.duration() / (2 * count))
        found: list[int] = []
        for i in order[(order >= margin) & (order < n - margin)]:
            if len(found) < count and all(abs(t[i] - t[j]) > apart for j in found):
                found.append(int(i))
        return found

    def around(self, centres: list[int], seconds: float) -> Mask:
        """Scans within a stretch of so many seconds about one of the centres, (n,)."""
        t = self.times
        return np.asarray((np.abs(t[:, None] - t[centres]) <= 0.5 * seconds).any(axis=1))

    def with_odometry(self, T_odom_base: SE2) -> Known:
        """The log with another odometry at its scans.

        Between two scans the full-rate stream, where there is one, takes its share of what has changed.
        """
        r, old = self.recording, self.odometry
        odometry = r.odometry
        if odometry is not None:
            k = np.clip(np.searchsorted(r.stamps_ns, odometry.stamps_ns, side="right") - 1, 0, len(r) - 2)
            extra = (SE2(old.steps()).inverse() @ SE2(T_odom_base.steps()))[k]
            spans = np.diff(r.stamps_ns)[k]
            share = np.clip((odometry.stamps_ns - r.stamps_ns[k]) / np.maximum(spans, 1), 0.0, 1.0)
            within = old[k].inverse() @ odometry.poses
            poses = T_odom_base[k] @ within @ SE2.identity(len(k)).interpolate(extra, share)
            odometry = Trajectory(odometry.stamps_ns, poses)
        return self.recorded(T_odom_base=T_odom_base, odometry=odometry)

    def with_steps(self, moved: ArrayLike) -> Known:
        """The log whose odometry makes these steps (n - 1, 3) from where it started."""
        poses = integrate(self.odometry.xyt[0], np.asarray(moved, dtype=np.float64))
        return self.with_odometry(SE2.from_array(poses))

    def with_ranges(self, ranges: ArrayLike) -> Known:
        """The log with other ranges (n_scans, n_beams)."""
        return self.recorded(ranges=np.asarray(ranges, dtype=np.float32))

    def without_returns(self, lost: ArrayLike) -> Known:
        """The log with no return on these beams."""
        return self.with_ranges(np.where(lost, np.inf, self.recording.ranges))

    def shortened(self, metres: float) -> Known:
        """No returns from beyond a range."""
        return self.without_returns(self.recording.ranges > metres)

    def outside(self, degrees: float) -> Mask:
        """Beams beside a view of so many degrees straight ahead of the lidar, (n_beams,)."""
        return np.abs(wrap(self.recording.lidar.angles)) > np.deg2rad(0.5 * degrees) + 1e-9

    def mirrored_scans(self) -> Known:
        """The log whose lidar hangs upside down and does not say so."""
        lidar = self.recording.lidar
        lidar = replace(lidar, angle_min=-lidar.angle_min, angle_increment=-lidar.angle_increment)
        return self.recorded(lidar=lidar)


def known(recording: Recording, reference: SE2, relations: Relations = NO_RELATIONS) -> Known:
    """An undisturbed log."""
    return Known(recording, reference, relations, np.arange(len(relations)))


def chosen(relations: Relations, which: NDArray[Any]) -> Relations:
    """Some of the relations, by index or mask."""
    return Relations(relations.stamps_a_ns[which], relations.stamps_b_ns[which], relations.T_a_b[which])


@njit(cache=True)
def integrate(start: Array, steps: Array) -> Array:
    """Poses (n + 1, 3) from a first one (3,) and the steps (n, 3) from each to the next."""
    out = np.empty((len(steps) + 1, 3))
    out[0] = start
    for k in range(len(steps)):
        c, s = math.cos(out[k, 2]), math.sin(out[k, 2])
        out[k + 1, 0] = out[k, 0] + c * steps[k, 0] - s * steps[k, 1]
        out[k + 1, 1] = out[k, 1] + s * steps[k, 0] + c * steps[k, 1]
        out[k + 1, 2] = out[k, 2] + steps[k, 2]
    return out
