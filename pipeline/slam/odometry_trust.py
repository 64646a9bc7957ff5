"""Trust in odometry: whether scans, odometry, both or neither observed a motion."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.align import contradiction
from turtlebag.pipeline.slam.calibration import GROSS
from turtlebag.pipeline.slam.clouds import FASTER, NEARLY_ALWAYS, fastest, way_and_turn
from turtlebag.pipeline.slam.track import AGREE, AGREE_M, OdometryNoise, Track, blind, confirms

# A step of the odometry is a lie when scan and odometry are this many standard deviations apart; so many of
# its last steps are taken together.
LIE_SIGMAS, RECENT = 2.5, 5
# So many lies in a row are wheels that slip; one is a jump, or odometry held back for a moment.
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
    # stamps jitter: no step counts as shorter than usual
    least_s = np.median(waits[seen])
    reach = fastest(steps[seen], np.maximum(waits[seen], least_s))
    wait = seconds(recording.stamps_ns[after] - recording.stamps_ns[before])
    moved = _moved(T_map_base, before, after - before)
    allowed = reach * np.maximum(wait, least_s * (after - before))[:, None] + [AGREE_M, AGREE]
    return np.asarray((wait > 0.0) & (moved > allowed).any(axis=1))


def jumps(
    recording: Recording, track: Track, T_map_base: SE2, borders: NDArray[np.int64], over: int = 1
) -> NDArray[np.int64]:
    """Scans and those `over` scans later (n, 2) whose poses lie farther apart than the robot can drive, and
    than its odometry says; no `borders`, the first scans of later logs, between them."""
    scans = np.arange(over, len(recording))
    pairs = np.column_stack([scans - over, scans])
    log = np.searchsorted(borders, pairs, "right")
    pairs = pairs[log[:, 0] == log[:, 1]]
    far = pairs[too_fast(recording, track, T_map_base, *pairs.T)].tolist()
    apart = [(a, b) for a, b in far if not agree(recording, track, a, b, T_map_base)]
    return np.array(apart, dtype=np.int64).reshape(-1, 2)


def _moved(T_map_base: SE2, before: NDArray[np.int64], later: NDArray[np.int64] | int) -> Array:
    """Way [m] and turn [rad] between poses and later ones, (k, 2)."""
    return way_and_turn((T_map_base[before].inverse() @ T_map_base[before + later]).xyt)


class OdometryTrust:
    """Whether the odometry is trusted where the scans are blind.

    Not once it was caught lying several times, until it says the same as the scans again, or, where these are
    blind, the same as a steady motion.
    """

    def __init__(self, noise: OdometryNoise) -> None:
        self._noise, self._last = noise, np.zeros((RECENT + 1, 2, 3))
        self.forget()

    def forget(self) -> None:
        """Forget these scans."""
        self._held, self._lies = 0, 0

    @property
    def believed(self) -> bool:
        """Whether its next step is trusted."""
        return self._lies < SEVERAL

    def judge(self, odometry_step: Array, T_map_base: Array, seen: Array) -> None:
        """A step (3,), the pose of the scan that ends it (3,), and what that scan saw (3, 3).

        A lie, about the way ahead, is one of the last steps together, and of the last of them: a jump is over
        at once. Wheels that drive no way, as in a turn on the spot, confirm nothing. A turn that scans
        contradict says little of the way: it may be told late.
        """
        told, noise = Told(odometry_step, T_map_base, seen, True), (self._noise.floor, self._noise.share)
        self._held, self._lies = _judged(self._last, self._held, self._lies, told, noise)


class Told(NamedTuple):
    """A step by odometry (3,), the pose that ends it by the scans (3,), and what the scan there saw (3, 3).

    Odometry that the pose may have been taken from (not `independent`) confirms nothing.
    """

    step: Array
    pose: Array
    seen: Array
    independent: bool


@njit(cache=True, nogil=True)
def _judged(last: Array, held: int, lies: int, told_now: Told, noise: tuple[float, float]) -> tuple[int, int]:
    """`OdometryTrust.judge`: how many of `last` are held, and lies so far.

    `last` (RECENT + 1, 2, 3) are poses by odometry and by the scans, the newest at its end; `noise` is the
    floor and share of `OdometryNoise`.
    """
    (step, pose, seen, independent), (floor, share) = told_now, noise
    newest = _composed(last[-1, 0], step)
    for k in range(len(last) - 1):
        last[k] = last[k + 1]
    last[-1, 0], last[-1, 1] = newest, pose
    held = min(held + 1, len(last))
    if held < 2:
        return held, lies
    limit = LIE_SIGMAS * LIE_SIGMAS
    told, error = _apart(last[-2], last[-1])
    surprising = (error[0] / _sigma(told, floor, share)) ** 2 > limit
    moved = math.hypot(step[0], step[1]) > 2.0 * floor
    if independent and moved and not surprising:
        lies = 0
    told, error = _apart(last[-held], last[-1])
    if surprising and abs(error[0]) > GROSS * max(abs(told[0]), abs(told[0] + error[0])):
        along = np.zeros((3, 3))
        along[0, 0] = _sigma(told, floor, share) ** -2.0
        if contradiction(error, along, seen) > limit:
            return held, lies + 1
    return held, lies


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
    told = _between(before[0], now[0])
    return told, _between(told, _between(before[1], now[1]))


@njit(cache=True, nogil=True)
def _sigma(motion: Array, floor: float, share: float) -> float:
    """That of the way ahead, as in `OdometryNoise`."""
    return floor + share * math.hypot(motion[0], motion[1])


@njit(cache=True, nogil=True)
def _caught(
    steps: Array, poses: Array, seen: Array, independent: NDArray, new: NDArray, noise: tuple[float, float]
) -> NDArray:
    """Whether the odometry is not believed after each of its steps (n, 3), which end at `poses` (n, 3); at
    those that are `new` (n,) nothing is known of what was before."""
    caught = np.zeros(len(steps), dtype=np.bool_)
    last, held, lies = np.zeros((RECENT + 1, 2, 3)), 0, 0
    for k in range(len(steps)):
        if new[k]:
            held, lies = 0, 0
        held, lies = _judged(last, held, lies, Told(steps[k], poses[k], seen[k], independent[k]), noise)
        caught[k] = lies >= SEVERAL
    return caught


def disbelieved(
    recording: Recording, track: Track, noise: OdometryNoise, borders: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """At which scans (n,) the odometry is untrusted, before or after, or missing.

    `borders` are the first scans of later logs.
    """
    n, T_odom, poses = len(track.T_track_base), recording.T_odom_base, track.T_track_base.xyt
    unseen = blind(track.information)
    if T_odom is None:
        return np.ones(n, dtype=bool)
    doubted = np.zeros(n, dtype=bool)
    for order in (np.arange(n), np.arange(n)[::-1]):
        steps, scans = track.calibration.corrected(T_odom[order].steps()), order[1:]
        new = np.isin(scans, borders if order[0] == 0 else borders - 1)
        seen = track.information[scans]
        doubted[scans] |= _caught(steps, poses[scans], seen, ~unseen[scans], new, (noise.floor, noise.share))
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
    waits = seconds(np.diff(recording.stamps_ns))
    waits = np.maximum(waits, np.median(np.abs(waits)))
    # of several steps together: odometry held back for a moment is fast in the next
    moved = scipy.ndimage.uniform_filter1d([way_and_turn(steps)[:, 0], steps[:, 0], waits], RECENT, axis=1)
    speed, ahead = moved[:2] / moved[2]
    top = FASTER * np.quantile(speed[seen], NEARLY_ALWAYS)
    unlikely[1:] = unseen[1:] & (speed > top)
    turned = RECENT // 2 + 1 + np.flatnonzero(np.abs(ahead[RECENT:] - ahead[:-RECENT]) > top)
    dark, _ = scipy.ndimage.label(unseen)
    return np.asarray(unlikely | np.isin(dark, dark[turned[unseen[turned]]]))


def unseen_way(recording: Recording, track: Track, noise: OdometryNoise, borders: NDArray[np.int64]) -> Array:
    """Unobserved metres of each step (n,), by track or odometry, whichever is longer; 0 elsewhere.

    Where scans are blind the odometry saw it, unless it is not believed there, or says what is unlikely.
    """
    way = np.append(0.0, way_and_turn(track.T_track_base.steps())[:, 0])
    unseen = blind(track.information)
    alone = disbelieved(recording, track, noise, borders) | _unlikely(recording, track, unseen)
    if recording.T_odom_base is not None:
        told = track.calibration.corrected(recording.T_odom_base.steps())
        way[1:] = np.maximum(way[1:], way_and_turn(told)[:, 0])
    return way * (unseen & alone)
