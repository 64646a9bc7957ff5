"""Wheel slip in turns, detected and corrected by the gyro.

If the gyro is credible - it turns with the odometry most of the time - each turn of the odometry that
clearly differs from it is a slip, and is replaced by the gyro's turn. All other turns stay the wheels':
over a whole drive a gyro's bias drifts more than good wheels do (house: 4.3 mm become 5.8 mm).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.motion import without_gap
from turtlebag.datasets.robust import cauchy_weight, sigma_by_median
from turtlebag.datasets.se2 import SE2, Array, wrap
from turtlebag.datasets.types import ImuLog, Recording, Trajectory
from turtlebag.pipeline.slam.odometry.calibration import ODOMETRY_SHARE, gross

# Over turns that are smaller than this in all [rad], the two are not compared.
TURNING_RAD = 0.8
# Standard deviations of a gyro's bias [rad/s] and of the difference between a turn by gyro and by wheels
# [rad], to which ODOMETRY_SHARE of the turn and per metre is added.
BIAS, NOISE_RAD = 0.01, 0.01
USUAL = np.array([BIAS, ODOMETRY_SHARE, ODOMETRY_SHARE])
# The errors of a credible gyro are at most this many of these.
LIKELY_SIGMAS = 3.0
# The wheels slip in a turn that is this many standard deviations (by the median) off the gyro's, and by this
# share of it.
SLIP_SIGMAS = 6.0
# Share of a scan period by which the stamps of gyro and wheels may differ.
LATE_SHARE = 0.25


def with_gyro(recording: Recording) -> Recording:
    """The recording with the turns in which its wheels slipped replaced by the gyro's; unchanged if there is
    no gyro, no odometry or no slip, or if the two do not turn together."""
    if recording.imu is None or recording.T_odom_base is None or len(recording) < 2:
        return recording
    gyro, stamps = GyroTurns(recording.imu), recording.stamps_ns
    steps = recording.T_odom_base.steps()
    trusted = _trusted(gyro, steps, stamps)
    if trusted is None:
        return recording
    expected, known = _expected(gyro, steps, stamps, *trusted)
    left = np.abs(wrap(steps[:, 2] - expected))
    least = max(SLIP_SIGMAS * float(sigma_by_median(left[known])), NOISE_RAD)
    # stamps of gyro and wheels are never quite the same, so they differ where turning starts or ends
    change = np.abs(np.diff(expected, prepend=expected[:1], append=expected[-1:]))
    late = LATE_SHARE * np.maximum(change[:-1], change[1:])
    slips = known & (left > least + ODOMETRY_SHARE * np.abs(expected) + late)
    if not slips.any():
        return recording
    T = with_turns(recording.T_odom_base, steps, np.where(slips, expected, steps[:, 2]))
    stream = recording.odometry
    if stream is not None and len(stream) > 1:
        steps = stream.poses.steps()
        expected, known = _expected(gyro, steps, stream.stamps_ns, *trusted)
        within = np.clip(np.searchsorted(stamps, stream.stamps_ns[:-1], side="right") - 1, 0, len(slips) - 1)
        turns = np.where(known & slips[within], expected, steps[:, 2])
        stream = Trajectory(stream.stamps_ns, with_turns(stream.poses, steps, turns))
    return replace(recording, T_odom_base=T, odometry=stream)


def turns_with(recording: Recording) -> bool:
    """Whether a gyro, with its recorded mounting, turns with the odometry."""
    if recording.imu is None or recording.T_odom_base is None or len(recording) < 2:
        return False
    trusted = _trusted(GyroTurns(recording.imu), recording.T_odom_base.steps(), recording.stamps_ns)
    return trusted is not None and trusted[0] > 0.0


def _trusted(gyro: GyroTurns, steps: Array, stamps_ns: NDArray[np.int64]) -> tuple[float, Array] | None:
    """Sign of the gyro (-1: mounted upside down), and bias [rad/s], share of turn and turn per metre between
    it and the odometry; None when the two do not turn together."""
    turns, known = gyro.turns(stamps_ns)
    waits = seconds(np.diff(stamps_ns))
    for sign in (1.0, -1.0):
        found = gyro_errors(sign * turns[known], steps[known], waits[known])
        expected, _ = _expected(gyro, steps, stamps_ns, sign, found)
        likely = bool(np.all(np.abs(found) < LIKELY_SIGMAS * USUAL))
        if likely and _agrees(expected[known], steps[known, 2]):
            return sign, found
    return None


def _expected(
    gyro: GyroTurns, steps: Array, stamps_ns: NDArray[np.int64], sign: float, found: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """The turns (n,) that wheels without slip would report, by the gyro, and where the gyro is available."""
    turns, known = gyro.turns(stamps_ns)
    return sign * turns - error_parts(sign * turns, steps, seconds(np.diff(stamps_ns))) @ found, known


class GyroTurns:
    """Yaw by the gyro's z axis."""

    def __init__(self, imu: ImuLog) -> None:
        rate = imu.angular_velocity[:, 2]
        good = np.isfinite(rate)
        stamps, first = np.unique(imu.stamps_ns[good], return_index=True)
        self._stamps = stamps
        rate = rate[good][first]
        waits = seconds(np.diff(stamps))
        self._yaw = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * waits)])[: len(stamps)]
        self._holes = np.concatenate([[0], np.cumsum(~without_gap(waits))])[: len(stamps)]

    def turns(self, stamps_ns: NDArray[np.int64]) -> tuple[Array, NDArray[np.bool_]]:
        """Turn between successive stamps (n - 1,), and whether the gyro was available throughout."""
        n = len(stamps_ns)
        if len(self._stamps) < 2:
            return np.zeros(n - 1), np.zeros(n - 1, dtype=bool)
        at = np.searchsorted(self._stamps, stamps_ns, side="right")
        inside = (at > 0) & (stamps_ns <= self._stamps[-1])
        hi = np.clip(at, 1, len(self._stamps) - 1)
        span = self._stamps[hi] - self._stamps[hi - 1]
        f = np.clip((stamps_ns - self._stamps[hi - 1]) / span, 0.0, 1.0)
        yaw = self._yaw[hi - 1] + f * (self._yaw[hi] - self._yaw[hi - 1])
        whole = (self._holes[hi[1:]] == self._holes[hi[:-1] - 1]) & (np.diff(stamps_ns) > 0)
        return np.diff(yaw), whole & inside[1:] & inside[:-1]


