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
# Parts of a log whose noise is compared, and the differences of readings that each has at least.
NOISE_PARTS, LEAST_OF_PART = 4 * PARTS, 11
# Share by which motion may raise the noise.
MOTION = {"gyro_noise": 0.01, "accelerometer_noise": 0.0175}


def imu_findings(recording: Recording, base: ImuMount) -> Findings:
    """White noise of gyro [rad/s] and accelerometer [m/s^2], and the accelerometer's bias."""
    found, imu = Findings(), recording.imu
    noises = (
        ("gyro_noise", "rad/s", base.gyro_noise),
        ("accelerometer_noise", "m/s^2", base.accelerometer_noise),
    )
    if imu is None or len(imu.stamps_ns) < NOISE_PARTS * LEAST_OF_PART + 2:
        why = "no IMU" if imu is None else "too few samples of the IMU"
        found.estimates += [unknown(name, value, unit, NOISE_EQUATION, why) for name, unit, value in noises]
        found.estimates.append(
            unknown("accelerometer_bias", base.accelerometer_bias, "m/s^2", STILL_EQUATION, why)
        )
        return found
    for (name, unit, usual), values in zip(
        noises, (imu.angular_velocity, imu.linear_acceleration), strict=True
    ):
        _noise(name, unit, usual, values, found)
    _bias(recording, imu, base, found)
    return found


def _noise(name: str, unit: str, usual: float, values: Array, found: Findings) -> None:
    """By second differences, which slow motion does not show in, of each axis in each part of the log."""
    e = (values[:-2] - 2.0 * values[1:-1] + values[2:]) / np.sqrt(6.0)
    parts = np.array_split(e, NOISE_PARTS)
    of_parts = np.array([[float(sigma_by_median(axis)) for axis in part.T] for part in parts])
    alive = np.median(of_parts, axis=0) > 0.0
    if not alive.any():
        found.estimates.append(unknown(name, usual, unit, NOISE_EQUATION, "its readings do not vary"))
        return
    # parts in which it starts, stops and turns have more of it: the usual one has not
    each = np.sqrt((of_parts[:, alive] ** 2).mean(axis=1))
    value = float(np.median(each))
    sigma = 1.25 * float(sigma_by_median(each - value)) / np.sqrt(len(each))
    sigma = float(np.hypot(sigma, MOTION[name] * value))
    found.estimates.append(Estimate(name, value, sigma, unit, NOISE_EQUATION, "", len(each) - 1, True))
    time = np.linspace(0.0, 100.0, len(each))
    sensor = name.split("_")[0]
    found.plots[name] = Plot(
        (name,), f"Noise of the {sensor}", "In each part of the drive; line: the usual one.",
        "part of the drive [%]", f"noise of a sample [{unit}]",
        {sensor: (time, each)}, {"estimate": (time[[0, -1]], np.array([value, value]))},
    )  # fmt: skip


def _bias(recording: Recording, imu: ImuLog, base: ImuMount, found: Findings) -> None:
    spans = still(recording)
    rows = [(imu.stamps_ns >= a) & (imu.stamps_ns < b) for a, b in spans]
    means = np.array([imu.linear_acceleration[row][:, :2].mean(axis=0) for row in rows if row.sum() > 20])
    if not len(means):
        why = "it never stood still"
        found.estimates.append(
            unknown("accelerometer_bias", base.accelerometer_bias, "m/s^2", STILL_EQUATION, why)
        )
        return
    size = float(np.hypot(*means.mean(axis=0))) / np.sqrt(2.0)
    # two axes tell a standard deviation of biases to within half of it
    found.estimates.append(
        Estimate("accelerometer_bias", size, 0.5 * size, "m/s^2", STILL_EQUATION, "", np.inf, True)
    )
    found.plots["accelerometer_bias"] = Plot(
        ("accelerometer_bias",), "Bias of the accelerometer", "Means of its readings at each standstill.",
        "ahead [m/s^2]", "to the left [m/s^2]", {"standstills": (means[:, 0], means[:, 1])},
    )  # fmt: skip


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
