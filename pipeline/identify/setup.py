"""The lidar's pose, sweep and range errors, and the scale of the wheels, by the session of the map."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from turtlebag.datasets.motion import way_and_turn
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.identify.estimates import Estimate, Findings, unknown
from turtlebag.pipeline.slam.sensors.range_calibration import SHARE, TRIANGULATES_M
from turtlebag.pipeline.slam.sensors.setup_estimate import LEAST_SIGMA
from turtlebag.pipeline.slam.sessions import Session
from turtlebag.pipeline.slam.times.beam_times import TURN_SHARE
from turtlebag.sim.robots import RobotSpec

# Late stamps show as a lidar that sits farther ahead or back [m]; a sweep is wrong by such a share beyond
# what the turns are: both as the robots of `make bench-twin` have it.
AHEAD_MODEL_M, SWEEP_MODEL = 0.001, 0.006
SETUP_EQUATION = "scans: T_lidar^-1 T_odom(scales) T_lidar, over 1.5 m or a radian (Censi et al. 2013)"
TIMES_EQUATION = "turns of scans and odometry; the times of the beams at which scans match best"
BY_TURNS = ("turn_scale", "turn_per_m", "odometry_delay", "gyro_scale", "gyro_bias")
"""What the turns of all scans show better than those of key scans."""
OF_OTHERS = tuple(f"_{number}" for number in range(2, 9))
"""Ends of the names of further lidars' numbers."""


def setup_findings(recording: Recording, session: Session, base: RobotSpec) -> Findings:
    """Wheels, the lidar's pose, gyro and sweep, as the map's `sensors` have them."""
    moved = (
        way_and_turn(recording.T_odom_base.steps()) if recording.T_odom_base is not None else np.zeros((1, 2))
    )
    way, turn = moved.sum(axis=0).tolist()
    whys = {
        "lidar": f"it turned by only {turn:.1f} rad" if turn < 6.0 else "too few scans match over a baseline",
        "wheel": f"it drove only {way:.1f} m", "turn": f"it turned by only {turn:.1f} rad",
        "gyro": f"it turned by only {turn:.1f} rad", "sweep": "it never turned while the scans matched",
        "first": "not shown by how the scans match",
    }  # fmt: skip
    found = Findings()
    for one in session.setup.quantities:
        if one.name in BY_TURNS or one.name[-2:] in OF_OTHERS:
            continue
        equation = TIMES_EQUATION if one.name in ("sweep", "first_beam") else SETUP_EQUATION
        sigma = float(np.hypot(one.sigma, AHEAD_MODEL_M)) if one.name == "lidar_x" else one.sigma
        if one.name == "lidar_yaw":  # what matches have in common moves them aside and turns none
            sigma = math.sqrt(max(sigma**2 - LEAST_SIGMA**2, 0.0))
        why = "" if one.observable else whys[one.name.split("_")[0]]
        if one.name == "sweep" and recording.lidar.time_increment == 0.0 and one.value == 0.0:
            why = why or "all beams have one time"
        value = one.value if one.declared is None or one.observable else one.declared
        found.estimates.append(
            unknown(one.name, value, one.unit, equation, why)
            if why
            else Estimate(one.name, value, sigma, one.unit, equation)
        )
    known = {one.name for one in found.estimates}
    pose = recording.T_base_lidar.xyt.tolist()
    assumed = [("wheel_scale", 1.0, "1")]
    assumed += [
        (f"lidar_{n}", v, u) for n, v, u in zip(("x", "y", "yaw"), pose, ("m", "m", "rad"), strict=True)
    ]
    assumed += [("sweep", base.lidar.sweep, "periods"), ("first_beam", 0.0, "1")]
    for name, value, unit in assumed:
        if name not in known:
            why = "no two scans match over a baseline of driving"
            found.estimates.append(unknown(name, value, unit, SETUP_EQUATION, why))
    return found


def by_the_ruler(estimates: list[Estimate], session: Session, base: RobotSpec) -> list[Estimate]:
    """The estimates with what errors of the ranges, the only ruler, do to the scale of the ways.

    Ways are measured by how ranges change: an error that grows with their square stretches them by twice
    itself at the usual range. What of it the map was not corrected by is taken out; what is unknown counts.
    """
    square = next(one for one in estimates if one.name == "known_square")
    seen = session.recording.ranges[session.track.keys]
    seen = seen[session.recording.lidar.returns(seen)]
    usual = float(np.median(seen)) if len(seen) else 0.0
    left = 2.0 * usual * (square.value - session.ranges.square_per_m) if square.observable else 0.0
    unsure = 2.0 * usual * square.sigma if square.observable else 0.0
    if not square.observable and session.recording.lidar.range_max <= TRIANGULATES_M:
        unsure = 2.0 * usual * SHARE / session.recording.lidar.range_max
    error = float(np.hypot(unsure, base.lidar.errors.scale))
    return [
        replace(one, value=one.value / (1.0 + left), sigma=float(np.hypot(one.sigma, error)))
        if one.name == "wheel_scale" and one.observable
        else one
        for one in estimates
    ]


def by_true_turns(estimates: list[Estimate]) -> list[Estimate]:
    """The estimates with a sweep by true turns: the map looks for the one that bends scans least by the turns
    of the odometry, which are off by the scale of the turns."""
    scale = next(one for one in estimates if one.name == "turn_scale")

    def corrected(sweep: Estimate) -> Estimate:
        value = sweep.value / scale.value
        by_scans = math.sqrt(max(sweep.sigma**2 - (TURN_SHARE * sweep.value) ** 2, 0.0))
        return replace(
            sweep, value=value, sigma=math.hypot(by_scans, value * scale.sigma, value * SWEEP_MODEL)
        )

    return [
        corrected(one) if one.name == "sweep" and one.observable and scale.observable else one
        for one in estimates
    ]
