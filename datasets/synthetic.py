"""Logs of analytic worlds: walls as line segments, exact ranges, odometry that errs as it is told to.

For tests and benchmarks that need a truth no physics engine stands behind, and situations no
simulator offers: corridors without end, wheels that slip, clocks that jump.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from datasets.se2 import SE2, Array
from datasets.seeds import stream
from datasets.types import LidarSpec, Recording, Trajectory

SICK = LidarSpec(180, -math.pi / 2, math.pi / 180.0, 0.05, 30.0)
LDS = LidarSpec(360, 0.0, math.pi / 180.0, 0.12, 3.5)


@dataclass(frozen=True)
class OdometryError:
    """How the simulated wheels err, per step driven: scale, turn bias [rad/m], and noise shares."""

    scale: float = 0.01
    bias_rad_per_m: float = 0.004
    noise: float = 0.02
    turn_noise: float = 0.02


def rectangle(x0: float, y0: float, x1: float, y1: float) -> Array:
    """Four walls, (4, 4) as (xa, ya, xb, yb)."""
    return np.array([[x0, y0, x1, y0], [x1, y0, x1, y1], [x1, y1, x0, y1], [x0, y1, x0, y0]])


def corridor_ring(length: float = 20.0, width: float = 14.0, corridor: float = 2.0) -> tuple[Array, Array]:
    """Walls of a closed ring of bare corridors, and the way round along its middle, (n, 2)."""
    walls = np.vstack(
        [
            rectangle(0.0, 0.0, length, width),
            rectangle(corridor, corridor, length - corridor, width - corridor),
        ]
    )
    m = corridor / 2.0
    way = np.array([[m, m], [length - m, m], [length - m, width - m], [m, width - m], [m, m]])
    return walls, way


def drive(way: Array, *, laps: int = 1, v: float = 0.5, w: float = 0.8, rate_hz: float = 5.0) -> SE2:
    """True poses (n,) of a robot that turns on the spot, then drives straight, along a polyline (n, 2)."""
    points = np.vstack([way[:-1]] * laps + [way[-1:]])
    legs = np.diff(points, axis=0)
    headings = np.unwrap(np.arctan2(legs[:, 1], legs[:, 0]))
    poses = [np.array([*points[0], headings[0]])]
    for start, leg, heading in zip(points[:-1], legs, headings, strict=True):
        turn = heading - poses[-1][2]
        n = math.ceil(abs(turn) / w * rate_hz)
        poses += [np.array([*start, poses[-1][2] + turn * k / n]) for k in range(1, n + 1)]
        length = float(np.hypot(*leg))
        n = max(1, math.ceil(length / v * rate_hz))
        poses += [np.array([*(start + leg * k / n), heading]) for k in range(1, n + 1)]
    return SE2.from_array(np.array(poses))


def ranges_to(walls: Array, T_world_lidar: SE2, lidar: LidarSpec) -> Array:
    """Exact ranges (n, beams) from poses (n,) to segments (m, 4); inf beyond the lidar's range."""
    a, d = walls[:, :2], walls[:, 2:] - walls[:, :2]
    out = np.full((len(T_world_lidar), lidar.n_beams), np.inf)
    for k, (x, y, yaw) in enumerate(T_world_lidar.xyt):
        u = np.stack([np.cos(yaw + lidar.angles), np.sin(yaw + lidar.angles)], axis=1)
        o = a - np.array([x, y])
        cross = u[:, None, 0] * d[None, :, 1] - u[:, None, 1] * d[None, :, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            r = (o[None, :, 0] * d[None, :, 1] - o[None, :, 1] * d[None, :, 0]) / cross
            along = (o[None, :, 0] * u[:, None, 1] - o[None, :, 1] * u[:, None, 0]) / cross
        hit = (r > 0.0) & (along >= 0.0) & (along <= 1.0)
        out[k] = np.where(hit, r, np.inf).min(axis=1)
    out[out > lidar.range_max] = np.inf
    return out


def make_log(
    walls: Array,
    T_world_base: SE2,
    *,
    lidar: LidarSpec = SICK,
    seed: int = 1,
    range_noise: float = 0.01,
    error: OdometryError | None = None,
    rate_hz: float = 5.0,
) -> tuple[Recording, Trajectory]:
    """A recording of instantaneous scans along true poses (n,), and the truth; odometry starts true."""
    error = error if error is not None else OdometryError()
    rng = stream(seed, "synthetic log")
    exact = ranges_to(walls, T_world_base, lidar)
    ranges = exact + rng.normal(0.0, range_noise, exact.shape)
    ranges = np.where(ranges > lidar.range_max, np.inf, np.maximum(ranges, 0.0))
    odometry = err(T_world_base, error, rng)
    stamps = np.round(np.arange(len(T_world_base)) * 1e9 / rate_hz).astype(np.int64) + 10**9
    recording = Recording("synthetic", stamps, ranges.astype(np.float32), lidar, SE2.identity(), odometry)
    return recording, Trajectory(stamps, T_world_base)


def err(T_world_base: SE2, error: OdometryError, rng: np.random.Generator) -> SE2:
    """Odometry poses (n,) of a true path."""
    steps = (T_world_base[:-1].inverse() @ T_world_base[1:]).xyt.copy()
    distance = np.hypot(steps[:, 0], steps[:, 1])
    n = len(steps)
    steps[:, :2] *= 1.0 + error.scale + error.noise * rng.normal(size=(n, 1))
    steps[:, 2] *= 1.0 + error.turn_noise * rng.normal(size=n)
    steps[:, 2] += error.bias_rad_per_m * distance * (1.0 + 0.5 * rng.normal(size=n))
    poses = [T_world_base.xyt[0]]
    for step in steps:
        poses.append((SE2(poses[-1]) @ SE2(step)).xyt)
    return SE2.from_array(np.array(poses))
