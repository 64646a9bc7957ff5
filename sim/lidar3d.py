"""A turning 3D lidar: rings of beams at fixed elevations, through upright solids and onto the floor."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.se2 import Array
from datasets.types import Cloud
from sim.raycast import beam_rays
from sim.robots import Lidar3dMount
from sim.shapes import Ball, Mesh, Solid


@njit(cache=True)
def pass_through(
    ox: float, oy: float, dx: float, dy: float, edges: Array, circle: Array, is_circle: bool
) -> tuple:
    """Where a level ray enters and leaves an upright convex solid: (in, out) [m], in > out when it misses.

    edges (n, 3): outward normal and offset of each side, n . p <= c inside. From within, `in` is negative.
    """
    if is_circle:
        cx, cy, r = circle[0] - ox, circle[1] - oy, circle[2]
        along = cx * dx + cy * dy
        inside = along * along - (cx * cx + cy * cy - r * r)
        if inside < 0.0:
            return 1.0, -1.0
        root = math.sqrt(inside)
        return along - root, along + root
    low, high = -math.inf, math.inf
    for k in range(edges.shape[0]):
        slope = edges[k, 0] * dx + edges[k, 1] * dy
        room = edges[k, 2] - edges[k, 0] * ox - edges[k, 1] * oy
        if slope == 0.0:
            if room < 0.0:
                return 1.0, -1.0
        elif slope < 0.0:
            low = max(low, room / slope)
        else:
            high = min(high, room / slope)
    return low, high


@njit(cache=True)
def cast_rings(
    origins: Array,
    directions: Array,
    height: float,
    tangents: Array,
    edges: Array,
    first_edge: NDArray[np.int64],
    circles: Array,
    is_circle: NDArray[np.bool_],
    z_min: Array,
    z_max: Array,
) -> Array:
    """Level distance to the first surface along each beam, (n_azimuths, n_rings) [m], +inf for none.

    origins, directions (n, 2) of each azimuth; beams rise by `tangents` (n_rings,) a metre from
    `height`. Solid k has sides edges[first_edge[k]:first_edge[k + 1]] or circles[k], and z_min, z_max.
    A beam meets its side, its top or its underside; else the floor at z = 0.
    """
    n, n_rings = origins.shape[0], tangents.shape[0]
    out = np.full((n, n_rings), math.inf)
    for j in range(n_rings):
        if tangents[j] < 0.0:
            out[:, j] = -height / tangents[j]
    for i in range(n):
        for k in range(z_min.shape[0]):
            enter, leave = pass_through(
                origins[i, 0],
                origins[i, 1],
                directions[i, 0],
                directions[i, 1],
                edges[first_edge[k] : first_edge[k + 1]],
                circles[k],
                is_circle[k],
            )
            if enter > leave or leave < 0.0:
                continue
            enter = max(enter, 0.0)
            for j in range(n_rings):
                if enter >= out[i, j]:
                    continue
                z = height + enter * tangents[j]
                t = enter
                if z > z_max[k]:
                    t = (z_max[k] - height) / tangents[j] if tangents[j] < 0.0 else math.inf
                elif z < z_min[k]:
                    t = (z_min[k] - height) / tangents[j] if tangents[j] > 0.0 else math.inf
                if t <= leave and t < out[i, j]:
                    out[i, j] = t
    return out


class Lidar3d:
    """Turns base poses over a sweep into a cloud."""

    def __init__(
        self, solids: Sequence[Solid], mount: Lidar3dMount, sigma: float, rng: np.random.Generator
    ) -> None:
        odd = [solid.name for solid in solids if isinstance(solid, (Ball, Mesh))]
        if odd:
            raise InputError(
                f"{odd[0]}: the 3D lidar sees boxes, prisms and cylinders only, no balls or meshes"
            )
        self._mount, self._sigma, self._rng = mount, sigma, rng
        self._angles: Array = np.linspace(0.0, 2.0 * np.pi, mount.n_azimuths, endpoint=False)
        self._share: Array = np.asarray(np.arange(mount.n_azimuths) / mount.n_azimuths, dtype=np.float64)
        low, high = np.deg2rad(mount.elevation_deg)
        self._elevations: Array = np.linspace(low, high, mount.n_rings)
        sides = [_sides(solid) for solid in solids]
        self._edges = np.ascontiguousarray(np.vstack([np.zeros((0, 3)), *sides]))
        self._first_edge = np.cumsum([0, *(len(side) for side in sides)]).astype(np.int64)
        self._circles = np.array([[*solid.center, solid.radius] for solid in solids]).reshape(-1, 3)
        self._is_circle = np.array([solid.is_cylinder for solid in solids], dtype=np.bool_)
        self._z_min = np.array([solid.z_min for solid in solids], dtype=np.float64)
        self._z_max = np.array([solid.z_max for solid in solids], dtype=np.float64)

    def true_ranges(self, poses: Array) -> Array:
        """Distances (n_azimuths, n_rings) without noise or limits; poses as for the planar lidar."""
        x, y, z = self._mount.position
        when: Array = self._share * float(len(poses) - 1)
        origins, directions, _ = beam_rays(poses, when, np.array([x, y, 0.0]), self._angles)
        level = cast_rings(
            origins,
            directions,
            z,
            np.tan(self._elevations),
            self._edges,
            self._first_edge,
            self._circles,
            self._is_circle,
            self._z_min,
            self._z_max,
        )
        return np.asarray(level / np.cos(self._elevations))

    def measure(self, poses: Array) -> Cloud:
        """The points that came back, in the order of their instants, in the lidar frame."""
        ranges = self.true_ranges(poses)
        seen = (ranges >= self._mount.range_min) & (ranges <= self._mount.range_max)
        noisy = ranges + self._sigma * self._rng.standard_normal(ranges.shape)
        azimuth, ring = np.nonzero(seen)
        r, up = noisy[seen], self._elevations[ring]
        level = r * np.cos(up)
        points = np.stack(
            [level * np.cos(self._angles[azimuth]), level * np.sin(self._angles[azimuth]), r * np.sin(up)], -1
        )
        times = self._share[azimuth] / self._mount.rate_hz if len(poses) > 1 else None
        return Cloud(points, times)


def _sides(solid: Solid) -> Array:
    """Outward normal and offset of each side of a prism, (n, 3); none for a cylinder."""
    if solid.is_cylinder:
        return np.zeros((0, 3))
    edges = np.roll(solid.polygon, -1, axis=0) - solid.polygon
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=-1) / np.linalg.norm(edges, axis=1, keepdims=True)
    return np.hstack([normals, np.sum(normals * solid.polygon, axis=1, keepdims=True)])
