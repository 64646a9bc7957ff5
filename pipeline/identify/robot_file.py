"""A robot of the simulator by estimates, and the same numbers as other programs want them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.types import Recording
from turtlebag.datasets.yaml_files import checked
from turtlebag.sim.robots import CONTROL_HZ, RobotSpec

# AMCL moves its particles after this much driving [m] and turning [rad] (Nav2's update_min_d, update_min_a).
UPDATE_M, UPDATE_RAD = 0.25, 0.2
# No alpha below this: a filter whose particles do not spread cannot recover.
LEAST_ALPHA = 1e-3
# Limits of the simulator.
LONGEST_DELAY_S, MOST_JITTER, MOST_SLIP, MOST_TURN_SLIP = 0.2, 0.05, 0.1, 0.5


def robot_of(values: Mapping[str, float], recording: Recording, base: RobotSpec) -> RobotSpec:
    """The robot with such parameters; what is not among them is the base robot's. Where the simulator has
    limits, they hold; InputError where it would be no robot at all."""
    wheels = base.wheels
    scale, turn_scale = values["wheel_scale"], values["turn_scale"]
    own_wheels = {
        "controller_radius": wheels.radius / scale,
        "separation": 2.0 * wheels.joint_y * turn_scale / scale,
        "turn_per_m": _within(values["turn_per_m"], 0.5),
        "calibration_error": 0.0,
        "slip": min(values["slip"], MOST_SLIP),
        "turn_slip": min(values["turn_slip"], MOST_TURN_SLIP),
        "encoder_ticks": round(values["encoder_ticks"]),
    }
    limits = {
        "max_dv": values["max_dv"],
        "max_dw": values["max_dw"],
        "wheel_acceleration": max(
            base.limits.wheel_acceleration, values["max_dv"], values["max_dw"] * wheels.joint_y
        ),
        "command_delay": min(round(max(values["command_delay"], 0.0) * CONTROL_HZ) / CONTROL_HZ, 2.0),
        **_speeds(recording, base),
    }
    imu = {name: values[name] for name in ("gyro_noise", "accelerometer_noise", "accelerometer_bias")}
    imu |= {"gyro_bias": abs(values["gyro_bias"])}
    told = base.model_dump()
    told |= {"name": f"{base.name}_identified", "lidar": _lidar(values, base)}
    for part, changed in (("wheels", own_wheels), ("limits", limits), ("imu", imu)):
        told[part] = {**told[part], **changed}
    return checked(RobotSpec, told, where=f"{recording.source}: its robot")


def _lidar(values: Mapping[str, float], base: RobotSpec) -> dict[str, Any]:
    increment, n = values["angle_increment"], round(values["beams"])
    first = values["angle_min"] if increment > 0.0 else values["angle_min"] + increment * (n - 1)
    late, spread = max(values["stamp_delay"], 0.0), min(values["late_spread"], LONGEST_DELAY_S)
    delay = max(late - 0.5 * spread, 0.0), min(late + 0.5 * spread, LONGEST_DELAY_S)
    errors = {
        **base.lidar.errors.model_dump(),
        **{name: values[name] for name in ("sigma", "sigma_square", "angle_deg", "resolution", "grazing")},
        "lost": min(values["lost"], 1.0),
        "jitter": min(values["jitter"], MOST_JITTER),
        "stamp_delay": (min(delay[0], delay[1]), delay[1]),
        "known_offset": _within(values["known_offset"], 0.5),
        "known_square": _within(values["known_square"], 0.1),
        **dict.fromkeys(("offset", "square", "speed"), 0.0),
    }
    return {
        **base.lidar.model_dump(),
        "pose": (values["lidar_x"], values["lidar_y"], values["lidar_yaw"]),
        "n_beams": min(n, 10_000),
        "angle_min": first,
        "angle_increment_deg": abs(float(np.rad2deg(increment))),
        "range_min": max(values["range_min"], 1e-3),
        "range_max": values["range_max"] if math.isfinite(values["range_max"]) else base.lidar.range_max,
        "rate_hz": CONTROL_HZ / max(round(CONTROL_HZ / max(values["rate"], 0.1)), 1),
        "sweep": _within(values["sweep"], 1.0),
        "errors": errors,
    }


def _speeds(recording: Recording, base: RobotSpec) -> dict[str, float]:
    """Limits of the speeds: the base robot's, or what it drove where that is more."""
    path = recording.path
    assert path is not None
    dt = seconds(np.diff(path.stamps_ns))
    ok = dt > 0.01
    if not ok.any():
        return {}
    steps = path.poses.steps()[ok]
    seen = [np.quantile(np.abs(steps[:, k]) / dt[ok], 0.99) for k in (0, 2)]
    limits = base.limits
    return {"max_v": max(limits.max_v, float(seen[0])), "max_w": max(limits.max_w, float(seen[1]))}


