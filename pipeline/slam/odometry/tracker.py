"""The tracker runs a front end over a log: key scans, calibration, and the resulting track.

The robot has moved at a key scan, the front end is sure of it, and others can be matched with it.
"""

from __future__ import annotations

import weakref
from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.motion import GAP_PERIODS, gap_s, sweep_motion_by_track, sweeps
from turtlebag.datasets.se2 import SE2, Array, between, compose
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.odometry.calibration import Calibration, calibrate
from turtlebag.pipeline.slam.odometry.evidence import Evidence, evidence_of
from turtlebag.pipeline.slam.odometry.front_end import FrontEnd, Placed
from turtlebag.pipeline.slam.odometry.track import Track, TrackingConfig
from turtlebag.pipeline.slam.progress import Progress, no_progress
from turtlebag.pipeline.slam.scans.align import NEIGHBOURS
from turtlebag.pipeline.slam.scans.clouds import Clouds
from turtlebag.pipeline.slam.scans.correlative import Field, best_pose, make_field
from turtlebag.pipeline.slam.scans.scans import Scans

# Key scans of the coarse search, its cells [m], and of how many scans the usual time between them is.
FIELD_KEYS, FIELD_M, WAITS = 30, 0.1, 64
# The points of this many scans are made at once, or of a quarter of those before them.
AHEAD = 8192


class Tracker:
    """The log as far as it is tracked, a `TrackedLog`; between steps `scan` is the one placed last."""

    def __init__(
        self, clouds: Clouds, recording: Recording, config: TrackingConfig, max_range: float, make: Maker
    ) -> None:
        self.clouds, self.config, self.max_range = clouds, config, max_range
        self.odometry = None if recording.T_odom_base is None else recording.T_odom_base.xyt
        self.scan, self.velocity, self.calibration, self.after_gap = 0, np.zeros(3), Calibration(), False
        self._make, self._lidars, self._waits_s = make, len(clouds.origin), deque[float](maxlen=WAITS)
        self.keys: list[int] = []
        self._front_end: FrontEnd | None = None
        self._field: Field | None = None
        first = np.zeros(3) if self.odometry is None else self.odometry[0].copy()
        self._placed = [Placed(first, np.zeros((3, 3)), 1.0)]
        self._matchable = [self._has_matches(0)]
        self._add_key()

    def extend(self, clouds: Clouds, T_odom_base: Array | None) -> None:
        """Continue with a longer log: points of the key scans and of those to come, and odometry (n, 3) of
        all scans, if there is any."""
        self.clouds, self.odometry = clouds, T_odom_base

    def forget(self, scans: NDArray[np.bool_]) -> None:
        """Drop these scans (n,) and number the others anew; `extend` must follow, with the log likewise."""
        stays, number, n_keys = ~scans, np.cumsum(~scans) - 1, len(self.keys)
        self.keys = [int(number[key]) for key in self.keys if stays[key]]
        self._placed = [self._placed[k] for k in np.flatnonzero(stays).tolist()]
        self._matchable = [self._matchable[k] for k in np.flatnonzero(stays).tolist()]
        self.scan, self._field = int(number[self.scan]), None
        if len(self.keys) < n_keys:
            # the distance between successive key scans is no longer the distance driven
            self.config = self.config.model_copy(update={"calibration": False})

    def step(self, wait_s: float) -> None:
        """Place the next scan, taken this long after the last one [s]."""
        if self._lidars > 1:
            self.velocity = self._velocity(wait_s)
        before, self.scan = self.scan, self.scan + 1
        self._waits_s.append(wait_s)
        # no need to look closely at every wait: it is hardly ever ten of the shortest
        long = abs(wait_s) > GAP_PERIODS * min(self._waits_s)
        self.after_gap = long and abs(wait_s) > gap_s(np.array(self._waits_s))
        step = None if self.odometry is None else self.odometry_since(before)
        last_key, moved = self._last_key(), True
        if self._front_end is None or last_key is None:
            pose = compose(self.pose, self.velocity if step is None else step)
            # a lidar's first scan cannot differ from what was seen before
            placed = Placed(pose, np.zeros((3, 3)), float(self._front_end is not None))
        else:
            said = self._front_end.step(self.clouds.of(self.scan), step, wait_s)
            # The front end may continue with its own arrays.
            own = np.array(said.T_track_base, np.float64), np.array(said.information, np.float64)
            placed = replace(said, T_track_base=own[0], information=own[1])
            # their fit and information were those at the poses that they leave
            for scan, pose in placed.revised:
                if scan not in self.keys:
                    source = self._placed[scan].source
                    self._placed[scan] = replace(placed, T_track_base=pose, source=source, revised=())
            # the motion across a gap does not predict the next step
            self.velocity = np.zeros(3) if self.after_gap else between(self.pose, placed.T_track_base)
            (x, y, turn), config = between(self.pose_of(last_key), placed.T_track_base), self.config
            moved = bool(np.hypot(x, y) > config.key_distance_m or abs(turn) > config.key_turn_rad)
        self._placed.append(placed)
        self._matchable.append(self._has_matches(self.scan))
        if moved and placed.sure and self._matchable[-1]:
            self._add_key()

    @property
    def pose(self) -> Array:
        """Pose of the last scan (3,)."""
        return self.placed.T_track_base

    def last_keys(self, n: int = NEIGHBOURS) -> tuple[NDArray[np.int64], Array]:
        """The last n key scans, (k,), and their poses, (k, 3)."""
        keys = self.keys[-n:]
        return np.array(keys), np.array([self.pose_of(key) for key in keys])

    def field_keys(self) -> tuple[NDArray[np.int64], Array]:
        """The key scans of the field, as in `last_keys`."""
        return self.last_keys(FIELD_KEYS)

    def pose_of(self, scan: int) -> Array:
        """The current pose of a scan (3,)."""
        return self._placed[scan].T_track_base

    def odometry_since(self, before: int, scan: int | None = None) -> Array:
        """Motion (3,) from one scan to another (the current one) by the calibrated odometry."""
        assert self.odometry is not None
        now = self.scan if scan is None else scan
        return self.calibration.corrected(between(self.odometry[before], self.odometry[now]))

    def fit(self, points: Array, pose: Array) -> float:
        """How well points (n, 2) at a pose (3,) fit the last key scans, 0..1."""
        return best_pose(self.field, points, pose, 0.0, 0.0, 1.0)[1]

    @property
    def field(self) -> Field:
        """The last key scans as a field to search in."""
        if self._field is None:
            self._field = make_field(self.clouds, *self.field_keys(), FIELD_M)
        return self._field

    def track(self, first: int = 0) -> Track:
        """The resulting track; from a key scan `first` on, which becomes scan 0 and key scan 0."""
        begin, keys, T_odom = self.keys[first], self.keys[first:], self.odometry
        placed = self._placed[begin:]
        steps = None if T_odom is None else self.calibration.corrected(SE2(T_odom[keys]).steps())
        return Track(
            SE2(np.array([one.T_track_base for one in placed])),
            np.array(keys) - begin,
            np.array([one.overlap for one in placed]),
            np.array([one.rmse for one in placed]),
            np.array([one.information for one in placed]),
            np.array([one.source for one in placed], dtype=np.int8),
            steps,
            self.calibration,
            np.array(self._matchable[begin:]),
        )

    @property
    def placed(self) -> Placed:
        """The front end's result for the last scan."""
        return self._placed[-1]

    def calibrate(self) -> None:
        """Calibrate the odometry as far as the key scans allow."""
        if self.odometry is not None and self.config.calibration and len(self.keys) > 1:
            T_odom_keys = SE2(self.odometry[self.keys])
            keys, T_track_keys = self.last_keys(len(self.keys))
            self.calibration = calibrate(self.clouds, keys, SE2(T_track_keys), T_odom_keys)

    def _has_matches(self, scan: int) -> bool:
        """Whether others can be matched with a scan."""
        return self.clouds.placed_by(scan) != "nothing"

    def _velocity(self, wait_s: float) -> Array:
        """The motion to expect over this time: scans of several lidars do not come evenly."""
        waits_s = [*self._waits_s][-min(self._lidars, self.scan) :]
        limit_s = gap_s(np.array([*self._waits_s, wait_s]))
        known = sum(waits_s) > 0.0 and max(map(abs, [wait_s, *waits_s])) <= limit_s
        share = wait_s / sum(waits_s) if known else 0.0
        return share * between(self.pose_of(self.scan - len(waits_s)), self.pose)

    def _last_key(self) -> int | None:
        """The last key scan of the lidar that took the current scan."""
        of = self.clouds.sensor
        return next((key for key in reversed(self.keys) if of[key] == of[self.scan]), None)

    def _add_key(self) -> None:
        self.keys.append(self.scan)
        self._field = None
        if self._front_end is None and self._matchable[-1]:
            # a circle of two would keep the points of the whole log in memory long after it is tracked
            self._front_end = self._make(weakref.proxy(self))
        if len(self.keys) & (len(self.keys) - 1) == 0:  # again whenever their number has doubled
            self.calibrate()