def error_parts(turns: Array, steps: Array, waits: Array) -> Array:
    """What the errors of `gyro_errors` act on, (n, 3): time [s], turn [rad] and way [m] of each step."""
    # the gyro's turns, because those of slipping wheels would bias the fit
    return np.column_stack([waits, turns, np.hypot(steps[:, 0], steps[:, 1])])


def gyro_errors(turns: Array, steps: Array, waits: Array) -> Array:
    """Bias, share of turn and turn per metre (3,) between gyro and odometry, robustly."""
    rows, error = error_parts(turns, steps, waits), wrap(turns - steps[:, 2])
    found: Array = np.zeros(3, dtype=np.float64)
    for _ in range(10):
        left = error - rows @ found
        weight = cauchy_weight((left / NOISE_RAD) ** 2) / NOISE_RAD**2
        normal = rows.T @ (weight[:, None] * rows) + np.diag(USUAL**-2)
        found = np.asarray(np.linalg.solve(normal, rows.T @ (weight * error)), dtype=np.float64)
    return found


def _agrees(turns: Array, odometry: Array) -> bool:
    """Whether the odometry takes part in the gyro's turns; slipping wheels turn alone."""
    turned = np.abs(turns)
    missed = np.minimum(np.abs(turns - odometry), turned)
    return bool(turned.sum() > TURNING_RAD and not gross(missed.sum(), turned.sum()))


def with_turns(T_odom_base: SE2, steps: Array, turns: Array) -> SE2:
    """Odometry poses (n,) with other turns (n - 1,), each step driven along an arc of the same length."""
    distance = np.hypot(steps[:, 0], steps[:, 1])
    bearing = np.arctan2(steps[:, 1], steps[:, 0]) + 0.5 * (turns - steps[:, 2])
    yaw = T_odom_base.yaw[0] + np.concatenate([[0.0], np.cumsum(turns)])
    move = distance[:, None] * np.stack([np.cos(yaw[:-1] + bearing), np.sin(yaw[:-1] + bearing)], axis=1)
    xy = T_odom_base.xy[0] + np.concatenate([np.zeros((1, 2)), np.cumsum(move, axis=0)])
    return SE2.from_array(np.column_stack([xy, yaw]))
