"""The IMU's noise and biases, and the steps of the encoders."""

from __future__ import annotations

import numpy as np

from turtlebag.datasets.robust import sigma_by_median
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import ImuLog, Recording
from turtlebag.pipeline.identify.estimates import PARTS, Estimate, Findings, Plot, unknown
from turtlebag.pipeline.identify.wheels import still
from turtlebag.sim.robots import ImuMount

NOISE_EQUATION = "sigma = |w(k-1) - 2 w(k) + w(k+1)| by the median, over sqrt(6)"
STILL_EQUATION = "mean of the readings while the odometry stands still"
ENOUGH = 200
# Share by which motion may raise the noise.
MOTION = 0.02


def imu_findings(recording: Recording, base: ImuMount) -> Findings:
    """White noise of gyro [rad/s] and accelerometer [m/s^2], and the accelerometer's bias."""
    found, imu = Findings(), recording.imu
    noises = (
        ("gyro_noise", "rad/s", base.gyro_noise),
        ("accelerometer_noise", "m/s^2", base.accelerometer_noise),
    )
    if imu is None or len(imu.stamps_ns) < ENOUGH:
        why = "no IMU" if imu is None else "too few samples of the IMU"
        found.estimates += [unknown(name, value, unit, NOISE_EQUATION, why) for name, unit, value in noises]
        found.estimates.append(
            unknown("accelerometer_bias", base.accelerometer_bias, "m/s^2", STILL_EQUATION, why)
        )
        return found
    for (name, unit, usual), values in zip(
        noises, (imu.angular_velocity, imu.linear_acceleration), strict=True
    ):
        found.estimates.append(_noise(name, unit, usual, values))
    found.estimates.append(_bias(recording, imu, base))
    some = slice(None, None, max(1, len(imu.stamps_ns) // 1500))
    times = (imu.stamps_ns - imu.stamps_ns[0]) * 1e-9
    found.plots["imu"] = Plot(
        "Gyro", "Turning rate about the vertical axis.", "time [s]", "rate [rad/s]",
        {}, {"gyro": (times[some], imu.angular_velocity[some, 2])},
    )  # fmt: skip
    return found


def _noise(name: str, unit: str, usual: float, values: Array) -> Estimate:
    """By second differences, which slow motion does not show in, of each axis in each part of the log."""
    e = (values[:-2] - 2.0 * values[1:-1] + values[2:]) / np.sqrt(6.0)
    parts = [part for part in np.array_split(e, 4 * PARTS) if len(part) > 10]
    of_parts = np.array([[float(sigma_by_median(axis)) for axis in part.T] for part in parts])
    alive = np.median(of_parts, axis=0) > 0.0
    if not alive.any():
        return unknown(name, usual, unit, NOISE_EQUATION, "its readings do not vary")
    # parts in which it starts, stops and turns have more of it: the usual one has not
    each = np.sqrt((of_parts[:, alive] ** 2).mean(axis=1))
    value = float(np.median(each))
    sigma = 1.25 * float(sigma_by_median(each - value)) / np.sqrt(len(each))
    sigma = float(np.hypot(sigma, MOTION * value))
    return Estimate(name, value, sigma, unit, NOISE_EQUATION, "", len(each) - 1, True, "imu")


def _bias(recording: Recording, imu: ImuLog, base: ImuMount) -> Estimate:
    spans = still(recording)
    rows = [(imu.stamps_ns >= a) & (imu.stamps_ns < b) for a, b in spans]
    means = np.array([imu.linear_acceleration[row][:, :2].mean(axis=0) for row in rows if row.sum() > 20])
    if not len(means):
        return unknown(
            "accelerometer_bias", base.accelerometer_bias, "m/s^2", STILL_EQUATION, "it never stood still"
        )
    size = float(np.hypot(*means.mean(axis=0))) / np.sqrt(2.0)
    # two axes tell a standard deviation of biases to within half of it
    return Estimate("accelerometer_bias", size, 0.5 * size, "m/s^2", STILL_EQUATION, "", np.inf, True, "imu")


def encoder_findings(positions: Array | None, base_ticks: int) -> Findings:
    """Ticks a turn of the wheels' encoders, by the joint angles (n, wheels) [rad]."""
    equation = "all angles are whole multiples of 2 pi / ticks"
    why, ticks = "no /joint_states", base_ticks
    if positions is not None and len(positions) > ENOUGH:
        steps = np.abs(np.diff(positions, axis=0)).ravel()
        steps = steps[steps > 1e-9]
        why = "the joint angles have no visible step"
        if len(steps) > ENOUGH:
            step = float(steps.min())
            whole = np.abs(steps / step - np.round(steps / step)) * step
            if step > 1e-5 and np.quantile(whole, 0.98) < 1e-3 * step + 1e-9:
                why, ticks = "", round(2.0 * np.pi / step)
    estimate = unknown("encoder_ticks", float(ticks), "1", equation, why)
    return Findings([estimate if why else Estimate("encoder_ticks", float(ticks), 0.0, "1", equation)])