Maker = Callable[[Tracker], FrontEnd]
"""Makes a front end for a tracker whose last scan is the first that others can be matched with."""


def track_log(
    scans: Scans, config: TrackingConfig, make: Maker, progress: Progress = no_progress, ahead: int = AHEAD
) -> Track:
    """Run a front end over a log, with the points of its key scans and of those `ahead` in memory."""
    n, end = len(scans), min(ahead, len(scans))
    tracker = Tracker(scans.of_keys(np.arange(end)).clouds, scans.recording, config, scans.usable_m, make)
    waits_s = seconds(np.diff(scans.recording.stamps_ns)).tolist()
    for step in progress(range(1, n), "matching scans", n - 1):
        if step == end:
            end = min(end + max(ahead, end // 4), n)
            needed = np.append(tracker.keys, np.arange(step, end))
            tracker.extend(scans.of_keys(needed).clouds, tracker.odometry)
        tracker.step(waits_s[step - 1])
    tracker.calibrate()
    return tracker.track()


def follow(
    scans: Scans, config: TrackingConfig, make: Maker, progress: Progress
) -> tuple[Scans, Track, Evidence]:
    """The scans with the motion during their sweeps, the front end's track, and the evidence for its steps.

    Where neither trusted odometry nor anything else gives the motion during a sweep, the scans do, once they
    are placed; then they are followed once more.
    """
    track, recording, motion = track_log(scans, config, make, progress), scans.recording, scans.motion
    evidence = evidence_of(recording, track, config.odometry)
    unknown = evidence.distrusted | (motion is None)
    if not sweeps(recording) or len(scans) < 2 or not unknown.any():
        return scans, track, evidence
    by_track = sweep_motion_by_track(recording, track.T_track_base)
    known = (by_track if motion is None else motion).xyt
    scans = replace(scans, motion=SE2(np.where(unknown[:, None, None], by_track.xyt, known)))
    track = track_log(scans, config, make, progress)
    return scans, track, evidence_of(recording, track, config.odometry)
