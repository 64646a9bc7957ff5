"""The map as one point cloud: the mean of all points in each small voxel, and its file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.ply import write_ply
from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.slam.open3d_loader import open3d

FREE_SLOT = np.int64(-1)
FRINGE = 2.5
"""A voxel with so many times the points of its neighbour is the surface, the neighbour its fringe."""
LIMIT = 1 << 20
"""Voxels on each side of the origin along an axis."""


class CloudMapConfig(BaseModel):
    """map.ply."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    voxel_m: float | None = Field(default=None, gt=0.0, description="one point each; by default from the log")
    min_points: int = Field(default=3, ge=1, description="voxels with fewer are noise, or passed by once")
    outlier_neighbours: int = Field(default=12, gt=0, description="of Open3D's statistical outlier removal")
    outlier_ratio: float = Field(default=3.0, gt=0.0, description="its width, in standard deviations")
    max_voxels: int = Field(default=8_000_000, gt=0, description="bounds the memory; the voxel grows beyond")


class CloudMap:
    """Voxel means of any number of points, in memory that grows with the map and not with the log."""

    def __init__(self, voxel: float, max_voxels: int) -> None:
        self.voxel, self._most = voxel, max_voxels
        self._count = 0
        self._keys, self._sums = _table(1 << 16)

    def add(self, points: Array) -> None:
        """Gather points (n, 3) of the map."""
        while self._count + len(points) > len(self._keys) // 2:
            self._grow()
        self._count += gather(points, np.ones(len(points)), self.voxel, self._keys, self._sums)
        while self._count > self._most:
            self._coarsen()

    def points(self) -> tuple[Array, Array]:
        """Means (m, 3) of the voxels and their counts (m,), in voxel order."""
        _, means, counts = self._voxels()
        return means, counts

    def surface(self, least: int) -> Array:
        """Means (m, 3) of the voxels with at least so many points that are no fringe of another's.

        Noise carries some points of a surface over the border of a voxel; a voxel beside one with far more
        points, and near to its mean, would be the surface drawn twice.
        """
        keys, means, counts = self._voxels()
        fringe = np.zeros(len(keys), dtype=np.bool_)
        for stride in (1, 2 * LIMIT, 4 * LIMIT * LIMIT):
            for step in (-stride, stride):
                beside = np.minimum(np.searchsorted(keys, keys + step), len(keys) - 1)
                near = np.linalg.norm(means[beside] - means, axis=1) < 0.8 * self.voxel
                fringe |= (keys[beside] == keys + step) & near & (counts[beside] > FRINGE * counts)
        return means[(counts >= least) & ~fringe]

    def _voxels(self) -> tuple[NDArray[np.int64], Array, Array]:
        filled = np.flatnonzero(self._keys != FREE_SLOT)
        order = filled[np.argsort(self._keys[filled], kind="stable")]
        counts = self._sums[order, 3]
        return self._keys[order], self._sums[order, :3] / counts[:, None], counts

    def _grow(self) -> None:
        means, counts = self.points()
        self._keys, self._sums = _table(2 * len(self._keys))
        self._count = gather(means, counts, self.voxel, self._keys, self._sums)

    def _coarsen(self) -> None:
        means, counts = self.points()
        self.voxel *= 1.5
        self._keys, self._sums = _table(len(self._keys))
        self._count = gather(means, counts, self.voxel, self._keys, self._sums)


def _table(slots: int) -> tuple[NDArray[np.int64], Array]:
    return np.full(slots, FREE_SLOT, dtype=np.int64), np.zeros((slots, 4))


@njit(cache=True)
def gather(points: Array, weights: Array, voxel: float, keys: NDArray, sums: Array) -> int:
    """Add weighted points (n, 3) to a hash table of voxels (open addressing); how many voxels are new.

    keys (slots,) int64, -1 where free; sums (slots, 4) of x, y, z and weight. Slots are a power of two.
    """
    mask, new = keys.shape[0] - 1, 0
    for i in range(points.shape[0]):
        key = np.int64(0)
        for a in range(3):
            cell = int(np.floor(points[i, a] / voxel)) + LIMIT
            key = key * (2 * LIMIT) + min(max(cell, 0), 2 * LIMIT - 1)
        h = (key ^ (key >> 29)) * np.int64(0x1E35A7BD1E35A7BD)
        slot = (h ^ (h >> 32)) & mask
        while keys[slot] != key and keys[slot] != -1:
            slot = (slot + 1) & mask
        if keys[slot] == -1:
            keys[slot] = key
            new += 1
        for a in range(3):
            sums[slot, a] += weights[i] * points[i, a]
        sums[slot, 3] += weights[i]
    return new


def finished(cloud: CloudMap, config: CloudMapConfig) -> Array:
    """The points of the map (n, 3) without lone ones (Open3D's statistical outlier removal)."""
    points = cloud.surface(config.min_points)
    if len(points) <= config.outlier_neighbours:
        return points
    o3d = open3d()
    pointcloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    _, kept = pointcloud.remove_statistical_outlier(config.outlier_neighbours, config.outlier_ratio)
    return points[np.asarray(kept, dtype=np.int64)]


def save_ply(path: Path, points: Array) -> None:
    """Write points (n, 3) with colours by height."""
    write_ply(path, np.round(points, 4), height_colours(points[:, 2]))


def height_colours(z: Array) -> Array:
    """Colours (n, 3) from blue (low) over green to red (high), by the heights' own range."""
    if len(z) == 0:
        return np.zeros((0, 3))
    low, high = np.percentile(z, [1.0, 99.0])
    f = np.clip((z - low) / max(high - low, 1e-6), 0.0, 1.0)
    bands = [np.clip(1.5 - np.abs(4.0 * f - k), 0.0, 1.0) for k in (3.0, 2.0, 1.0)]
    return np.stack(bands, axis=-1)
