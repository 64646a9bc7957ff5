"""Logs that cost a tenth of a second: floor plans, drives without physics, and odometry that may lie.

For tests that would wait too long for the simulator, or need a lidar, a floor or wheels that it has not. Rays
are cast by it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.known_logs import Known, integrate, known
from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.types import LidarSpec, Recording, Trajectory
from turtlebag.sim.raycast import cast, distance_to_point
from turtlebag.sim.shapes import box

CELL, DT = 0.05, 0.02
NOBODY = np.empty((0, 3))


class FloorPlan:
    """Free space carved out of solid in 5 cm cells, with boxes and pillars put back."""

    def __init__(self, width: float, height: float) -> None:
        self.solid = np.ones((round(height / CELL), round(width / CELL)), dtype=bool)
        self._circles: list[tuple[float, float, float]] = []
        self._loose: list[Array] = []

    def carve(self, x0: float, y0: float, x1: float, y1: float) -> None:
        """Make a rectangle free."""
        self.solid[_cells(y0, y1), _cells(x0, x1)] = False

    def box(self, x0: float, y0: float, x1: float, y1: float) -> None:
        """Make a rectangle solid."""
        self.solid[_cells(y0, y1), _cells(x0, x1)] = True

    def pillar(self, x: float, y: float, radius: float) -> None:
        """A round obstacle."""
        self._circles.append((x, y, radius))

    def turned_box(self, x: float, y: float, length: float, width: float, yaw: float) -> None:
        """A box at any angle."""
        self._loose.append(box("", (x, y), (length, width), yaw, (0.0, 1.0)).outline(0.0, 0.0)[0])

    def outlines(self) -> tuple[Array, Array]:
        """Segments (n, 4) and circles (m, 3), as rays are cast through."""
        walls = [_edges(self.solid), _edges(self.solid.T)[:, [1, 0, 3, 2]]]
        return np.vstack([*walls, *self._loose]), np.array(self._circles, dtype=float).reshape(-1, 3)

    def clearance(self, xy: Array) -> Array:
        """Distance from points (n, 2) to the nearest outline, (n,) [m]."""
        segments, circles = self.outlines()
        return np.array([distance_to_point(x, y, segments, circles) for x, y in xy])


def _cells(a: float, b: float) -> slice:
    return slice(round(a / CELL), round(b / CELL))


def _edges(solid: NDArray[np.bool_]) -> Array:
    """Boundaries between rows of cells as long segments, (n, 4)."""
    change = np.pad(solid[1:] != solid[:-1], ((0, 0), (1, 1)))
    # Of each row, columns where a run begins and ends in turn.
    row, flip = np.nonzero(change[:, 1:] != change[:, :-1])
    y = (row[::2] + 1) * CELL
    return np.stack([flip[::2] * CELL, y, flip[1::2] * CELL, y], axis=1)


@dataclass(frozen=True)
class Drive:
    """How a route is driven: speeds [m/s, rad/s], accelerations, pure-pursuit distance [m]."""

    v: float = 0.5
    w: float = 0.9
    dv: float = 0.6
    dw: float = 2.0
    ahead: float = 0.5


@dataclass(frozen=True)
class Wheels:
    """Errors of odometry: of scale (share), of turn (share), drift of yaw [rad/m], noise [per sqrt m]."""

    scale: float = 0.01
    turn: float = 0.02
    bias: float = 0.001
    noise_m: float = 0.004
    noise_rad: float = 0.003


@dataclass(frozen=True)
class Lie:
    """Odometry of the interval [start, start + length) s is `kind`: reverse, freeze, slip, spin, jump."""

    kind: str
    start: float
    length: float


@dataclass(frozen=True)
class Sensor:
    """Lidar with its noise: sigma [m], quantum [m], shares of lost and of mixed beams."""

    spec: LidarSpec
    period: float
    T_base_lidar: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sigma: float = 0.01
    quantum: float = 0.01
    lost: float = 0.005
    mixed: float = 0.3


def sick(beams: int = 180, range_max: float = 80.0) -> LidarSpec:
    """Half a circle, as the public CARMEN logs have it."""
    step = math.pi / (180 if beams in (180, 181) else 360)
    return LidarSpec(beams, -math.pi / 2, step, 0.0, range_max)


def lds(turning: bool = True) -> LidarSpec:
    """TurtleBot3's lidar."""
    step = math.radians(1.0)
    return LidarSpec(360, 0.0, step, 0.12, 3.5, 0.2 / 360 if turning else 0.0, 0.2)


