"""The 3D front end: every cloud is aligned with the earlier ones.

Starting from the odometry's prediction (constant velocity without odometry, both if they disagree), point to
plane against the surfels of the last key clouds, or KISS-ICP. A cloud that fits nothing keeps its prediction,
with a small overlap.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets import se3
from turtlebag.datasets.durations import seconds
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Recording3D
from turtlebag.pipeline.slam.odometry.kiss import LidarOdometry
from turtlebag.pipeline.slam3d.key_clouds import Keys, gathered, thinned
from turtlebag.pipeline.slam3d.sensor_setup import SensorSetup
from turtlebag.pipeline.slam3d.surfels import KERNEL_M, LEAST_OVERLAP, Fit, Seen, Surfels, fit, make_surfels
from turtlebag.pipeline.slam3d.sweeps import LEAST_POINTS, MAX_RANGE_M, Sweep

FrontEnd3d = Literal["surfels", "kiss_icp", "odometry"]
LONGEST_STEP_S = 1.0
"""Constant velocity is not believed for longer."""
KEY_VOXELS, KEY_TURN_RAD, WINDOW = 1.5, 0.35, 15
"""A key cloud is taken after this way or turn; the last ones make the local map."""
KISS_VOXELS = 1.5
"""KISS-ICP's voxel, where that is chosen, in voxels of the surfels."""
KEY_POINTS, FIT_POINTS = 5000, 2500
"""Points that are kept of a key cloud, and points of any cloud that are aligned."""
APART = 0.1
"""Predictions that differ by this [m, rad] are both tried."""
AT_ONCE = np.array([0.02, 0.02, 0.1, 0.3, 0.3, 0.03])
"""From the prediction: a ground vehicle hardly tilts or lifts between two clouds."""
IN_TIME = np.array([0.02, 0.02, 0.02, 0.03, 0.03, 0.03, 0.01, 0.01, 0.3, 0.15, 0.03, 0.01])
"""A sweep starts where the last one ended; in it a ground vehicle may turn and brake, hardly tilt."""


@dataclass(eq=False)
class Track3d:
    """What the front end made of a recording of n clouds, m of them keys.

    T (n, 4, 4) poses in the track's frame, which starts at the first odometry pose; `overlap` (n,) with
    the local map and `usable` (n,), whether the cloud held enough points; `twists` (n, 6) a second, as
    estimated; for the keys their clouds, the indices of those and the information (6, 6) of each against
    its predecessors. `T_odom` (n, 4, 4) where there is odometry.
    """

    T: Array
    overlap: Array
    usable: NDArray[np.bool_]
    twists: Array
    places: Keys
    keys: list[int] = field(default_factory=list)
    information: list[Array] = field(default_factory=list)
    T_odom: Array | None = None


