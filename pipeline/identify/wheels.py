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
from turtlebag.pipeline.slam.sensors.gyro_slip import GyroTurns
from turtlebag.sim.robots import Wheels

SLIP_EQUATION = "var(turn) = (slip / track)^2 (|left| + |right|) + turn_slip^2 |turn|, each way in metres"
GYRO_EQUATION = "turn(map) = gyro_scale (turn(gyro) - gyro_bias time)"
TURN_EQUATION = (
    "turn(map) = turn_scale turn(odom) + turn_per_m way + odometry_delay (rate at end - rate at start)"
)
# Steps of the map that are compared are this far apart [s]. Odometry whose heading goes astray in each turn
# and comes back after it is no random walk: then steps as long as the second one show another scale.
APART_S, LONG_S = 0.4, 5.0
# Scales that differ by so many deviations are not the same; residuals of more than so many deviations are
# wheels that spin, which is another error.
ANOTHER, SPUN = 3.0, 8.0
# Half of the time over which the turning rate is taken [s].
AROUND_S = 0.05
# A scan is bent by a change of the rate from this long before it to this long after [s].
BENT_S = 0.15
# A drive shows a variance if the logarithm of it is known to within this.
KNOWN = 1.0
# Errors of a map are neither white nor a walk. What that does to the logarithms of both variances, to scale,
# bias and delay of the turns, and to scale and bias of a gyro, as the robots of `make bench-twin` have it.
MODEL = np.array([0.15, 0.3])
TURNS_MODEL, GYRO_MODEL = np.array([0.0017, 0.001, 0.0028]), np.array([0.0006, 1e-5])


def wheel_findings(recording: Recording, T_map_base: SE2, wheels: Wheels) -> Findings:
    """Scale and bias of the turns, slip of the wheels, and delay of the odometry.

    They are shown by the poses of all scans (n,) on the map and the odometry as it was recorded.

    The turns of the odometry are explained by those of the map, not the other way round: who steers keeps the
    true heading, so slip shows in the odometry's.
    """
    found, track = Findings(), 2.0 * wheels.joint_y
    walk, longer = (_turns(recording, T_map_base, track, apart_s) for apart_s in (APART_S, LONG_S))
    if walk is None:
        _nothing(wheels, found, "too short a drive")
        return found
    walk = walk if longer is None or not _contradict(walk, longer) else longer
    _slips(walk, track, wheels, found)
    _systematic(walk, found)
    _plots(walk, found)
    return found


def _contradict(walk: RandomWalk, longer: RandomWalk) -> bool:
    """Whether longer steps show another scale of the turns (Hausman 1978)."""
    (of_short, short), (of_long, long) = walk.coefficients(), longer.coefficients()
    deviation = float(np.sqrt(short[0, 0] + long[0, 0] + TURNS_MODEL[0] ** 2))
    return abs(float(of_short[0] - of_long[0])) > ANOTHER * deviation


def _turns(recording: Recording, T_map_base: SE2, track: float, apart_s: float) -> RandomWalk | None:
    """The turns of the odometry less those of the map, over steps so far apart; None of too few."""
    assert recording.T_odom_base is not None
    rows = _apart(recording.stamps_ns, apart_s)
    map_steps, steps = T_map_base[rows].steps(), recording.T_odom_base[rows].steps()
    rate = _rates(recording, recording.stamps_ns[rows])
    y = wrap(steps[:, 2] - map_steps[:, 2])
    design = np.column_stack([map_steps[:, 2], steps[:, 0], np.diff(rate)])
    swing = 0.5 * track * map_steps[:, 2]
    ways, turns = np.abs(steps[:, 0] - swing) + np.abs(steps[:, 0] + swing), np.abs(map_steps[:, 2])
    ok = without_gap(seconds(np.diff(recording.stamps_ns[rows])))
    if np.count_nonzero(ok) > 20:
        left = y - design @ np.linalg.lstsq(design[ok], y[ok], rcond=None)[0]
        ok &= np.abs(left) < SPUN * max(float(sigma_by_median(left[ok])), 1e-4)
    if np.count_nonzero(ok) < 40:
        return None
    return RandomWalk(y, design, np.column_stack([ways, turns]), _readings(recording, rows, rate), ok)