def make_log(
    name: str,
    plan: FloorPlan,
    route: Array,
    sensor: Sensor,
    *,
    drive: Drive = Drive(),
    wheels: Wheels = Wheels(),
    lies: tuple[Lie, ...] = (),
    seed: int = 1,
    person: bool = False,
    pace: float = 0.0,
) -> Known:
    """Drive the route (n, 2) and record it; the reference is in the frame of the floor plan.

    `pace` > 0 stops for that many seconds at the route's start.
    """
    poses = follow(np.asarray(route, dtype=float), drive, pace)
    room = plan.clearance(poses[::10, :2])
    if room.min() < 0.15:
        at = poses[::10][room.argmin()]
        raise ValueError(f"{name}: the route touches a wall near {at.round(2)}")
    rng = stream(seed, name)
    odometry = drifted(poses, wheels, lies, rng)
    sweep = abs(sensor.spec.time_increment) * sensor.spec.n_beams
    times = np.arange(0.0, (len(poses) - 2) * DT - sweep, sensor.period)
    jitter = 0.02 * sensor.period if sensor.spec.time_increment == 0.0 else 0.0
    times = np.abs(times + rng.normal(0.0, jitter, len(times)) if jitter else times)
    ranges = measure(plan, poses, times, sensor, rng, person)
    stamps = np.round((times + 100.0) * 1e9).astype(np.int64)
    T_odom_base, T_world_base = at_times(odometry, times), at_times(poses, times)
    stream_30hz = None
    if sensor.spec.time_increment != 0.0:
        t = np.arange(0.0, (len(poses) - 1) * DT, 1.0 / 30.0)
        stream_30hz = Trajectory(np.round((t + 100.0) * 1e9).astype(np.int64), at_times(odometry, t))
    recording = Recording(
        source=name, stamps_ns=stamps, ranges=ranges, lidar=sensor.spec,
        T_base_lidar=SE2(np.array(sensor.T_base_lidar)), T_odom_base=T_odom_base, odometry=stream_30hz,
    )  # fmt: skip
    return known(recording, T_world_base)


def at_times(poses: Array, times: Array) -> SE2:
    """Poses (n, 3) at steps of DT, interpolated."""
    k = np.minimum((times / DT).astype(int), len(poses) - 2)
    return SE2.from_array(poses[k]).interpolate(SE2.from_array(poses[k + 1]), times / DT - k)


def follow(route: Array, drive: Drive, pace: float = 0.0) -> Array:
    """True poses (n, 3) at steps of DT along a polyline, by pure pursuit."""
    driven = _pursue(points_along(route, 0.02), drive.v, drive.w, drive.dv, drive.dw, drive.ahead)
    return np.concatenate([np.repeat(driven[:1], round(pace / DT), axis=0), driven])


