"""Who saw a motion: the scans, the odometry, both, or neither."""

from __future__ import annotations

from collections import deque

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2, Array, between, compose
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.align import contradiction
from turtlebag.pipeline.slam.calibration import GROSS
from turtlebag.pipeline.slam.clouds import FASTER, NEARLY_ALWAYS, fastest, way_and_turn
from turtlebag.pipeline.slam.track import AGREE, AGREE_M, OdometryNoise, Track, blind, confirms

# A step of the odometry is a lie when scan and odometry are this many standard deviations apart; so many of
# its last steps are taken together.
LIE_SIGMAS, RECENT = 2.5, 5
# Wheels are asked for the way ahead and the turn: they do not see that the robot slides sideways.
ASKED = np.array([True, False, True])
# So many lies in a row are wheels that slip; one is a jump, or odometry held back for a moment.
SEVERAL = 3


def agree(recording: Recording, track: Track, before: int, after: int, T_map_base: SE2) -> bool:
    """Whether the odometry says of the motion between two scans what their poses (n,) say."""
    if recording.T_odom_base is None:
        return False
    T_odom = recording.T_odom_base
    odometry = track.calibration.corrected((T_odom[before].inverse() @ T_odom[after]).xyt)
    return confirms(odometry, (T_map_base[before].inverse() @ T_map_base[after]).xyt)


