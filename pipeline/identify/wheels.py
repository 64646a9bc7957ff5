"""Random slip of the wheels, and how late the odometry is: by how its turns wander from those of the map."""

from __future__ import annotations

import math

import numpy as np

from turtlebag.datasets.durations import nanoseconds, seconds
from turtlebag.datasets.motion import without_gap
from turtlebag.datasets.robust import sigma_by_median
from turtlebag.datasets.se2 import SE2, Array, wrap
from turtlebag.datasets.types import Recording, Stamps
from turtlebag.pipeline.identify.estimates import Estimate, Findings, Plot, unknown
from turtlebag.pipeline.identify.random_walk import RandomWalk
from turtlebag.sim.robots import Wheels

SLIP_EQUATION = "var(turn) = (slip / track)^2 (|left| + |right|) + turn_slip^2 |turn|, each way in metres"
DELAY_EQUATION = "turn(map) = turn_scale turn(odom) + turn_per_m way + delay (rate at end - rate at start)"
# Steps of the map that are compared are at least this far apart [s]; residuals of more than this many deviations
# are wheels that spin, which is another error; no more than this is random.
APART_S, SPUN = 0.4, 6.0
# Half of the time over which the turning rate is taken [s].
AROUND_S = 0.05
# A drive shows a variance if the logarithm of it is known to within this.
KNOWN = 1.0


def wheel_findings(recording: Recording, T_map_base: SE2, wheels: Wheels) -> Findings:
    """Slip of the wheels [m, rad after a metre, a radian] and delay of the odometry [s], by the poses of all scans
    (n,) on the map and the odometry as it was recorded."""
    assert recording.T_odom_base is not None
    rows, found = _apart(recording.stamps_ns), Findings()
    map_steps, steps = T_map_base[rows].steps(), recording.T_odom_base[rows].steps()
    waits = seconds(np.diff(recording.stamps_ns[rows]))
    rate = _rates(recording, recording.stamps_ns[rows])
    y = wrap(map_steps[:, 2] - steps[:, 2])
    design = np.column_stack([steps[:, 2], steps[:, 0], np.diff(rate)])
    track = 2.0 * wheels.joint_y
    ways = np.abs(steps[:, 0] - 0.5 * track * steps[:, 2]) + np.abs(steps[:, 0] + 0.5 * track * steps[:, 2])
    turns = np.abs(steps[:, 2])
    ok = without_gap(waits)
    if np.count_nonzero(ok) > 20:
        left = y - design @ np.linalg.lstsq(design[ok], y[ok], rcond=None)[0]
        ok &= np.abs(left) < SPUN * max(float(sigma_by_median(left[ok])), 1e-4)
    if np.count_nonzero(ok) < 40:
        _nothing(wheels, found, "too short a drive")
        return found
    walk = RandomWalk(y[ok], design[ok], np.column_stack([ways, turns])[ok])
    _slips(walk, track, wheels, found)
    coefficient, covariance = walk.coefficients()
    late, sigma = float(coefficient[2]), float(np.sqrt(covariance[2, 2]))
    changes = float(np.abs(design[ok, 2]).sum())
    found.estimates.append(
        Estimate("odometry_delay", late, sigma, "s", DELAY_EQUATION, "", figure="delay")
        if sigma < 0.02
        else unknown(
            "odometry_delay", 0.0, "s", DELAY_EQUATION, f"it changed its turning by only {changes:.1f} rad/s"
        )
    )
    _plots(walk, late, found)
    return found


def _slips(walk: RandomWalk, track: float, wheels: Wheels, found: Findings) -> None:
    logs, sure = walk.logs, walk.deviations()
    values = math.exp(0.5 * logs[0]) * track, math.exp(0.5 * logs[1])
    way, turn = float(walk.sources[:, 0].sum()) / 2.0, float(walk.sources[:, 1].sum())
    whys = (
        f"in {way:.1f} m, it shows less than other errors do",
        f"in {turn:.1f} rad of turning, it shows less than other errors do",
    )
    for name, unit, value, of_log, why in zip(
        ("slip", "turn_slip"), ("m", "rad"), values, sure[:2], whys, strict=True
    ):
        usual = getattr(wheels, name)
        found.estimates.append(
            Estimate(name, value, 0.5 * float(of_log) * value, unit, SLIP_EQUATION, "", np.inf, True, "slip")
            if of_log < KNOWN
            else unknown(name, ASSUMED[name] if usual is None else usual, unit, SLIP_EQUATION, why)
        )


ASSUMED = {"slip": 0.001, "turn_slip": 0.005}
"""Of a robot whose file does not say."""


def _nothing(wheels: Wheels, found: Findings, why: str) -> None:
    for name, unit in (("slip", "m"), ("turn_slip", "rad")):
        usual = getattr(wheels, name)
        found.estimates.append(
            unknown(name, ASSUMED[name] if usual is None else usual, unit, SLIP_EQUATION, why)
        )
    found.estimates.append(unknown("odometry_delay", 0.0, "s", DELAY_EQUATION, why))


def _apart(stamps_ns: Stamps) -> Array:
    """Scans, in order of time, at least APART_S apart."""
    order = np.argsort(stamps_ns, kind="stable")
    times = seconds(stamps_ns[order] - stamps_ns[order[0]])
    bins = np.floor(times / APART_S)
    return np.asarray(order[np.append(True, np.diff(bins) > 0)])


def _rates(recording: Recording, stamps_ns: Stamps) -> Array:
    """Turning rate by odometry at stamps (n,) [rad/s]."""
    path = recording.path
    assert path is not None
    stamps, first = np.unique(path.stamps_ns, return_index=True)
    times, yaw = seconds(stamps - stamps[0]), np.unwrap(path.poses.yaw[first])
    at = seconds(stamps_ns - stamps[0])
    around = max(AROUND_S, 0.5 * float(np.median(np.diff(times))) if len(times) > 1 else AROUND_S)
    ends = np.interp(at + around, times, yaw), np.interp(at - around, times, yaw)
    return np.asarray((ends[0] - ends[1]) / (2.0 * around))


def _plots(walk: RandomWalk, late: float, found: Findings) -> None:
    left = walk.y - walk.design @ walk.coefficients()[0]
    way = np.cumsum(walk.sources[:, 0]) / 2.0
    found.plots["slip"] = Plot(
        "How the odometry's heading wanders", "Turn of the map less that of the calibrated odometry, summed over the drive.",
        "way [m]", "heading [deg]", {}, {"odometry": (way, np.rad2deg(np.cumsum(left)))},
    )  # fmt: skip
    rest = left + walk.design[:, 2] * late
    found.plots["delay"] = Plot(
        "Delay of the odometry", "Turns that differ, by how much the turning changed; the slope is the delay.",
        "change of the turning rate [rad/s]", "turn that differs [mrad]",
        {"steps": (walk.design[:, 2], 1e3 * rest)},
        {"fit": (np.sort(walk.design[:, 2]), 1e3 * late * np.sort(walk.design[:, 2]))},
    )  # fmt: skip


def still(recording: Recording, least_s: float = 1.0) -> list[tuple[int, int]]:
    """Spans [ns] of at least so long in which the odometry does not move."""
    path = recording.path
    if path is None or len(path) < 3:
        return []
    moved = np.abs(path.poses.steps()).max(axis=1) > 1e-6
    edges = np.flatnonzero(np.diff(np.concatenate([[True], moved, [True]]).astype(int)))
    spans = [
        (int(path.stamps_ns[a]), int(path.stamps_ns[b])) for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]
    return [span for span in spans if span[1] - span[0] >= nanoseconds(least_s)]
