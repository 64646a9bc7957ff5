"""The 3D map as one point cloud (the mean of the points in each small voxel), and its file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.open3d_loader import open3d
from turtlebag.datasets.ply import write_ply
from turtlebag.datasets.se2 import Array

FRINGE = 2.5
"""A voxel with this many times the points of its neighbour is the surface, the neighbour its fringe."""
LIMIT = 1 << 20
"""Voxels on each side of the origin along an axis."""
MIN_POINTS, NEIGHBOURS, OUTLIER = 3, 12, 3.0
"""Voxels with fewer points are noise or passed by once; Open3D's statistical outlier removal: its neighbours,
and its width in standard deviations."""
AT_ONCE = 2_000_000
"""Points that wait to be summed."""
MOST_VOXELS = 8_000_000
"""Bounds the memory; the voxel grows beyond."""


class CloudMap:
    """Voxel means of any number of points, in memory that grows with the map and not with the log."""

    def __init__(self, voxel: float, max_voxels: int = MOST_VOXELS, at_once: int = AT_ONCE) -> None:
        self.voxel, self._most, self._at_once = voxel, max_voxels, at_once
        self._sums = np.zeros((0, 4))
        self._waiting: list[Array] = []

    def add(self, points: Array) -> None:
        """Gather points (n, 3) of the map."""
        self._waiting.append(points)
        if sum(map(len, self._waiting)) > self._at_once:
            self._gather()

    def points(self) -> tuple[Array, Array]:
        """Means (m, 3) of the voxels and their counts (m,), in voxel order."""
        self._gather()
        return self._sums[:, :3] / self._sums[:, 3:], self._sums[:, 3]

    def surface(self, least: int) -> Array:
        """Means (m, 3) of the voxels with at least so many points that are no fringe of another's.

        Noise carries some points of a surface over the border of a voxel; a voxel beside one with far more
        points, and near to its mean, would be the surface drawn twice.
        """
        means, counts = self.points()
        keys = self._keys(means)
        fringe = np.zeros(len(keys), dtype=np.bool_)
        for stride in (1, 2 * LIMIT, 4 * LIMIT * LIMIT):
            for step in (-stride, stride):
                beside = np.minimum(np.searchsorted(keys, keys + step), len(keys) - 1)
                near = np.linalg.norm(means[beside] - means, axis=1) < self.voxel
                fringe |= (keys[beside] == keys + step) & near & (counts[beside] > FRINGE * counts)
        return means[(counts >= least) & ~fringe]

    def _gather(self) -> None:
        """Add what is waiting to the sums over voxels: x, y, z and the count (m, 4)."""
        waiting = [np.column_stack([points, np.ones(len(points))]) for points in self._waiting]
        self._sums, self._waiting = self._summed(np.vstack([self._sums, *waiting])), []
        while len(self._sums) > self._most:
            self.voxel *= 2.0
            self._sums = self._summed(self._sums)

    def _summed(self, sums: Array) -> Array:
        keys, voxels = np.unique(self._keys(sums[:, :3] / sums[:, 3:]), return_inverse=True)
        return np.column_stack([np.bincount(voxels, column, len(keys)) for column in sums.T])

    def _keys(self, points: Array) -> NDArray[np.int64]:
        cells = np.clip(np.floor(points / self.voxel) + LIMIT, 0, 2 * LIMIT - 1).astype(np.int64)
        return np.asarray((cells[:, 0] * 2 * LIMIT + cells[:, 1]) * 2 * LIMIT + cells[:, 2])


def finished(cloud: CloudMap) -> Array:
    """The points of the map (n, 3) without lone ones (Open3D's statistical outlier removal)."""
    points = cloud.surface(MIN_POINTS)
    if len(points) <= NEIGHBOURS:
        return points
    o3d = open3d()
    pointcloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    _, kept = pointcloud.remove_statistical_outlier(NEIGHBOURS, OUTLIER)
    return points[np.asarray(kept, dtype=np.int64)]


def save_ply(path: Path, points: Array) -> None:
    """Write points (n, 3) with colours by height."""
    write_ply(path, np.round(points, 4), height_colours(points[:, 2]))


def height_colours(z: Array) -> Array:
    """Colours (n, 3) from blue (low) over green to red (high), by the heights' own range."""
    if len(z) == 0:
        return np.zeros((0, 3))
    heights = np.percentile(z, [1.0, 50.0, 99.0])
    return np.stack([np.interp(z, heights, band) for band in np.eye(3)[::-1]], axis=-1)