def _readings(recording: Recording, rows: Array, rate: Array) -> Array:
    """What the noise of the map's headings (n,) grows with, (n, 3): a scan that is stamped late by chance has
    turned by as much, and one in which the rate changes is bent."""
    stamps = recording.stamps_ns[rows]
    later, earlier = (_rates(recording, stamps + nanoseconds(s)) for s in (BENT_S, -BENT_S))
    return np.column_stack([np.ones(len(rate)), rate**2, (later - earlier) ** 2])


def gyro_findings(recording: Recording, T_map_base: SE2, bias: float) -> Findings:
    """Scale and bias [rad/s] of the gyro by the poses of all scans (n,); `bias` is assumed if unknown."""
    names = (("gyro_scale", "1", 1.0, 0.025), ("gyro_bias", "rad/s", bias, 0.01))
    if recording.imu is None:
        return Findings(
            [unknown(name, usual, unit, GYRO_EQUATION, "no IMU") for name, unit, usual, _ in names]
        )
    rows = _apart(recording.stamps_ns, APART_S)
    stamps, turns = recording.stamps_ns[rows], T_map_base[rows].steps()[:, 2]
    by_gyro, known = GyroTurns(recording.imu).turns(stamps)
    waits, rate = seconds(np.diff(stamps)), _rates(recording, stamps)
    ok = known & without_gap(waits)
    if np.count_nonzero(ok) < 40:
        why = "the gyro does not cover the drive"
        return Findings([unknown(name, usual, unit, GYRO_EQUATION, why) for name, unit, usual, _ in names])
    # one that is mounted upside down turns the other way
    sign = 1.0 if by_gyro[ok] @ turns[ok] >= 0.0 else -1.0
    design = np.column_stack([turns, waits, np.diff(rate)])
    y, readings = wrap(sign * by_gyro - turns), _readings(recording, rows, rate)
    walk = RandomWalk(y, design, np.column_stack([waits, np.abs(turns)]), readings, ok)
    found = Findings()
    (turned, drifted, _), covariance = walk.coefficients()
    scale, sigmas = (
        1.0 / (1.0 + float(turned)),
        np.hypot(np.sqrt(np.diag(covariance))[:2], GYRO_MODEL).tolist(),
    )
    values = (scale, scale**2 * sigmas[0]), (sign * float(drifted), sigmas[1])
    turn = float(np.abs(turns).sum())
    found.estimates += [
        Estimate(name, value, sigma, unit, GYRO_EQUATION)
        if sigma < most
        else unknown(name, usual, unit, GYRO_EQUATION, f"it turned by only {turn:.1f} rad")
        for (name, unit, usual, most), (value, sigma) in zip(names, values, strict=True)
    ]
    found.plots["gyro_turns"] = _partial(
        walk, 0, ("gyro_scale",), "Scale of the gyro", "turn by the map [rad]"
    )
    left = walk.y - walk.design[:, [0, 2]] @ walk.coefficients()[0][[0, 2]]
    time = np.cumsum(waits)
    found.plots["gyro_bias"] = Plot(
        ("gyro_bias",), "Bias of the gyro", "Turn of the gyro less that of the map, summed; line: the bias.",
        "time [s]", "heading [deg]", {}, {"gyro": (time, np.rad2deg(np.cumsum(np.where(ok, left, 0.0)))),
        "bias": (time[[0, -1]], np.rad2deg(float(drifted) * time[[0, -1]]))},
    )  # fmt: skip
    return found


