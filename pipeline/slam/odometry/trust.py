"""Trust in the wheels, step by step: scans that contradict them several times end it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.slam.odometry.calibration import GROSS
from turtlebag.pipeline.slam.odometry.track import OdometryNoise
from turtlebag.pipeline.slam.scans.align import contradiction

# Scans contradict a step of the odometry when the two are this many standard deviations apart; this many of
# its last steps are taken together.
CONTRADICTION_SIGMAS, RECENT = 2.5, 5
# This many contradictions in a row are slipping wheels; one is a jump, or odometry that was delayed.
SEVERAL = 3


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
def distrusted_steps(
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