class Tracker:
    """The state of the front end along a recording."""

    def __init__(self, recording: Recording3D, setup: SensorSetup, front_end: FrontEnd3d) -> None:
        n = len(recording)
        self._front_end, self._voxel = front_end, setup.voxel
        self._seconds = seconds(recording.stamps_ns - recording.stamps_ns[0])
        self._kiss = None
        if front_end == "kiss_icp":
            self._kiss = LidarOdometry(MAX_RANGE_M, KISS_VOXELS * setup.voxel)
        T_odom = None if recording.T_odom_base is None else se3.lifted(recording.T_odom_base)
        start = np.eye(4) if T_odom is None else T_odom[0]
        self.track = Track3d(
            np.tile(start, (n, 1, 1)),
            np.zeros(n),
            np.zeros(n, dtype=np.bool_),
            np.zeros((n, 6)),
            Keys(setup.T_base_lidar[:3, 3].copy()),
            T_odom=T_odom,
        )
        self._surfels: Surfels | None = None
        self._anchor: Array = start
        self._twist = np.zeros(6)

    def add(self, index: int, sweep: Sweep) -> None:
        """Track one more cloud."""
        track = self.track
        guesses = self._guesses(index)
        track.usable[index] = len(sweep.points) >= LEAST_POINTS
        if not track.usable[index]:
            track.T[index] = guesses[0]
            return
        found, guess = self._best(sweep, guesses)
        lost = found.overlap < LEAST_OVERLAP
        track.T[index] = guesses[0] if lost else found.T
        track.overlap[index] = found.overlap
        self._note_motion(index, None if lost else found.motion)
        points = sweep.deskewed(self._twist)
        if self._kiss is not None:
            self._kiss.update(points, track.T[index], guess)
        if self._is_key(index):
            self._new_key(index, points, np.zeros((6, 6)) if lost else found.information)

    def _best(self, sweep: Sweep, guesses: list[Array]) -> tuple[Fit, Array]:
        """The guess that leads to the better fit, and that fit; its motion is a twist a second."""
        if self._surfels is None or self._front_end == "odometry":
            return Fit(guesses[0], np.zeros((6, 6)), 1.0, 0.0), guesses[0]
        points = sweep.deskewed(self._twist)
        tried = [(self._registered(sweep, points, guess), guess) for guess in guesses]
        return max(tried, key=lambda one: one[0].overlap - 0.1 * one[0].rmse / KERNEL_M)

    def _guesses(self, index: int) -> list[Array]:
        """Predicted poses, the most trusted first."""
        if index == 0:
            return [self.track.T[0]]
        before = self.track.T[index - 1]
        dt = min(max(self._seconds[index] - self._seconds[index - 1], 0.0), LONGEST_STEP_S)
        steady = before @ se3.exp(self._twist * dt)
        T_odom = self.track.T_odom
        if T_odom is None:
            return [steady]
        driven = before @ se3.inverse(T_odom[index - 1]) @ T_odom[index]
        apart = np.abs(se3.log(se3.inverse(driven) @ steady))
        return [driven, steady] if apart.max() > APART else [driven]

    def _registered(self, sweep: Sweep, points: Array, guess: Array) -> Fit:
        if self._kiss is not None:
            T = self._kiss.register(points, guess)
            return replace(self._fit(self._seen(points), T), T=T)
        if sweep.span is not None:
            return self._fitted_in_time(sweep, sweep.span, guess)
        return self._fit(self._seen(points), guess, prior=AT_ONCE)

    def _seen(self, points: Array) -> Seen:
        return Seen(thinned(points, FIT_POINTS), self.track.places.origin)

    def _fit(self, seen: Seen, T: Array, **more: Any) -> Fit:
        assert self._surfels is not None
        found = fit(self._surfels, seen, se3.inverse(self._anchor) @ T, gate=self._voxel, **more)
        return replace(found, T=self._anchor @ found.T)

    def _fitted_in_time(self, sweep: Sweep, span: tuple[float, float], T: Array) -> Fit:
        """Pose and motion together: without odometry, how the robot turns within a sweep is not known."""
        start, end = span
        found = self._fit(
            self._seen(sweep.points)._replace(when=thinned(sweep.when(), FIT_POINTS)),
            T @ se3.exp(start * self._twist),
            motion=(end - start) * self._twist,
            prior=IN_TIME,
            iterations=20,
        )
        assert found.motion is not None
        twist = found.motion / (end - start)
        return replace(found, T=found.T @ se3.exp(-start * twist), motion=twist)

    def _note_motion(self, index: int, twist: Array | None) -> None:
        dt = self._seconds[index] - self._seconds[index - 1] if index else 0.0
        if twist is not None:
            self._twist = twist
        elif 0.0 < dt <= LONGEST_STEP_S:
            self._twist = se3.log(se3.inverse(self.track.T[index - 1]) @ self.track.T[index]) / dt
        self.track.twists[index] = self._twist

    def _is_key(self, index: int) -> bool:
        if not self.track.keys:
            return True
        since = se3.log(se3.inverse(self.track.T[self.track.keys[-1]]) @ self.track.T[index])
        return bool(
            np.linalg.norm(since[3:]) > KEY_VOXELS * self._voxel or np.linalg.norm(since[:3]) > KEY_TURN_RAD
        )

    def _new_key(self, index: int, points: Array, information: Array) -> None:
        track = self.track
        track.keys.append(index)
        track.places.clouds.append(thinned(points, KEY_POINTS).astype(np.float32))
        track.information.append(information)
        window = range(max(0, len(track.keys) - WINDOW), len(track.keys))
        self._anchor = track.T[index]
        self._surfels = make_surfels(
            *gathered(track.places, track.T[track.keys], len(track.keys) - 1, window), self._voxel
        )