def _within(value: float, most: float) -> float:
    return min(max(value, -most), most)


def amcl_alphas(values: Mapping[str, float], base: RobotSpec) -> dict[str, float]:
    """Nav2's noise of the motion model: variance over that of an update's motion, random and systematic.

    alpha1 is that of turns by turns, alpha2 of turns by ways, alpha3 of ways by ways, alpha4
    of ways by turns.
    """
    track = 2.0 * base.wheels.joint_y
    of_way, of_turn = 2.0 * (values["slip"] / track) ** 2, values["turn_slip"] ** 2
    found = {
        "alpha1": of_turn / UPDATE_RAD + (values["turn_scale"] - 1.0) ** 2,
        "alpha2": of_way / UPDATE_M + values["turn_per_m"] ** 2,
        "alpha3": 0.5 * values["slip"] ** 2 / UPDATE_M + (values["wheel_scale"] - 1.0) ** 2,
        "alpha4": 0.25 * values["slip"] ** 2 * track / UPDATE_RAD,
    }
    return {name: round(max(value, LEAST_ALPHA), 6) for name, value in found.items()} | {
        "alpha5": LEAST_ALPHA
    }


def nav2_yaml(values: Mapping[str, float], base: RobotSpec) -> dict[str, Any]:
    """Parameters of amcl and of diff_drive_controller."""
    share = values["wheel_scale"] / values["turn_scale"]
    apart = 0.5 * values["turn_per_m"] * base.wheels.separation * share
    multipliers = {
        "wheel_separation_multiplier": round(share, 6),
        "left_wheel_radius_multiplier": round(values["wheel_scale"] - apart, 6),
        "right_wheel_radius_multiplier": round(values["wheel_scale"] + apart, 6),
    }
    beams = {"laser_min_range": values["range_min"], "laser_max_range": values["farthest_return"]}
    model = {
        "robot_model_type": "nav2_amcl::DifferentialMotionModel",
        **amcl_alphas(values, base), "update_min_d": UPDATE_M, "update_min_a": UPDATE_RAD, **beams,
    }  # fmt: skip
    return {
        "amcl": {"ros__parameters": model},
        "diff_drive_controller": {"ros__parameters": multipliers},
    }


def transform_arguments(values: Mapping[str, float], base: RobotSpec) -> str:
    """Arguments of tf2_ros's static_transform_publisher for the lidar's pose on the base."""
    x, y, yaw = (values[f"lidar_{name}"] for name in ("x", "y", "yaw"))
    place = f"--x {x:.4f} --y {y:.4f} --z {base.lidar.height:.4f} --yaw {yaw:.5f} --pitch 0 --roll 0"
    return f"{place} --frame-id base_footprint --child-frame-id base_scan\n"


def scan_filter(values: Mapping[str, float]) -> dict[str, Any]:
    """A chain of laser_filters: what no return comes from, and the parameters that REP-138 names."""
    low, high = round(values["nearest_return"], 3), round(values["farthest_return"], 3)
    n, first, step = round(values["beams"]), values["angle_min"], values["angle_increment"]
    ends = sorted((first, first + (n - 1) * step))
    range_filter = {
        "name": "range", "type": "laser_filters/LaserScanRangeFilter",
        "params": {"lower_threshold": low, "upper_threshold": high,
                   "lower_replacement_value": "-.inf", "upper_replacement_value": ".inf"},
    }  # fmt: skip
    shadows = {
        "name": "shadows", "type": "laser_filters/ScanShadowsFilter",
        "params": {"min_angle": 10.0, "max_angle": 170.0, "neighbors": 5, "window": 1},
    }  # fmt: skip
    limits = {
        "range_min": low,
        "range_max": high,
        "angle_min": round(ends[0], 6),
        "angle_max": round(ends[1], 6),
    }
    chain = {"ros__parameters": {"filter1": range_filter, "filter2": shadows}}
    return {"scan_to_scan_filter_chain": chain, "laser": {"ros__parameters": limits}}
