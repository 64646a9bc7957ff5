"""A robot's parameters from one recording: what its own scans, wheels, IMU and commands say of each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from turtlebag.datasets.bags.reader import read_drive
from turtlebag.datasets.bags.source import is_bag
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.motion import way_and_turn
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.identify.estimates import Estimate, Findings, Plot, unknown
from turtlebag.pipeline.identify.lidar import lidar_findings
from turtlebag.pipeline.identify.motors import Commands, motor_findings
from turtlebag.pipeline.identify.others import encoder_findings, imu_findings
from turtlebag.pipeline.identify.robot_file import robot_of
from turtlebag.pipeline.identify.wheels import gyro_findings, wheel_findings
from turtlebag.pipeline.slam.graph.edits import Edits
from turtlebag.pipeline.slam.mapper import SlamConfig, solve_graph, track_recording
from turtlebag.pipeline.slam.progress import Progress, no_progress
from turtlebag.pipeline.slam.sensors.range_calibration import SHARE, TRIANGULATES_M, range_fit
from turtlebag.pipeline.slam.sensors.setup_estimate import BETTER
from turtlebag.pipeline.slam.sessions import Session
from turtlebag.sim.robots import RobotSpec

# Late stamps show as a lidar that sits elsewhere [m], as the robots of `make bench-twin` have it.
POSE_MODEL_M = 0.001
# A robot that drives and turns less than this [m, rad] does not move.
LEAST_WAY_M, LEAST_TURN_RAD = 0.5, 0.5
# Stretches that are drawn: this long [m], and straight within this [rad].
STRETCH_M, STRAIGHT_RAD = 0.75, 0.1
SETUP_EQUATION = "scans: T_lidar^-1 T_odom(scales) T_lidar, over 1.5 m or a radian (Censi et al. 2013)"
RANGE_EQUATION = "reading = r + known_offset + known_square r^2, by walls seen from several ranges"
TIMES_EQUATION = "turns of scans and odometry; the times of the beams at which scans match best"
MESSAGE = "as its messages say"
BY_TURNS = ("turn_scale", "turn_per_m", "odometry_delay", "gyro_scale", "gyro_bias")
"""What the turns of all scans show better than those of key scans."""
OF_OTHERS = tuple(f"_{number}" for number in range(2, 9))
"""Ends of the names of further lidars' numbers."""


@dataclass(frozen=True)
class Streams:
    """What a bag has besides what is mapped: commands, joint angles (n, wheels) [rad]; None: not there."""

    commands: Commands | None = None
    joints: Array | None = None

    @staticmethod
    def of(path: Path) -> Streams:
        """Those of a recording; a CARMEN log has none."""
        if not (path.is_dir() or is_bag(path)):
            return Streams()
        return Streams(*read_drive(path))


@dataclass(frozen=True, eq=False)
class Identification:
    """The estimates of a recording, the plots of their data, the session of its map, and the robot that they
    were told of: what no bag shows is `base`'s."""

    recording: Recording
    session: Session
    base: RobotSpec
    estimates: tuple[Estimate, ...]
    plots: Mapping[str, Plot]

    def __getitem__(self, name: str) -> Estimate:
        return next(one for one in self.estimates if one.name == name)

    @property
    def values(self) -> dict[str, float]:
        """The value of each estimate."""
        return {one.name: one.value for one in self.estimates}

    @cached_property
    def robot(self) -> RobotSpec:
        """The robot of the estimates."""
        return robot_of(self.values, self.recording, self.base)

    def drawn(self, rng: np.random.Generator) -> RobotSpec:
        """A robot whose parameters are drawn from their intervals."""
        return robot_of({one.name: one.drawn(rng) for one in self.estimates}, self.recording, self.base)

    def as_record(self) -> dict[str, Any]:
        """identify.json."""
        of_each = {one.name: one.as_record() for one in self.estimates}
        shape = ("name", "height", "footprint", "parts", "wheels.radius", "wheels.joint_y", "imu.position")
        return {"base": self.base.name, "parameters": of_each, "from_base": list(shape)}


def identify(
    recording: Recording,
    base: RobotSpec,
    streams: Streams = Streams(),
    config: SlamConfig | None = None,
    progress: Progress = no_progress,
) -> Identification:
    """The parameters of the robot that made a recording, as it was read; InputError where it shows none."""
    require_motion(recording)
    config = config or SlamConfig()
    session = solve_graph(track_recording(recording, config, progress), config, Edits(), progress)
    return identified(recording, session, base, streams)


def require_motion(recording: Recording) -> None:
    """InputError for a recording without scans, odometry or motion."""
    if len(recording) < 2:
        raise InputError(f"{recording.source}: has {len(recording)} scans; identify needs a drive")
    if recording.T_odom_base is None:
        raise InputError(f"{recording.source}: has no odometry, which identify compares with the scans")
    moved = way_and_turn(recording.T_odom_base.steps())
    way, turn = (float(part[np.isfinite(part)].sum()) for part in moved.T)
    if way < LEAST_WAY_M and turn < LEAST_TURN_RAD:
        raise InputError(
            f"{recording.source}: the robot does not move, so nothing of its wheels and lidar shows"
        )