def _systematic(walk: RandomWalk, found: Findings) -> None:
    """What the turns of the odometry are off by throughout."""
    (turned, drove, late), covariance = walk.coefficients()
    sigmas = np.hypot(np.sqrt(np.diag(covariance)), TURNS_MODEL).tolist()
    way, turn = walk.sources.sum(axis=0) * [0.5, 1.0]
    changes = float(np.abs(walk.design[:, 2]).sum())
    scale = 1.0 / (1.0 + float(turned))
    for name, unit, value, sigma, most, usual, why in (
        ("turn_scale", "1", scale, scale**2 * sigmas[0], 0.025, 1.0, f"it turned by only {turn:.1f} rad"),
        ("turn_per_m", "rad/m", -scale * float(drove), scale * sigmas[1], 0.025, 0.0,
         f"it drove only {way:.1f} m"),
        ("odometry_delay", "s", -float(late), sigmas[2], 0.02, 0.0,
         f"its turning changed by only {changes:.1f} rad/s"),
    ):  # fmt: skip
        shown = sigma < most
        found.estimates.append(
            Estimate(name, value, sigma, unit, TURN_EQUATION)
            if shown
            else unknown(name, usual, unit, TURN_EQUATION, why)
        )


def _slips(walk: RandomWalk, track: float, wheels: Wheels, found: Findings) -> None:
    logs, sure = walk.logs, np.hypot(walk.deviations()[:2], MODEL)
    values = math.exp(0.5 * logs[0]) * track, math.exp(0.5 * logs[1])
    way, turn = float(walk.sources[:, 0].sum()) / 2.0, float(walk.sources[:, 1].sum())
    whys = (
        f"in {way:.1f} m, it shows less than other errors do",
        f"in {turn:.1f} rad of turning, it shows less than other errors do",
    )
    for name, unit, value, of_log, why in zip(
        ("slip", "turn_slip"), ("m", "rad"), values, sure, whys, strict=True
    ):
        usual = getattr(wheels, name)
        found.estimates.append(
            Estimate(name, value, 0.5 * float(of_log) * value, unit, SLIP_EQUATION, "", np.inf, True)
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
    for name, unit, usual in (
        ("turn_scale", "1", 1.0),
        ("turn_per_m", "rad/m", 0.0),
        ("odometry_delay", "s", 0.0),
    ):
        found.estimates.append(unknown(name, usual, unit, TURN_EQUATION, why))


def _apart(stamps_ns: Stamps, apart_s: float) -> Array:
    """Scans, in order of time, one in each span of so long."""
    order = np.argsort(stamps_ns, kind="stable")
    times = seconds(stamps_ns[order] - stamps_ns[order[0]])
    bins = np.floor(times / apart_s)
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


def _plots(walk: RandomWalk, found: Findings) -> None:
    coefficients, _ = walk.coefficients()
    left = walk.y - walk.design @ coefficients
    found.plots["slip"] = Plot(
        ("slip", "turn_slip"), "How the odometry's heading wanders",
        "Turn of the corrected odometry less that of the map, summed.",
        "way [m]", "heading [deg]",
        {}, {"odometry": (0.5 * np.cumsum(walk.sources[:, 0]), np.rad2deg(np.cumsum(left)))},
    )  # fmt: skip
    for k, (names, title, x) in enumerate((
        (("turn_scale",), "Scale of the turns", "turn by the map [rad]"),
        (("turn_per_m",), "Turn with the way", "way by the odometry [m]"),
        (("odometry_delay", "stamp_delay"), "Delay of the odometry", "change of the turning rate [rad/s]"),
    )):  # fmt: skip
        found.plots[names[0]] = _partial(walk, k, names, title, x)


def _partial(walk: RandomWalk, column: int, names: tuple[str, ...], title: str, x: str) -> Plot:
    """What one column of the design explains, and the rest."""
    coefficients, _ = walk.coefficients()
    values, slope = walk.design[:, column], float(coefficients[column])
    left = walk.y - walk.design @ coefficients + slope * values
    ends = np.array([values.min(), values.max()])
    return Plot(
        names, title, "Turn beyond the map's in each step, less what else explains it; line: the fit.",
        x, "turn that differs [mrad]", {"steps": (values, 1e3 * left)}, {"fit": (ends, 1e3 * slope * ends)},
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
