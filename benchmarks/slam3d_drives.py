"""3D lidar logs with exact truth, made without a bag: a path through solids, clouds, drifting wheels."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from turtlebag.datasets.se2 import SE2, Array, wrap
from turtlebag.datasets.types import Cloud, Recording3D, Trajectory
from turtlebag.sim.lidar3d import Lidar3d
from turtlebag.sim.robots import Lidar3dMount
from turtlebag.sim.shapes import Solid, box, cylinder

CONTROL_HZ, SCAN_HZ = 30, 5
STEPS = CONTROL_HZ // SCAN_HZ
WHEELS = (0.02, -0.03)
"""Errors of the wheels: of the way and, a metre driven, of the heading [rad]."""


@dataclass(frozen=True, eq=False)
class Drive3d:
    """A log and the true poses of its clouds."""

    recording: Recording3D
    truth: Trajectory


def mount(n_azimuths: int = 360) -> Lidar3dMount:
    """Sixteen rings, a third of a metre up."""
    return Lidar3dMount(
        position=(-0.06, 0.0, 0.36), n_rings=16, elevation_deg=(-15.0, 15.0), n_azimuths=n_azimuths,
        range_min=0.3, range_max=30.0, rate_hz=SCAN_HZ,
    )  # fmt: skip


def poses_along(corners: Sequence[tuple[float, float]], v: float, w: float) -> Array:
    """Poses (n, 3) at CONTROL_HZ: straight from corner to corner, turning on the spot, at rest at first."""
    xy = np.array(corners, dtype=np.float64)
    yaw = float(np.arctan2(*(xy[1] - xy[0])[::-1]))
    rows = [np.array([*xy[0], yaw])] * CONTROL_HZ
    for a, b in itertools.pairwise(xy):
        heading = float(np.arctan2(b[1] - a[1], b[0] - a[0]))
        turn = float(wrap(heading - yaw))
        n = int(np.ceil(abs(turn) / w * CONTROL_HZ))
        rows += [np.array([*a, yaw + turn * (k + 1) / n]) for k in range(n)]
        yaw = heading
        n = int(np.ceil(np.hypot(*(b - a)) / v * CONTROL_HZ))
        rows += [np.array([*(a + (b - a) * (k + 1) / n), yaw]) for k in range(n)]
    return np.array(rows)


def make_drive(
    solids: Sequence[Solid],
    corners: Sequence[tuple[float, float]],
    *,
    v: float = 0.5,
    w: float = 1.0,
    seed: int = 1,
    lidar: Lidar3dMount | None = None,
    wheels: tuple[float, float] | None = WHEELS,
) -> Drive3d:
    """Drive along the corners; the map frame of the truth starts at the first pose, heading along x."""
    lidar = lidar or mount()
    sensor = Lidar3d(solids, lidar, 0.01, np.random.default_rng(seed))
    poses = poses_along(corners, v, w)
    count = (len(poses) - 1) // STEPS
    clouds = tuple(sensor.measure(poses[k * STEPS : (k + 1) * STEPS + 1]) for k in range(count))
    T = SE2.from_array(poses)
    T = T[0].inverse() @ T
    stamps = np.round(np.arange(len(poses)) * 1e9 / CONTROL_HZ).astype(np.int64)
    odometry = Trajectory(stamps, _wheeled(T, *wheels)) if wheels is not None else None
    at = np.arange(count) * STEPS
    T_base_lidar = np.eye(4)
    T_base_lidar[:3, 3] = lidar.position
    recording = Recording3D(
        source="drive",
        stamps_ns=stamps[at],
        clouds=clouds,
        T_base_lidar=T_base_lidar,
        T_odom_base=None if odometry is None else odometry.poses[at],
        odometry=odometry,
    )
    return Drive3d(recording, Trajectory(stamps[at], T[at]))


def _wheeled(T: SE2, scale: float, veer: float) -> SE2:
    """What the wheels make of true poses."""
    steps = T.steps()
    steps[:, 2] += veer * np.hypot(steps[:, 0], steps[:, 1])
    steps[:, :2] *= 1.0 + scale
    rows = [SE2.identity()]
    for step in steps:
        rows.append(rows[-1] @ SE2.from_array(step))
    return SE2.stack(rows)


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


def walls(x: float, y: float, height: float) -> list[Solid]:
    """Four walls, 0.2 m thick, round a floor of x by y metres from the origin on."""
    return [
        *(box("", (0.5 * x, side), (x + 0.4, 0.2), 0.0, (0.0, height)) for side in (-0.1, y + 0.1)),
        *(box("", (side, 0.5 * y), (0.2, y + 0.4), 0.0, (0.0, height)) for side in (-0.1, x + 0.1)),
    ]


def room() -> list[Solid]:
    """Eight by six metres with pillars, a table, a lintel and a box that is higher than the band."""
    table = [
        cylinder(f"leg {k}", (3.6 + 0.8 * (k % 2), 2.6 + 0.8 * (k // 2)), 0.06, (0.0, 0.7)) for k in range(4)
    ]
    return [
        *walls(8.0, 6.0, 2.0),
        *table,
        box("top", (4.0, 3.0), (1.0, 1.0), 0.0, (0.7, 0.75)),
        cylinder("pillar", (6.5, 2.0), 0.3, (0.0, 1.5)),
        box("cupboard", (0.4, 5.2), (0.6, 1.2), 0.0, (0.0, 1.8)),
        box("beam", (4.0, 5.0), (8.0, 0.3), 0.0, (1.0, 1.3)),
    ]  # fmt: skip


ROUND = [(1.5, 1.2), (5.5, 1.2), (7.3, 1.2), (7.3, 4.8), (1.5, 4.2), (1.5, 1.2), (4.0, 1.2)]
"""Once around the table of the room and a little on."""


def corridors(length: float = 14.0, width: float = 2.0) -> tuple[list[Solid], list[tuple[float, float]]]:
    """A square ring of bare corridors, and once around it and a little on: the place repeats four times,
    and along each leg only its ends tell where one is."""
    inner, middle = length - 2.0 * width, 0.5 * length
    core = box("core", (middle, middle), (inner, inner), 0.0, (0.0, 2.4))
    near, far = 0.5 * width, length - 0.5 * width
    path = [(near, near), (far, near), (far, far), (near, far), (near, near), (middle, near)]
    return [*walls(length, length, 2.4), core], path
