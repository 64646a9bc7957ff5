"""The parameters of a robot: what each means, and how it is shown."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

GROUPS = {
    "Lidar": (
        "beams", "angle_min", "angle_increment", "range_min", "range_max", "nearest_return",
        "farthest_return", "rate", "jitter", "sweep", "first_beam", "stamp_delay", "late_spread", "lidar_x",
        "lidar_y", "lidar_yaw", "known_offset", "known_square", "sigma", "sigma_square", "angle_deg",
        "resolution", "lost", "grazing",
    ),
    "Wheels": (
        "wheel_scale", "turn_scale", "turn_per_m", "slip", "turn_slip", "odometry_delay", "encoder_ticks",
        "command_delay", "max_dv", "max_dw",
    ),
    "IMU": ("gyro_scale", "gyro_bias", "gyro_noise", "accelerometer_noise", "accelerometer_bias"),
}  # fmt: skip
"""Parameters by the part of the page that shows them."""
MEANINGS = {
    "beams": "beams a scan", "angle_min": "angle of the first beam", "angle_increment": "angle between beams",
    "range_min": "nearest range", "range_max": "farthest range", "nearest_return": "nearest return seen",
    "farthest_return": "farthest return seen", "rate": "scans a second",
    "jitter": "jitter of the period, a share",
    "sweep": "time of a sweep, in periods", "first_beam": "beam that is taken first",
    "stamp_delay": "delay of the stamp after the first beam",
    "late_spread": "spread of that delay, end to end",
    "lidar_x": "lidar ahead of the base", "lidar_y": "lidar left of the base",
    "lidar_yaw": "yaw of the lidar",
    "known_offset": "offset of the ranges", "known_square": "error that grows with the square of the range",
    "sigma": "noise of a range", "sigma_square": "noise that grows with the square of the range",
    "angle_deg": "noise of a beam's direction", "resolution": "step of the readings",
    "lost": "share of lost beams", "grazing": "cosine of incidence at which many beams are lost",
    "wheel_scale": "true way by that of the odometry", "turn_scale": "true turn by that of the odometry",
    "turn_per_m": "turn for each metre that the odometry does not see",
    "slip": "random slip of a wheel after a metre", "turn_slip": "random slip in turning after a radian",
    "odometry_delay": "delay of the odometry after the scans", "encoder_ticks": "ticks of a wheel's turn",
    "command_delay": "delay of commands", "max_dv": "acceleration", "max_dw": "turning acceleration",
    "gyro_scale": "true turn by that of the gyro", "gyro_bias": "bias of the gyro",
    "gyro_noise": "noise of a gyro sample", "accelerometer_noise": "noise of an accelerometer sample",
    "accelerometer_bias": "bias of the accelerometer",
}  # fmt: skip


def parameter_rows(parameters: Mapping[str, Mapping[str, Any]]) -> list[list[str]]:
    """The same numbers as rows of a report: meaning, value, interval, and why there is none."""
    rows = []
    for name, entry in parameters.items():
        value, interval = value_and_interval(entry)
        why = "" if entry["observable"] else f"not observable: {entry['why']}"
        rows.append([MEANINGS.get(name, name), value, interval or ("exact" if not why else "\u2013"), why])
    return rows


def value_and_interval(entry: Mapping[str, Any]) -> tuple[str, str]:
    """Value and interval as text, with as many digits as the interval has."""
    unit = "" if entry["unit"] == "1" else f" {entry['unit']}"
    low, high = entry.get("interval_95", (entry["value"], entry["value"]))
    digits = 6 if high <= low else 3
    text = f"{entry['value']:.{max(digits, 4)}g}{unit}"
    return text, "" if high <= low else f"{low:.4g} to {high:.4g}"
