"""Plots of the data behind the set-up: what single stretches of the drive say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.motion import way_and_turn
from turtlebag.datasets.se2 import SE2, Array, wrap
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.identify.estimates import Estimate, Plot
from turtlebag.pipeline.slam.sessions import Session
from turtlebag.pipeline.slam.times.beam_times import SECTORS, believed_s
from turtlebag.pipeline.slam.times.stretches import usual_period

# Straight stretches are this long [m], and straight within this [rad]; turns are of this [rad].
STRETCH_M, STRAIGHT_RAD, TURN_RAD = 0.75, 0.1, 1.0


def setup_plots(
    own: Recording, session: Session, T_map_base: SE2, estimates: Mapping[str, Estimate]
) -> dict[str, Plot]:
    """Those of a recording of one lidar, with its poses (n,) on the map."""
    assert own.T_odom_base is not None
    plots = _ways(own, T_map_base, estimates["wheel_scale"].value)
    T_map_lidar = T_map_base @ session.recording.T_base_lidar
    if all(estimates[name].observable for name in ("lidar_x", "lidar_y", "lidar_yaw")):
        plots |= _place(own, T_map_lidar, estimates) | _direction(own, T_map_lidar, estimates)
    if estimates["sweep"].observable and session.recording.times.sectors_s:
        plots |= _sweep(session.recording, estimates)
    return plots


def _stretches(own: Recording, along: Array, length: float) -> Array:
    """Ends of stretches one after another, by what has been driven or turned at each scan (n,)."""
    rows = np.unique(np.searchsorted(along, np.arange(0.0, along[-1], length)))
    return np.asarray(rows[rows < len(own)])


def _so_far(own: Recording, column: int) -> Array:
    assert own.T_odom_base is not None
    moved = way_and_turn(own.T_odom_base.steps())[:, column]
    return np.append(0.0, np.cumsum(np.where(np.isfinite(moved), moved, 0.0)))


def _ways(own: Recording, T_map_base: SE2, scale: float) -> dict[str, Plot]:
    """How much farther the map says it went than the odometry does, over straight stretches."""
    assert own.T_odom_base is not None
    rows = _stretches(own, _so_far(own, 0), STRETCH_M)
    steps = [part[rows].steps() for part in (own.T_odom_base, T_map_base)]
    straight = np.abs(steps[0][:, 2]) < STRAIGHT_RAD
    odom, by_map = (np.hypot(*part[straight, :2].T) for part in steps)
    ends = np.array([0.0, float(odom.max(initial=0.1))])
    plot = Plot(
        ("wheel_scale",), "Scale of the ways",
        "Straight stretches: way by the map less that by the odometry; line: the scale.",
        "way by the odometry [m]", "farther by the map [mm]",
        {"stretches": (odom, 1e3 * (by_map - odom))}, {"wheel_scale": (ends, 1e3 * (scale - 1.0) * ends)},
    )  # fmt: skip
    return {"ways": plot}


def _place(own: Recording, T_map_lidar: SE2, estimates: Mapping[str, Estimate]) -> dict[str, Plot]:
    """Where each turn puts the lidar: the point of the base frame about which it swings, from the lidar's own
    motion and the base's by odometry."""
    assert own.T_odom_base is not None
    rows = _stretches(own, _so_far(own, 1), TURN_RAD)
    lidar, base = T_map_lidar[rows].steps(), own.T_odom_base[rows].steps()
    base[:, :2] *= estimates["wheel_scale"].value
    swing = np.exp(1j * lidar[:, 2]) - 1.0
    ahead = np.exp(1j * estimates["lidar_yaw"].value) * (lidar[:, 0] + 1j * lidar[:, 1])
    # those that drive least, where the odometry's errors are least
    some = np.argsort(np.hypot(*base[:, :2].T), kind="stable")[: max(len(base) // 2, 10)]
    some = some[np.abs(swing[some]) > 0.5 * TURN_RAD]
    place = 1e3 * (ahead[some] - (base[some, 0] + 1j * base[some, 1])) / swing[some]
    (x, x_ends), (y, y_ends) = (
        (1e3 * one.value, 1e3 * np.array(one.interval_95))
        for one in (estimates["lidar_x"], estimates["lidar_y"])
    )
    cross = np.array([*x_ends, x, x, x]), np.array([y, y, y, *y_ends])
    declared = 1e3 * own.T_base_lidar.xyt[:2]
    plot = Plot(
        ("lidar_x", "lidar_y"), "Place of the lidar",
        "Where each turn puts it; cross: the estimate from all scans, with its interval.",
        "ahead of the base [mm]", "to the left [mm]",
        {"turns": (place.real, place.imag), "as the bag says": (declared[:1], declared[1:])},
        {"estimate": cross},
    )  # fmt: skip
    return {"place": plot}


def _direction(own: Recording, T_map_lidar: SE2, estimates: Mapping[str, Estimate]) -> dict[str, Plot]:
    """Which way straight stretches lead, seen from the lidar."""
    assert own.T_odom_base is not None
    rows = _stretches(own, _so_far(own, 0), STRETCH_M)
    lidar, base = T_map_lidar[rows].steps(), own.T_odom_base[rows].steps()
    straight = np.abs(base[:, 2]) < STRAIGHT_RAD
    place = estimates["lidar_x"].value + 1j * estimates["lidar_y"].value
    ahead = base[:, 0] + 1j * base[:, 1] + (np.exp(1j * lidar[:, 2]) - 1.0) * place
    yaw = wrap(np.angle(ahead) - np.arctan2(lidar[:, 1], lidar[:, 0]))[straight]
    times = seconds(own.stamps_ns[rows[:-1]] - own.stamps_ns[0])[straight]
    low, high = np.rad2deg(estimates["lidar_yaw"].interval_95).tolist()
    ends = np.array([0.0, own.duration()])
    plot = Plot(
        ("lidar_yaw",), "Yaw of the lidar",
        "Direction of straight stretches by the odometry less that seen from the lidar; box: the interval.",
        "time [s]", "yaw [deg]", {"stretches": (times, np.rad2deg(yaw))},
        {"interval": (np.append(ends, ends[::-1]), np.array([low, low, high, high]))},
    )  # fmt: skip
    return {"direction": plot}


def _sweep(recording: Recording, estimates: Mapping[str, Estimate]) -> dict[str, Plot]:
    """When the parts of the array are taken."""
    lidar, first = recording.lidar, round(estimates["first_beam"].value) % recording.lidar.n_beams
    increment = estimates["sweep"].value * usual_period(recording) / lidar.n_beams
    fitted = believed_s(replace(lidar, time_increment=increment, first_beam=first))
    beams = (np.arange(SECTORS) + 0.5) * lidar.n_beams / SECTORS
    times = np.array(recording.times.sectors_s)
    plot = Plot(
        ("sweep", "first_beam"), "Times of the beams",
        "When parts of the array are taken, by how scans of turns match; line: the sweep.",
        "beam", "time [ms]", {"parts of the array": (beams, 1e3 * (times + float(np.mean(fitted - times))))},
        {"sweep": (beams, 1e3 * fitted)},
    )  # fmt: skip
    return {"sweep": plot}
