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
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.identify.estimates import Estimate, Findings, Plot, unknown
from turtlebag.pipeline.identify.lidar import lidar_findings
from turtlebag.pipeline.identify.motors import Commands, motor_findings
from turtlebag.pipeline.identify.others import encoder_findings, imu_findings
from turtlebag.pipeline.identify.ranges import range_findings
from turtlebag.pipeline.identify.robot_file import robot_of
from turtlebag.pipeline.identify.setup import by_the_ruler, by_true_turns, setup_findings
from turtlebag.pipeline.identify.setup_plots import setup_plots
from turtlebag.pipeline.identify.wheels import gyro_findings, wheel_findings
from turtlebag.pipeline.slam.graph.edits import Edits
from turtlebag.pipeline.slam.mapper import SlamConfig, solve_graph, track_recording
from turtlebag.pipeline.slam.progress import Progress, no_progress
from turtlebag.pipeline.slam.sessions import Session
from turtlebag.sim.robots import RobotSpec

# A robot that drives and turns less than this [m, rad] does not move.
LEAST_WAY_M, LEAST_TURN_RAD = 0.5, 0.5
MESSAGE = "as its messages say"
# Errors of two numbers that are one and the same leave no matrix to draw from.
MOST_COMMON = 0.999


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
    were told of: what no bag shows is `base`'s. `correlations` are those of the errors of two estimates."""

    recording: Recording
    session: Session
    base: RobotSpec
    estimates: tuple[Estimate, ...]
    plots: Mapping[str, Plot]
    correlations: Mapping[tuple[str, str], float]

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
        """A robot whose parameters are drawn from their intervals, those together that are known together."""
        row = {one.name: k for k, one in enumerate(self.estimates)}
        together = np.eye(len(row))
        for (a, b), value in self.correlations.items():
            together[row[a], row[b]] = together[row[b], row[a]] = MOST_COMMON * value
        units = np.linalg.cholesky(together) @ rng.standard_normal(len(row))
        values = {one.name: one.drawn(unit) for one, unit in zip(self.estimates, units, strict=True)}
        return robot_of(values, self.recording, self.base)

    def as_record(self) -> dict[str, Any]:
        """identify.json."""
        of_each = {one.name: one.as_record() for one in self.estimates}
        shape = ("name", "height", "footprint", "parts", "wheels.radius", "wheels.joint_y", "imu.position")
        others = [lidar.topic for lidar in self.recording.others]
        lidar = {"lidar": self.recording.topic, "other_lidars": others} if others else {}
        common = [[*names, value] for names, value in self.correlations.items()]
        return {
            "base": self.base.name, **lidar, "parameters": of_each, "correlations": common,
            "from_base": list(shape),
        }  # fmt: skip


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
        setup_findings(recording, session, base),
        lidar_findings(own, base.lidar.errors),
        range_findings(session),
        _limits(own),
        wheel_findings(own, poses, base.wheels),
        encoder_findings(streams.joints, base.wheels.encoder_ticks),
        motor_findings(recording, streams.commands, base.limits),
        gyro_findings(recording, session.carried().T_track_base, base.imu.gyro_bias),
        imu_findings(recording, base.imu),
    ]
    estimates = [one for part in parts for one in part.estimates]
    plots = {name: plot for part in parts for name, plot in part.plots.items()}
    estimates = by_true_turns(by_the_ruler(_with_stamps(estimates, base), session, base))
    correlations = {names: value for part in parts for names, value in part.correlations.items()}
    plots = setup_plots(own, session, poses, {one.name: one for one in estimates}) | plots
    return Identification(recording, session, base, tuple(estimates), plots, correlations)


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
