"""Solids of a world: upright convex prisms and cylinders, and their sections as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from datasets.se2 import Array


@dataclass(frozen=True, eq=False)
class Solid:
    """An upright solid between z_min and z_max over the floor.

    `polygon` is a convex outline, (n, 2) counter-clockwise in the world frame [m]; a cylinder has
    `radius` > 0 instead and its axis at `center`. `reflectivity` is the chance that a lidar beam
    that hits it comes back.
    """

    name: str
    z_min: float
    z_max: float
    center: tuple[float, float]
    polygon: Array
    radius: float = 0.0
    reflectivity: float = 1.0

    @property
    def is_cylinder(self) -> bool:
        """Whether the section is a circle."""
        return self.radius > 0.0

    def crosses(self, z: float) -> bool:
        """Whether a horizontal plane at height z cuts the solid."""
        return self.z_min <= z <= self.z_max

    def bounds(self) -> tuple[float, float, float, float]:
        """(x_min, x_max, y_min, y_max) [m]."""
        if self.is_cylinder:
            (x, y), r = self.center, self.radius
            return x - r, x + r, y - r, y + r
        low, high = self.polygon.min(axis=0), self.polygon.max(axis=0)
        return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def prism(name: str, polygon: Array, z: tuple[float, float], reflectivity: float = 1.0) -> Solid:
    """Solid with a convex outline in either sense; ValueError when it is degenerate or not convex."""
    polygon = np.array(polygon, dtype=np.float64)
    edges = np.roll(polygon, -1, axis=0) - polygon
    following = np.roll(edges, -1, axis=0)
    turns = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    if len(polygon) < 3 or abs(turns.sum()) < 1e-12:
        raise ValueError(f"{name}: its outline has no area")
    if turns.sum() < 0.0:
        polygon, turns = polygon[::-1].copy(), -turns
    if turns.min() < -1e-9:
        raise ValueError(f"{name}: its outline is not convex; give it as several prisms")
    center = polygon.mean(axis=0)
    return Solid(name, z[0], z[1], (float(center[0]), float(center[1])), polygon, 0.0, reflectivity)


def box(
    name: str,
    center: tuple[float, float],
    size: tuple[float, float],
    yaw: float,
    z: tuple[float, float],
    reflectivity: float = 1.0,
) -> Solid:
    """Solid with a turned rectangle as outline; size along its own x and y [m]."""
    half = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * np.array(size)
    c, s = np.cos(yaw), np.sin(yaw)
    polygon = half @ np.array([[c, s], [-s, c]]) + np.array(center)
    return Solid(name, z[0], z[1], center, polygon, 0.0, reflectivity)


def cylinder(
    name: str, center: tuple[float, float], radius: float, z: tuple[float, float], reflectivity: float = 1.0
) -> Solid:
    """Upright cylinder."""
    return Solid(name, z[0], z[1], center, np.zeros((0, 2)), radius, reflectivity)


def as_rectangle(polygon: Array) -> tuple[float, float, float, float, float] | None:
    """(x, y, length, width, yaw) of a polygon that is a rectangle, else None."""
    if len(polygon) != 4:
        return None
    edges = np.roll(polygon, -1, axis=0) - polygon
    lengths = np.linalg.norm(edges, axis=1)
    corners = np.abs(np.sum(edges * np.roll(edges, -1, axis=0), axis=1)) / (lengths[0] * lengths[1])
    if corners.max() > 1e-6:
        return None
    x, y = polygon.mean(axis=0)
    return (
        float(x),
        float(y),
        float(lengths[0]),
        float(lengths[1]),
        float(np.arctan2(edges[0, 1], edges[0, 0])),
    )


@dataclass(frozen=True, eq=False)
class Sections:
    """Outlines of solids: segments (n, 4) x0, y0, x1, y1, and circles (m, 3) x, y, r [m].

    `segment_return` (n,) and `circle_return` (m,) hold the reflectivity of the solid each belongs to.
    """

    segments: Array
    circles: Array
    segment_return: Array
    circle_return: Array


def sections(solids: Sequence[Solid]) -> Sections:
    """Outlines of the given solids (whatever their height)."""
    segments: list[Array] = [np.zeros((0, 4))]
    returns: list[Array] = [np.zeros(0)]
    prisms = [solid for solid in solids if not solid.is_cylinder]
    for solid in prisms:
        segments.append(np.hstack([solid.polygon, np.roll(solid.polygon, -1, axis=0)]))
        returns.append(np.full(len(solid.polygon), solid.reflectivity))
    round_ones = [solid for solid in solids if solid.is_cylinder]
    circles = np.array([[*solid.center, solid.radius] for solid in round_ones], dtype=np.float64)
    return Sections(
        np.ascontiguousarray(np.vstack(segments)),
        circles.reshape(-1, 3),
        np.concatenate(returns),
        np.array([solid.reflectivity for solid in round_ones], dtype=np.float64),
    )


def contains(solids: Sequence[Solid], points: Array) -> np.ndarray:
    """Which points (n, 2) lie strictly inside a solid, (n,) bool."""
    inside = np.zeros(len(points), dtype=bool)
    for solid in solids:
        if solid.is_cylinder:
            inside |= np.hypot(*(points - np.array(solid.center)).T) < solid.radius
            continue
        edges = np.roll(solid.polygon, -1, axis=0) - solid.polygon
        offset = points[:, None] - solid.polygon
        inside |= np.all(edges[:, 0] * offset[..., 1] - edges[:, 1] * offset[..., 0] > 0.0, axis=1)
    return inside