def points_along(route: Array, step: float) -> Array:
    """Points (m, 2) every so many metres along a polyline (n, 2)."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(route, axis=0), axis=1))])
    s = np.arange(0.0, length[-1], step)
    return np.stack([np.interp(s, length, route[:, 0]), np.interp(s, length, route[:, 1])], axis=1)


@njit(cache=True)
def _pursue(path: Array, v_max: float, w_max: float, dv: float, dw: float, ahead: float) -> Array:
    out = np.empty((40 * len(path), 3))
    x, y = path[0]
    yaw = math.atan2(path[5, 1] - y, path[5, 0] - x)
    v, w, k, n = 0.0, 0.0, 0, 0
    while n < len(out):
        out[n, 0], out[n, 1], out[n, 2] = x, y, yaw
        n += 1
        while k < len(path) - 1 and math.hypot(path[k, 0] - x, path[k, 1] - y) < ahead:
            k += 1
        left = math.hypot(path[-1, 0] - x, path[-1, 1] - y)
        if k == len(path) - 1 and left < 0.08:
            break
        e = math.atan2(path[k, 1] - y, path[k, 0] - x) - yaw
        e = (e + math.pi) % (2.0 * math.pi) - math.pi
        want_w = min(max(2.5 * e, -w_max), w_max)
        want_v = v_max * math.cos(e) ** 2 if abs(e) < 0.9 else 0.0
        if k == len(path) - 1:
            want_v = min(want_v, left)
        v += min(max(want_v - v, -dv * DT), dv * DT)
        w += min(max(want_w - w, -dw * DT), dw * DT)
        yaw += 0.5 * w * DT
        x += v * DT * math.cos(yaw)
        y += v * DT * math.sin(yaw)
        yaw += 0.5 * w * DT
    return out[:n]


def drifted(poses: Array, wheels: Wheels, lies: tuple[Lie, ...], rng: np.random.Generator) -> Array:
    """Odometry (n, 3) of true poses (n, 3), starting at the first of them."""
    moved = SE2.from_array(poses).steps()
    distance = np.hypot(moved[:, 0], moved[:, 1])
    root = np.sqrt(distance + 0.2 * np.abs(moved[:, 2]))
    seen = moved.copy()
    seen[:, :2] *= 1.0 + wheels.scale
    seen[:, 0] += wheels.noise_m * root * rng.standard_normal(len(moved))
    seen[:, 2] = seen[:, 2] * (1.0 + wheels.turn) + wheels.bias * distance
    seen[:, 2] += wheels.noise_rad * root * rng.standard_normal(len(moved))
    held = np.zeros(len(moved), dtype=bool)
    for lie in lies:
        part = slice(round(lie.start / DT), round((lie.start + lie.length) / DT))
        if lie.kind == "reverse":
            seen[part, 0] *= -1.0
        elif lie.kind == "slip":
            seen[part, 0] += 0.3 * DT
        elif lie.kind == "spin":
            seen[part, 2] += 0.25 * DT
        elif lie.kind == "freeze":
            held[part] = True
        elif lie.kind == "jump":
            seen[part.start] += (1.5, 0.5, 0.8)
        else:
            raise ValueError(f"no such lie: {lie.kind}")
    out = integrate(poses[0], seen)
    # While frozen the last value is repeated; afterwards the odometry is right again, at once.
    index = np.where(np.concatenate([[False], held]), 0, np.arange(len(out)))
    return out[np.maximum.accumulate(index)]


def measure(
    plan: FloorPlan, poses: Array, times: Array, sensor: Sensor, rng: np.random.Generator, person: bool
) -> NDArray[np.float32]:
    """Ranges (n_scans, n_beams) as a driver would hand them on."""
    spec = sensor.spec
    when = times[:, None] + abs(spec.time_increment) * spec.order
    T_world_lidar = at_times(poses, when) @ SE2(np.array(sensor.T_base_lidar))
    angles = T_world_lidar.yaw + spec.angles
    ways, turned = np.stack([np.cos(angles), np.sin(angles)], axis=-1), np.unwrap(angles)
    segments, circles = plan.outlines()
    out = np.empty(when.shape)
    for k, at in enumerate(np.ascontiguousarray(T_world_lidar.xy)):
        legs = _legs(T_world_lidar[k, 0], times[k]) if person else NOBODY
        outlines = segments, np.vstack([circles, legs])
        out[k], _ = cast(at, ways[k], turned[k], outlines, spec.range_max + 3.0)
    neighbour = np.roll(out, -1, axis=1)
    blend = rng.random(out.shape)
    with np.errstate(invalid="ignore"):
        mixed = (np.abs(neighbour - out) > 0.3) & (neighbour < spec.range_max) & (out < spec.range_max)
        mixed &= rng.random(out.shape) < sensor.mixed
        out = np.where(mixed, blend * out + (1.0 - blend) * neighbour, out)
    out = out + sensor.sigma * rng.standard_normal(out.shape)
    if sensor.quantum > 0.0:
        out = np.round(out / sensor.quantum) * sensor.quantum
    out = np.where((out > spec.range_max) | (rng.random(out.shape) < sensor.lost), np.inf, out)
    return np.where(out < spec.range_min, -np.inf, out).astype(np.float32)


def _legs(T_world_lidar: SE2, t: float) -> Array:
    """Two legs, circles (2, 3), that walk with the robot for 10 of every 20 s, weaving in front of it."""
    if t % 20.0 >= 10.0:
        return NOBODY
    bearing, reach = 0.9 * math.sin(0.9 * t), 1.4 + 0.5 * math.sin(0.37 * t)
    side = np.array([-1.0, 1.0])
    ahead = reach * math.cos(bearing) + 0.15 * side * math.sin(5.0 * t)
    legs = T_world_lidar @ np.stack([ahead, reach * math.sin(bearing) + 0.12 * side], axis=-1)
    return np.column_stack([legs, [0.08, 0.08]])
