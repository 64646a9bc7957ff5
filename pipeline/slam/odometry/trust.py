"""Trust in odometry: whether scans, odometry, both or neither observed a motion."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.kernels import njit
from turtlebag.datasets.motion import FASTER, NEARLY_ALWAYS, fastest, way_and_turn
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.odometry.calibration import GROSS
from turtlebag.pipeline.slam.odometry.track import AGREE, AGREE_M, OdometryNoise, Track, blind, confirms
from turtlebag.pipeline.slam.scans.align import contradiction

# Scans contradict a step of the odometry when the two are this many standard deviations apart; this many of
# its last steps are taken together.
CONTRADICTION_SIGMAS, RECENT = 2.5, 5
# This many contradictions in a row are slipping wheels; one is a jump, or odometry that was delayed.
SEVERAL = 3


def agree(recording: Recording, track: Track, before: int, after: int, T_map_base: SE2) -> bool:
    """Whether the odometry agrees with the motion between two scans by their poses (n,)."""
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
    waits = seconds(np.diff(recording.stamps_ns))
    steps = _moved(T_map_base, np.arange(len(T_map_base) - 1), 1)
    seen = (waits > 0.0) & track.usable[1:] & track.usable[:-1]
    if not seen.any():
        return np.zeros(len(before), dtype=bool)
    # stamps jitter, so no step counts as shorter than usual
    least_s = np.median(waits[seen])
    reach = fastest(steps[seen], np.maximum(waits[seen], least_s))
    wait = seconds(recording.stamps_ns[after] - recording.stamps_ns[before])
    moved = _moved(T_map_base, before, after - before)
    allowed = reach * np.maximum(wait, least_s * (after - before))[:, None] + [AGREE_M, AGREE]
    return np.asarray((wait > 0.0) & (moved > allowed).any(axis=1))


def jumps(
    recording: Recording, track: Track, T_map_base: SE2, borders: NDArray[np.int64], over: int = 1
) -> NDArray[np.int64]:
    """Scans and those `over` scans later (n, 2) that lie farther apart than the robot can drive and than its
    odometry says, without one of the `borders`, the first scans of later logs, between them."""
    scans = np.arange(over, len(recording))
    pairs = np.column_stack([scans - over, scans])
    log = np.searchsorted(borders, pairs, "right")
    pairs = pairs[log[:, 0] == log[:, 1]]
    far = pairs[too_fast(recording, track, T_map_base, *pairs.T)].tolist()
    apart = [(a, b) for a, b in far if not agree(recording, track, a, b, T_map_base)]
    return np.array(apart, dtype=np.int64).reshape(-1, 2)


def _moved(T_map_base: SE2, before: NDArray[np.int64], later: NDArray[np.int64] | int) -> Array:
    """Distance [m] and turn [rad] between poses and later ones, (k, 2)."""
    return way_and_turn((T_map_base[before].inverse() @ T_map_base[before + later]).xyt)


class OdometryTrust:
    """Whether the odometry is trusted where the scans are blind.

    After several contradictions it is not, until it agrees with the scans again or, where these are blind,
    with a constant velocity.
    """

    def __init__(self, noise: OdometryNoise) -> None:
        self._noise, self._last = noise, np.zeros((RECENT + 1, 2, 3))
        self.forget()

    def forget(self) -> None:
        """Forget these scans."""
        self._held, self._contradictions = 0, 0

    @property
    def trusted(self) -> bool:
        """Whether its next step is trusted."""
        return self._contradictions < SEVERAL

    def judge(self, odometry_step: Array, T_map_base: Array, seen: Array) -> None:
        """Judge a step (3,) by the pose of the scan that ends it (3,) and that scan's information (3, 3).

        Contradicted is the distance ahead, over the recent steps together and in the last one too: a jump is
        over at once. Wheels that cover no distance, as in a turn on the spot, confirm nothing. A contradicted
        turn says little about the distance, because the odometry may be late.
        """
        step, noise = (
            JudgedStep(odometry_step, T_map_base, seen, True),
            (self._noise.floor, self._noise.share),
        )
        self._held, self._contradictions = _judged(self._last, self._held, self._contradictions, step, noise)


class JudgedStep(NamedTuple):
    """A step by odometry (3,), the pose by scans at its end (3,), and the information of that scan (3, 3).

    If the pose may come from the odometry itself (not `independent`), it confirms nothing.
    """

    step: Array
    pose: Array
    seen: Array
    independent: bool


@njit(cache=True, nogil=True)
def _judged(
    last: Array, held: int, contradictions: int, judged: JudgedStep, noise: tuple[float, float]
) -> tuple[int, int]:
    """`OdometryTrust.judge`: how many of `last` are held, and the contradictions so far.

    `last` (RECENT + 1, 2, 3) are poses by odometry and by the scans, the newest at its end; `noise` is the
    floor and share of `OdometryNoise`.
    """
    (step, pose, seen, independent), (floor, share) = judged, noise
    newest = _composed(last[-1, 0], step)
    for k in range(len(last) - 1):
        last[k] = last[k + 1]
    last[-1, 0], last[-1, 1] = newest, pose
    held = min(held + 1, len(last))
    if held < 2:
        return held, contradictions
    limit = CONTRADICTION_SIGMAS * CONTRADICTION_SIGMAS
    motion, error = _apart(last[-2], last[-1])
    improbable = (error[0] / _sigma(motion, floor, share)) ** 2 > limit
    moved = math.hypot(step[0], step[1]) > 2.0 * floor
    if independent and moved and not improbable:
        contradictions = 0
    motion, error = _apart(last[-held], last[-1])
    if improbable and abs(error[0]) > GROSS * max(abs(motion[0]), abs(motion[0] + error[0])):
        along = np.zeros((3, 3))
        along[0, 0] = _sigma(motion, floor, share) ** -2.0
        if contradiction(error, along, seen) > limit:
            return held, contradictions + 1
    return held, contradictions


@njit(cache=True, nogil=True)
def _composed(a: Array, b: Array) -> Array:
    """Pose `b` (3,), seen from pose `a` (3,), in the frame of `a`."""
    c, s = math.cos(a[2]), math.sin(a[2])
    return np.array([a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], a[2] + b[2]])


@njit(cache=True, nogil=True)
def _between(a: Array, b: Array) -> Array:
    """Pose `b` (3,) seen from pose `a` (3,)."""
    c, s = math.cos(a[2]), math.sin(a[2])
    dx, dy, turn = b[0] - a[0], b[1] - a[1], (b[2] - a[2] + math.pi) % (2.0 * math.pi) - math.pi
    return np.array([c * dx + s * dy, -s * dx + c * dy, turn])


@njit(cache=True, nogil=True)
def _apart(before: Array, now: Array) -> tuple[Array, Array]:
    """The motion by the odometry (3,), and the scans' as seen from where it ends (3,)."""
    motion = _between(before[0], now[0])
    return motion, _between(motion, _between(before[1], now[1]))


