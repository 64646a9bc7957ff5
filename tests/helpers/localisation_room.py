"""A room with known walls, an analytic lidar in it, and a drive through it with drifting odometry."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy

from tests.helpers.exact_rays import ranges_to, rectangle
from turtlebag.datasets.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import LidarSpec, Scan

LIDAR = LidarSpec(360, 0.0, math.radians(1.0), 0.12, 3.5, time_increment=0.2 / 360, scan_time=0.2)
STILL_LIDAR = LidarSpec(360, 0.0, math.radians(1.0), 0.12, 3.5)
T_BASE_LIDAR = SE2.from_xyt(-0.032, 0.0, 0.0)
DT = 1.0 / 30.0


@dataclass(frozen=True)
class Room:
    """Wall segments (n, 4): x0, y0, x1, y1 [m]; a point known to be inside."""

    walls: Array
    inside: tuple[float, float]

    def ranges(self, T_room_lidar: SE2, angles: Array, range_max: float) -> Array:
        """Exact range of each beam; T_room_lidar is one pose or one a beam; inf beyond range_max."""
        return ranges_to(self.walls, T_room_lidar, angles, range_max)

    def grid(self, resolution: float = 0.05, margin: float = 0.5) -> OccupancyGrid:
        """Cells crossed by a wall are occupied, those connected to `inside` free, the rest unknown."""
        from scipy.ndimage import label

        x0, y0 = np.floor((self.walls.reshape(-1, 2).min(axis=0) - margin) / resolution) * resolution
        x1, y1 = self.walls.reshape(-1, 2).max(axis=0) + margin
        shape = math.ceil((y1 - y0) / resolution), math.ceil((x1 - x0) / resolution)
        grid = OccupancyGrid(np.full(shape, UNKNOWN, dtype=np.int8), resolution, SE2.from_xyt(x0, y0, 0.0))
        for ax, ay, bx, by in self.walls:
            n = math.ceil(math.hypot(bx - ax, by - ay) / resolution * 20) + 1
            points = np.stack([np.linspace(ax, bx, n), np.linspace(ay, by, n)], axis=-1)
            rows, cols = grid.cell_of(points).T
            grid.cells[rows, cols] = OCCUPIED
        regions, _ = label(grid.cells != OCCUPIED)
        row, col = grid.cell_of(np.array(self.inside))
        grid.cells[regions == regions[row, col]] = FREE
        return grid


def l_shaped_room() -> Room:
    """5 x 4 m with a slanted corner, a cupboard and a pillar; walls off cell centres to either side."""
    outline = [(0.013, 0.027), (5.041, 0.027), (5.041, 2.6), (3.9, 4.018), (0.013, 4.018)]
    walls = [[*a, *b] for a, b in zip(outline, outline[1:] + outline[:1], strict=True)]
    cupboard, pillar = rectangle(0.013, 3.04, 1.135, 4.018), rectangle(3.21, 0.915, 3.49, 1.19)
    return Room(np.vstack([walls, cupboard, pillar]), (2.0, 2.0))


@dataclass(frozen=True)
class Step:
    """One scan of a drive with the odometry at its start and end; truth beside it."""

    scan: Scan
    T_odom_base: SE2
    T_odom_base_end: SE2
    T_room_base: SE2


def drive(
    room: Room,
    waypoints: list[tuple[float, float]],
    rng: np.random.Generator,
    lidar: LidarSpec = LIDAR,
    noise: float = 0.01,
) -> list[Step]:
    """Turn towards each waypoint, drive straight to it; odometry is off by percents in scale and turn."""
    true = _path(waypoints)
    delta = true.steps()
    delta[:, 0] *= 1.02
    delta[:, 2] = delta[:, 2] * 0.985 + 0.01 * delta[:, 0] + 1e-4 * rng.standard_normal(len(delta))
    odometry = [true[0]]
    for row in delta:
        odometry.append(odometry[-1] @ SE2(row))
    steps, per_scan = [], 6
    for k in range(0, len(true) - per_scan, per_scan):
        turn = np.arange(lidar.n_beams) / lidar.n_beams * per_scan * (lidar.time_increment > 0.0)
        low = turn.astype(int)
        T_room_base = true[k + low].interpolate(true[k + low + 1], turn - low)
        ranges = room.ranges(T_room_base @ SE2(T_BASE_LIDAR.xyt[None]), lidar.angles, lidar.range_max)
        noisy = np.where(np.isfinite(ranges), ranges + noise * rng.standard_normal(len(ranges)), ranges)
        scan = Scan(round(k * DT * 1e9), noisy.astype(np.float32), lidar)
        steps.append(Step(scan, odometry[k], odometry[k + per_scan], true[k]))
    return steps


def _path(waypoints: list[tuple[float, float]], v: float = 0.2, w: float = 0.8) -> SE2:
    (x, y), yaw = waypoints[0], 0.0
    poses = [(x, y, yaw)]
    for goal_x, goal_y in waypoints[1:]:
        turn = (math.atan2(goal_y - y, goal_x - x) - yaw + math.pi) % (2.0 * math.pi) - math.pi
        count = max(1, int(abs(turn) / w / DT))
        poses += [(x, y, yaw + turn * (i + 1) / count) for i in range(count)]
        yaw += turn
        count = max(1, int(math.hypot(goal_x - x, goal_y - y) / v / DT))
        poses += [
            (x + (goal_x - x) * (i + 1) / count, y + (goal_y - y) * (i + 1) / count, yaw)
            for i in range(count)
        ]
        x, y = goal_x, goal_y
    return SE2.from_array(poses)


def sampled(field, points_map):
    """Distance of a field at points (..., 2) of the map, interpolated; beyond it, that of its border."""
    xy = (field.T_map_field.inverse() @ np.asarray(points_map, dtype=float)) / field.resolution
    table, at = field.distance.astype(float), xy.reshape(-1, 2)[:, ::-1].T
    found = scipy.ndimage.map_coordinates(table, at, order=1, cval=field.distance[0, 0])
    return found.reshape(xy.shape[:-1])
