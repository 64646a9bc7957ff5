"""Solids of a world: upright convex prisms and cylinders, balls and meshes, and their outlines as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import Array

Bools = NDArray[np.bool_]
NO_SEGMENTS, NO_CIRCLES = np.zeros((0, 4)), np.zeros((0, 3))
SLICES = 6
"""How many heights stand for a mesh where its outline over a range of heights is asked for."""


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

    def radius_at(self, z: float) -> float:
        """Radius of its section at height z, if that is a circle [m]."""
        return self.radius

    def outline(self, low: float, high: float) -> tuple[Array, Array]:
        """Segments (n, 4) and circles (m, 3) that bound it between two heights (equal: in that plane)."""
        if self.is_cylinder:
            widest = min(max(0.5 * (self.z_min + self.z_max), low), high)
            return NO_SEGMENTS, np.array([[*self.center, self.radius_at(widest)]])
        return np.hstack([self.polygon, np.roll(self.polygon, -1, axis=0)]), NO_CIRCLES

    def inside(self, z: float, points: Array) -> Bools:
        """Which points (n, 2) lie strictly inside it at height z, (n,)."""
        if self.is_cylinder:
            return np.asarray(np.hypot(*(points - np.array(self.center)).T) < self.radius_at(z))
        edges = np.roll(self.polygon, -1, axis=0) - self.polygon
        offset = points[:, None] - self.polygon
        return np.all(edges[:, 0] * offset[..., 1] - edges[:, 1] * offset[..., 0] > 0.0, axis=1)


@dataclass(frozen=True, eq=False)
class Ball(Solid):
    """A ball whose centre is midway between z_min and z_max; `radius` is its own."""

    def radius_at(self, z: float) -> float:
        """Radius of its section at height z [m]."""
        up = z - 0.5 * (self.z_min + self.z_max)
        return float(np.sqrt(max(self.radius**2 - up**2, 0.0)))


@dataclass(frozen=True, eq=False)
class Mesh(Solid):
    """A closed surface of triangles, (n, 3, 3) in the world frame; `polygon` bounds it from above."""

    triangles: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))

    def outline(self, low: float, high: float) -> tuple[Array, Array]:
        """Its slices at one height, or at several between two."""
        low, high = max(low, self.z_min), min(high, self.z_max)
        heights = [low] if high <= low else np.linspace(low, high, SLICES + 2)[1:-1].tolist()
        return np.vstack([NO_SEGMENTS, *(slice_triangles(self.triangles, z) for z in heights)]), NO_CIRCLES

    def inside(self, z: float, points: Array) -> Bools:
        """Which points (n, 2) lie inside its slice at height z, by counting crossings, (n,)."""
        return within(slice_triangles(self.triangles, z), points)


def slice_triangles(triangles: Array, z: float) -> Array:
    """Segments (n, 4) in which triangles (m, 3, 3) meet the horizontal plane at height z."""
    # A plane through corners would give points and doubled edges: lift it off them.
    z += 1e-7
    above = triangles[..., 2] > z
    crossing = triangles[above.any(axis=1) & ~above.all(axis=1)]
    segments = np.zeros((len(crossing), 4))
    filled = np.zeros(len(crossing), dtype=np.int64)
    for i in range(3):
        a, b = crossing[:, i], crossing[:, (i + 1) % 3]
        cut = np.nonzero((a[:, 2] > z) != (b[:, 2] > z))[0]
        share = ((z - a[cut, 2]) / (b[cut, 2] - a[cut, 2]))[:, None]
        points = a[cut, :2] + share * (b[cut, :2] - a[cut, :2])
        for axis in (0, 1):
            segments[cut, 2 * filled[cut] + axis] = points[:, axis]
        filled[cut] += 1
    return segments


def within(segments: Array, points: Array) -> Bools:
    """Which points (n, 2) lie inside closed outlines of segments (m, 4), by the even-odd rule, (n,)."""
    x0, y0, x1, y1 = segments.T
    inside = np.zeros(len(points), dtype=np.bool_)
    # Points of a row of cells share their y.
    order = np.argsort(points[:, 1], kind="stable")
    ys, starts = np.unique(points[order, 1], return_index=True)
    for y, row in zip(ys.tolist(), np.split(order, starts[1:]), strict=True):
        cut = (y0 > y) != (y1 > y)
        at = np.sort(x0[cut] + (y - y0[cut]) / (y1 - y0)[cut] * (x1 - x0)[cut])
        inside[row] = (len(at) - np.searchsorted(at, points[row, 0], side="right")) % 2 == 1
    return inside


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


def ball(name: str, center: tuple[float, float, float], radius: float) -> Ball:
    """Ball about a point."""
    x, y, z = center
    return Ball(name, z - radius, z + radius, (x, y), np.zeros((0, 2)), radius)


def mesh(name: str, triangles: Array, reflectivity: float = 1.0) -> Mesh:
    """Solid bounded by triangles (n, 3, 3) in the world frame; ValueError when there are none."""
    if len(triangles) == 0 or not np.all(np.isfinite(triangles)):
        raise ValueError(f"{name}: its mesh has no finite triangles")
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    outline = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    center = (float((low[0] + high[0]) / 2.0), float((low[1] + high[1]) / 2.0))
    return Mesh(name, float(low[2]), float(high[2]), center, outline, 0.0, reflectivity, triangles)


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

    def __add__(self, other: Sections) -> Sections:
        return Sections(
            np.vstack([self.segments, other.segments]),
            np.vstack([self.circles, other.circles]),
            np.concatenate([self.segment_return, other.segment_return]),
            np.concatenate([self.circle_return, other.circle_return]),
        )

    def moved(self, xy: Array) -> Sections:
        """The same outlines, carried by (2,) [m]."""
        circles = self.circles + np.array([*xy, 0.0])
        return replace(self, segments=self.segments + np.tile(xy, 2), circles=circles)


def sections(solids: Sequence[Solid], low: float, high: float | None = None) -> Sections:
    """Outlines of the given solids in the plane at height `low`, or of all they are up to `high`."""
    outlines = [solid.outline(low, low if high is None else high) for solid in solids]
    segments, circles = [part[0] for part in outlines], [part[1] for part in outlines]
    returns = np.array([solid.reflectivity for solid in solids], dtype=np.float64)
    n_segments = np.array([len(part) for part in segments], dtype=np.int64)
    n_circles = np.array([len(part) for part in circles], dtype=np.int64)
    return Sections(
        np.ascontiguousarray(np.vstack([NO_SEGMENTS, *segments])),
        np.ascontiguousarray(np.vstack([NO_CIRCLES, *circles])),
        np.repeat(returns, n_segments),
        np.repeat(returns, n_circles),
    )


def contains(solids: Sequence[Solid], z: float, points: Array) -> Bools:
    """Which points (n, 2) lie strictly inside a solid at height z, (n,)."""
    inside, (x, y) = np.zeros(len(points), dtype=bool), points.T
    for solid in solids:
        x_min, x_max, y_min, y_max = solid.bounds()
        near = np.flatnonzero((x >= x_min) & (x <= x_max) & (y >= y_min) & (y <= y_max))
        inside[near] |= solid.inside(z, points[near])
    return inside