@njit(cache=True, nogil=True)
def _sigma(motion: Array, floor: float, share: float) -> float:
    """Standard deviation of the distance ahead, as in `OdometryNoise`."""
    return floor + share * math.hypot(motion[0], motion[1])


@njit(cache=True, nogil=True)
def _distrusted(
    steps: Array, poses: Array, seen: Array, independent: NDArray, new: NDArray, noise: tuple[float, float]
) -> NDArray:
    """Whether the odometry is distrusted after each of its steps (n, 3), which end at `poses` (n, 3); at
    `new` ones (n,) the earlier steps are forgotten."""
    distrusted = np.zeros(len(steps), dtype=np.bool_)
    last, held, contradictions = np.zeros((RECENT + 1, 2, 3)), 0, 0
    for k in range(len(steps)):
        if new[k]:
            held, contradictions = 0, 0
        step = JudgedStep(steps[k], poses[k], seen[k], independent[k])
        held, contradictions = _judged(last, held, contradictions, step, noise)
        distrusted[k] = contradictions >= SEVERAL
    return distrusted


def distrusted(
    recording: Recording, track: Track, noise: OdometryNoise, borders: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """At which scans (n,) the odometry is distrusted, before or after, or missing.

    `borders` are the first scans of later logs.
    """
    n, T_odom, poses = len(track.T_track_base), recording.T_odom_base, track.T_track_base.xyt
    observed = ~blind(track.information)
    if T_odom is None:
        return np.ones(n, dtype=bool)
    doubted = np.zeros(n, dtype=bool)
    for order in (np.arange(n), np.arange(n)[::-1]):
        steps, scans = track.calibration.corrected(T_odom[order].steps()), order[1:]
        new = np.isin(scans, borders if order[0] == 0 else borders - 1)
        seen = track.information[scans]
        doubted[scans] |= _distrusted(
            steps, poses[scans], seen, observed[scans], new, (noise.floor, noise.share)
        )
    return doubted


def _implausible(recording: Recording, track: Track, unobserved: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """At which `unobserved` scans (n,) the odometry says what no scan ever confirmed, (n,).

    It is faster than the robot ever drove by the scans; or it reverses at once, its speed changing by more
    than that, and then the whole unobserved stretch is implausible.
    """
    implausible, steps = np.zeros(len(unobserved), dtype=bool), track.T_track_base.steps()
    seen = ~unobserved[1:] & track.usable[1:] & track.usable[:-1]
    waits = seconds(np.diff(recording.stamps_ns))
    usual = np.median(np.abs(waits)) if seen.any() else 0.0
    if usual == 0.0:  # no step was seen, or most scans have the stamp of the one before: no speed is known
        return implausible
    waits = np.maximum(waits, usual)
    # over several steps: odometry that was delayed for a moment is fast in the next step
    moved = scipy.ndimage.uniform_filter1d([way_and_turn(steps)[:, 0], steps[:, 0], waits], RECENT, axis=1)
    speed, ahead = moved[:2] / moved[2]
    top = FASTER * np.quantile(speed[seen], NEARLY_ALWAYS)
    implausible[1:] = unobserved[1:] & (speed > top)
    reversals = RECENT // 2 + 1 + np.flatnonzero(np.abs(ahead[RECENT:] - ahead[:-RECENT]) > top)
    stretches, _ = scipy.ndimage.label(unobserved)
    return np.asarray(implausible | np.isin(stretches, stretches[reversals[unobserved[reversals]]]))


def unobserved_way(
    recording: Recording, track: Track, noise: OdometryNoise, borders: NDArray[np.int64]
) -> Array:
    """Unobserved metres of each step (n,), by track or odometry, whichever is longer; 0 elsewhere.

    Where scans are blind, the odometry observes the motion unless it is distrusted or implausible.
    """
    way = np.append(0.0, way_and_turn(track.T_track_base.steps())[:, 0])
    unobserved = blind(track.information)
    unknown = distrusted(recording, track, noise, borders) | _implausible(recording, track, unobserved)
    if recording.T_odom_base is not None:
        steps = track.calibration.corrected(recording.T_odom_base.steps())
        way[1:] = np.maximum(way[1:], way_and_turn(steps)[:, 0])
    return way * (unobserved & unknown)
