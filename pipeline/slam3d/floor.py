"""Height and tilt of a lidar above the floor, from its own clouds, for bags without its mounting."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from turtlebag.datasets.se2 import Array
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.types import NOTHING_M

MAX_TILT_RAD = 0.5
NEAR_M = 0.05
"""Points this near to a plane belong to it."""
SECTORS, RINGS = 36, 6
MIN_SHARE, MAX_BELOW = 0.35, 0.08
"""Of the lowest points all around: how many lie in the floor, and how many may lie below."""
TRIES = 600


@dataclass(frozen=True, eq=False)
class Floor:
    """The plane `normal . p + height = 0`: unit normal (3,) upwards, height of the sensor over it [m]."""

    normal: Array
    height: float


def find_floor(points: Array, reach_m: float) -> Floor | None:
    """The plane below points (n, 3) of an upright sensor's frame, within `reach_m`; None without one.

    RANSAC (Fischler and Bolles 1981) among planes tilted by less than 29 degrees, on the lowest point of
    each direction and distance: a floor goes all around and has nothing below. Refined by least squares.
    """
    reach = np.hypot(points[:, 0], points[:, 1])
    points, reach = points[reach <= reach_m], reach[reach <= reach_m]
    lowest = _lowest(points, reach, reach_m)
    if len(lowest) < 12:
        return None
    corners = lowest[stream(0, "floor").integers(0, len(lowest), size=(TRIES, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.maximum(np.linalg.norm(normals, axis=1), NOTHING_M) * np.where(
        normals[:, 2] < 0.0, -1.0, 1.0
    )
    normals /= lengths[:, None]
    heights = -np.einsum("ij,ij->i", normals, corners[:, 0])
    over = normals @ lowest.T + heights[:, None]
    inside = np.count_nonzero(np.abs(over) < NEAR_M, axis=1)
    below = np.count_nonzero(over < -2.0 * NEAR_M, axis=1)
    upright = normals[:, 2] >= np.cos(MAX_TILT_RAD)
    floors = upright & (inside > MIN_SHARE * len(lowest)) & (below <= MAX_BELOW * len(lowest))
    best = int(np.argmax(np.where(floors, inside, -1)))
    return _refined(points, np.array([*normals[best], heights[best]])) if floors[best] else None


def _lowest(points: Array, reach: Array, reach_m: float) -> Array:
    """The lowest point in each sector and ring around the sensor, (n, 3)."""
    sector = np.floor((np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) + 0.5) * SECTORS).astype(int)
    cell = np.minimum(sector, SECTORS - 1) * RINGS + np.minimum(reach / reach_m * RINGS, RINGS - 1).astype(
        int
    )
    order = np.lexsort((points[:, 2], cell))
    return points[order[np.unique(cell[order], return_index=True)[1]]]


def _refined(points: Array, plane: Array) -> Floor:
    for _ in range(4):
        inliers = points[np.abs(points @ plane[:3] + plane[3]) < NEAR_M]
        mean = inliers.mean(axis=0)
        normal = np.linalg.eigh(np.cov((inliers - mean).T))[1][:, 0]
        normal = normal * (1.0 if normal[2] >= 0.0 else -1.0)
        plane = np.array([*normal, -normal @ mean])
    return Floor(plane[:3], float(plane[3]))


def levelled(floor: Floor) -> Array:
    """`T_base_sensor` (4, 4) of a base on the floor below the sensor, upright, heading as the sensor."""
    z = floor.normal
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.stack([x, np.cross(z, x), z])
    T[2, 3] = floor.height
    return T