def identified(
    recording: Recording,
    session: Session,
    base: RobotSpec,
    streams: Streams = Streams(),
) -> Identification:
    """As `identify`, by the session of the recording's map. Of several lidars, the first is identified."""
    rows, own = recording.parts()[0]
    poses = session.carried().T_track_base[rows]
    parts = [
        _setup(recording, session, base),
        lidar_findings(own, base.lidar.errors),
        _ranges(session),
        _limits(own),
        wheel_findings(own, poses, base.wheels),
        encoder_findings(streams.joints, base.wheels.encoder_ticks),
        motor_findings(recording, streams.commands, base.limits),
        gyro_findings(recording, session.carried().T_track_base, base.imu.gyro_bias),
        imu_findings(recording, base.imu),
    ]
    estimates = [one for part in parts for one in part.estimates]
    plots = {name: plot for part in parts for name, plot in part.plots.items()}
    estimates = _by_the_ruler(_with_stamps(estimates, base), session, base)
    scale = next(one.value for one in estimates if one.name == "wheel_scale")
    plots |= _way_plot(own, poses, scale)
    return Identification(recording, session, base, tuple(estimates), plots)


def _setup(recording: Recording, session: Session, base: RobotSpec) -> Findings:
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
        sigma = float(np.hypot(one.sigma, POSE_MODEL_M)) if one.unit == "m" else one.sigma
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


def _way_plot(recording: Recording, T_map_base: SE2, scale: float) -> dict[str, Plot]:
    """How much farther the map says it went than the odometry does, over straight stretches."""
    assert recording.T_odom_base is not None
    so_far = np.append(0.0, np.cumsum(way_and_turn(recording.T_odom_base.steps())[:, 0]))
    rows = np.unique(np.searchsorted(so_far, np.arange(0.0, so_far[-1], STRETCH_M)))
    rows = rows[rows < len(recording)]
    steps = [part[rows].steps() for part in (recording.T_odom_base, T_map_base)]
    straight = np.abs(steps[0][:, 2]) < STRAIGHT_RAD
    odom, by_map = (np.hypot(*part[straight, :2].T) for part in steps)
    ends = np.array([0.0, float(odom.max(initial=0.1))])
    plot = Plot(
        "Scale of the ways", "Straight stretches: way by the map less that by the odometry; line: the scale.",
        "way by the odometry [m]", "farther by the map [mm]",
        {"stretches": (odom, 1e3 * (by_map - odom))}, {"wheel_scale": (ends, 1e3 * (scale - 1.0) * ends)},
    )  # fmt: skip
    return {"ways": plot}


def _ranges(session: Session) -> Findings:
    """Offset of the ranges, and what grows with their square."""
    names = (("known_offset", "m"), ("known_square", "1/m"))
    lidar = session.recording.lidar
    first = session.recording.lidar_of[session.track.keys] == 0
    keys = session.track.keys[first]
    if lidar.range_max > TRIANGULATES_M or len(keys) < 10:
        why = (
            "too few key scans"
            if len(keys) < 10
            else "a lidar that sees that far measures the time of flight"
        )
        return Findings([unknown(name, 0.0, unit, RANGE_EQUATION, why) for name, unit in names])
    clouds, _ = session.key_scans
    value, information, prior = range_fit(clouds, keys, session.graph.T_map_keys[first], lidar.range_max)
    covariance = np.linalg.inv(information + prior)
    total = value + np.array([session.ranges.offset_m, session.ranges.square_per_m])
    found = Findings()
    for k, (name, unit) in enumerate(names):
        sigma, usual = float(np.sqrt(covariance[k, k])), float(prior[k, k] ** -0.5)
        found.estimates.append(
            Estimate(name, float(total[k]), sigma, unit, RANGE_EQUATION)
            if BETTER * sigma < usual
            else unknown(name, 0.0, unit, RANGE_EQUATION, "too few walls were seen from several ranges")
        )
    return found


def _limits(recording: Recording) -> Findings:
    """The lidar's beams and limits, and how near and far it did see."""
    lidar = recording.lidar
    back = recording.ranges[lidar.returns(recording.ranges)]
    seen = np.quantile(back, [0.0005, 0.9995]) if len(back) else np.zeros(2)
    says = [
        ("beams", float(lidar.n_beams), "1"), ("angle_min", lidar.angle_min, "rad"),
        ("angle_increment", lidar.angle_increment, "rad"),
        ("range_min", lidar.range_min, "m"), ("range_max", lidar.range_max, "m"),
    ]  # fmt: skip
    found = [Estimate(name, value, 0.0, unit, MESSAGE) for name, value, unit in says]
    ends = zip(("nearest_return", "farthest_return"), seen.tolist(), strict=True)
    found += [
        Estimate(name, value, 0.0, "m", "nearly all returns lie beyond, or before it") for name, value in ends
    ]
    return Findings(found)


def _with_stamps(estimates: list[Estimate], base: RobotSpec) -> list[Estimate]:
    """The estimates with how late scans are stamped: as the odometry is early, which looks the same."""
    late = next(one for one in estimates if one.name == "odometry_delay")
    equation = "odometry that is early by as much looks the same: stamp_delay = -odometry_delay"
    usual = float(np.mean(base.lidar.errors.stamp_delay))
    stamp = (
        unknown("stamp_delay", usual, "s", equation, late.why)
        if late.why
        else replace(late, name="stamp_delay", value=-late.value, equation=equation)
    )
    return [*estimates, stamp]


def _by_the_ruler(estimates: list[Estimate], session: Session, base: RobotSpec) -> list[Estimate]:
    """The estimates with what errors of the ranges, the only ruler, do to the scale of the ways.

    Ways are measured by how ranges change: an error that grows with their square stretches them by twice
    itself at the usual range. What of it the map was not corrected by is taken out; what is unknown counts.
    """
    square = next(one for one in estimates if one.name == "known_square")
    keys = session.track.keys
    seen = session.recording.ranges[keys]
    usual = float(np.median(seen[session.recording.lidar.returns(seen)])) if len(keys) else 0.0
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