def too_fast(
    recording: Recording, track: Track, T_map_base: SE2, before: NDArray[np.int64], after: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Whether the poses (n,) move faster between scans (k,) and later ones (k,) than the robot ever drives or
    turns, (k,)."""
    waits, steps = np.diff(recording.stamps_ns) * 1e-9, _moved(T_map_base, np.arange(len(T_map_base) - 1), 1)
    seen = (waits > 0.0) & track.usable[1:] & track.usable[:-1]
    if not seen.any():
        return np.zeros(len(before), dtype=bool)
    # stamps jitter: no step counts as shorter than usual
    least_s = np.median(waits[seen])
    reach = fastest(steps[seen], np.maximum(waits[seen], least_s))
    wait = (recording.stamps_ns[after] - recording.stamps_ns[before]) * 1e-9
    moved = _moved(T_map_base, before, after - before)
    allowed = reach * np.maximum(wait, least_s * (after - before))[:, None] + [AGREE_M, AGREE]
    return np.asarray((wait > 0.0) & (moved > allowed).any(axis=1))


def jumps(
    recording: Recording, track: Track, T_map_base: SE2, borders: NDArray[np.int64], over: int = 1
) -> NDArray[np.int64]:
    """Scans whose poses lie farther from those `over` scans before than the robot can drive, and than its
    odometry says; no `borders`, the first scans of later logs, between them."""
    scans = np.arange(over, len(recording))
    scans = scans[np.searchsorted(borders, scans - over, "right") == np.searchsorted(borders, scans, "right")]
    far = scans[too_fast(recording, track, T_map_base, scans - over, scans)]
    apart = [k for k in far.tolist() if not agree(recording, track, k - over, k, T_map_base)]
    return np.array(apart, dtype=np.int64)


def _moved(T_map_base: SE2, before: NDArray[np.int64], later: NDArray[np.int64] | int) -> Array:
    """Way [m] and turn [rad] between poses and later ones, (k, 2)."""
    return way_and_turn((T_map_base[before].inverse() @ T_map_base[before + later]).xyt)


class OdometryTrust:
    """Whether the odometry is believed where the scans are blind.

    Not once it was caught lying several times, until it says the same as the scans again, or, where these are
    blind, the same as a steady motion.
    """

    def __init__(self, noise: OdometryNoise) -> None:
        self._noise = noise
        self._odometry = np.zeros(3)
        self.forget()

    def forget(self) -> None:
        """Nothing is known of them any more."""
        self._lies, self._last = 0, deque[tuple[Array, Array]](maxlen=RECENT + 1)

    @property
    def believed(self) -> bool:
        """Whether its next step is believed."""
        return self._lies < SEVERAL

    def judge(
        self, odometry_step: Array, T_map_base: Array, seen: Array, *, independent: bool = True
    ) -> None:
        """A step (3,), the pose of the scan that ends it (3,), and what that scan saw (3, 3).

        A lie, about the way ahead or the turn, is one of the last steps together, and of the last of them: a
        jump is over at once. Wheels at rest confirm nothing, nor do those that the pose may have been taken
        from (not `independent`).
        """
        self._odometry = compose(self._odometry, odometry_step)
        self._last.append((self._odometry, T_map_base))
        if len(self._last) < 2:
            return
        told, error = self._apart(-2)
        surprising = ASKED & (error**2 * self._noise.information(told).diagonal() > LIE_SIGMAS**2)
        if independent and not surprising.any() and moves(odometry_step, self._noise):
            self._lies = 0
        told, error = self._apart(0)
        gross = np.abs(error) > GROSS * np.maximum(np.abs(told), np.abs(told + error))
        # each by itself: scans that are blind along the way see the turn
        alone = [np.diag(part) for part in np.diag(self._noise.information(told).diagonal())]
        self._lies += any(
            contradiction(error, alone[k], seen) > LIE_SIGMAS**2 for k in np.flatnonzero(surprising & gross)
        )

    def _apart(self, since: int) -> tuple[Array, Array]:
        """The motion since an earlier scan by the odometry, and the scans' as seen from where it ends."""
        (odometry, pose), (odometry_now, pose_now) = self._last[since], self._last[-1]
        told = between(odometry, odometry_now)
        return told, between(told, between(pose, pose_now))


def disbelieved(
    recording: Recording, track: Track, noise: OdometryNoise, borders: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Whether the odometry was not to be believed at scans (n,), before or after, or there is none.

    `borders` are the first scans of later logs.
    """
    n, T_odom, poses = len(track.T_track_base), recording.T_odom_base, track.T_track_base.xyt
    unseen = blind(track.information)
    if T_odom is None:
        return np.ones(n, dtype=bool)
    doubted = np.zeros(n, dtype=bool)
    for order in (np.arange(n), np.arange(n)[::-1]):
        T = T_odom[order]
        steps = track.calibration.corrected(T.steps())
        wheels = OdometryTrust(noise)
        new = np.isin(order[1:], borders if order[0] == 0 else borders - 1)
        for scan, step, forget in zip(order[1:].tolist(), steps, new, strict=True):
            if forget:
                wheels.forget()
            wheels.judge(step, poses[scan], track.information[scan], independent=not unseen[scan])
            doubted[scan] |= not wheels.believed
    return doubted


def _unlikely(recording: Recording, track: Track, unseen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether the odometry says of scans that see nothing (n,) what no scan ever confirmed, (n,).

    That the robot drove faster than scans ever saw it drive; or anything of a way in the dark on which it
    turned round at once, its speed changed by more than the fastest they saw.
    """
    unlikely, steps = np.zeros(len(unseen), dtype=bool), track.T_track_base.steps()
    seen = ~unseen[1:] & track.usable[1:] & track.usable[:-1]
    if not seen.any():
        return unlikely
    waits = np.diff(recording.stamps_ns) * 1e-9
    waits = np.maximum(waits, np.median(np.abs(waits)))
    # of several steps together: odometry held back for a moment is fast in the next
    moved = scipy.ndimage.uniform_filter1d([way_and_turn(steps)[:, 0], steps[:, 0], waits], RECENT, axis=1)
    speed, ahead = moved[:2] / moved[2]
    top = FASTER * np.quantile(speed[seen], NEARLY_ALWAYS)
    unlikely[1:] = unseen[1:] & (speed > top)
    turned = RECENT // 2 + 1 + np.flatnonzero(np.abs(ahead[RECENT:] - ahead[:-RECENT]) > top)
    dark, _ = scipy.ndimage.label(unseen)
    return np.asarray(unlikely | np.isin(dark, dark[turned[unseen[turned]]]))


def unwitnessed(
    recording: Recording, track: Track, noise: OdometryNoise, borders: NDArray[np.int64]
) -> Array:
    """Metres of each step (n,) that nobody saw, by track or odometry, whichever says more; 0 elsewhere.

    Where scans are blind the odometry saw it, unless it is not believed there, or says what is unlikely.
    """
    way = np.append(0.0, way_and_turn(track.T_track_base.steps())[:, 0])
    unseen = blind(track.information)
    alone = disbelieved(recording, track, noise, borders) | _unlikely(recording, track, unseen)
    if recording.T_odom_base is not None:
        told = track.calibration.corrected(recording.T_odom_base.steps())
        way[1:] = np.maximum(way[1:], way_and_turn(told)[:, 0])
    return way * (unseen & alone)


def moves(odometry_step: Array, noise: OdometryNoise) -> bool:
    """Whether an odometry step (3,) stands out of its noise."""
    way, turn = np.hypot(odometry_step[0], odometry_step[1]), abs(odometry_step[2])
    return bool(max(way, turn) > 2.0 * noise.floor)
