"""3D lidar logs with exact truth: a simulated robot that goes once round a world of `benchmarks/worlds`."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from turtlebag.datasets.types import Cloud, Recording3D, Trajectory
from turtlebag.pipeline.navigation.recorder import trajectory_of
from turtlebag.sim.faults import FaultConfig
from turtlebag.sim.robots import load_robot
from turtlebag.sim.simulator import SimConfig, Simulator
from turtlebag.sim.teleop_scripts import Script, Step, commands
from turtlebag.sim.worlds import load_world

WORLDS = Path(__file__).parents[2] / "benchmarks/worlds"
VEERING = SimConfig(sensors="clean", faults=FaultConfig(slip=((0.0, 9999.0, 0.01, 0.018),)))
"""One wheel turns in vain a little more than the other, all the way: odometry is off by metres in the end."""


@dataclass(frozen=True, eq=False)
class Drive3d:
    """A log and the true poses of its clouds."""

    recording: Recording3D
    truth: Trajectory


def make_drive(world: str, *, v: float = 0.5, w: float = 1.0, n_azimuths: int = 360) -> Drive3d:
    """Drive the route `round` of a world; odometry and truth start at the origin, heading along x."""
    place, robot = load_world(str(WORLDS / f"{world}.yaml")), load_robot("waffle_pi_3d")
    mount = robot.lidar3d
    assert mount is not None
    robot = robot.model_copy(
        update={
            "limits": robot.limits.model_copy(update={"max_v": v}),
            "lidar3d": mount.model_copy(update={"n_azimuths": n_azimuths}),
        }
    )
    steps = [Step(wait=1.0), Step(through=place.routes["round"].tolist())]
    driver = commands(Script(name="round", v=v, w=w, steps=steps), place, robot, 1)
    odometry, truth, found = [], [], []
    with Simulator(place, robot, VEERING, 1) as simulator, suppress(StopIteration):
        seen = simulator.reset()
        next(driver)
        while True:
            odometry.append((seen.stamp_ns, seen.odometry.T_odom_base))
            truth.append((seen.stamp_ns, simulator.truth.T_world_base))
            found += [] if seen.cloud is None else [seen.cloud]
            seen = simulator.step(driver.send(simulator.truth))
    stamps = np.array([stamp for stamp, _ in found])
    driven, true = (_from_its_start(trajectory_of(poses)) for poses in (odometry, truth))
    T_base_lidar = np.eye(4)
    T_base_lidar[:3, 3] = mount.position
    clouds = tuple(cloud for _, cloud in found)
    recording = Recording3D("drive", stamps, clouds, T_base_lidar, True, driven.at(stamps), driven)
    return Drive3d(recording, Trajectory(stamps, true.at(stamps)))


def _from_its_start(driven: Trajectory) -> Trajectory:
    return Trajectory(driven.stamps_ns, driven.poses[0].inverse() @ driven.poses)


def changed(drive: Drive3d, change: Callable[[int, Cloud], Cloud | None]) -> Drive3d:
    """The drive with each cloud changed, or left out where `change` gives None."""
    recording = drive.recording
    clouds = [change(k, cloud) for k, cloud in enumerate(recording.clouds)]
    kept = np.array([k for k, cloud in enumerate(clouds) if cloud is not None])
    T_odom = recording.T_odom_base
    return Drive3d(
        replace(
            recording,
            stamps_ns=recording.stamps_ns[kept],
            clouds=tuple(cloud for cloud in clouds if cloud is not None),
            T_odom_base=None if T_odom is None else T_odom[kept],
        ),
        Trajectory(drive.truth.stamps_ns[kept], drive.truth.poses[kept]),
    )


def without_wheels(drive: Drive3d) -> Drive3d:
    """The clouds alone."""
    return Drive3d(replace(drive.recording, T_odom_base=None, odometry=None), drive.truth)
