"""3D ray casting of rings of beams against prisms, cylinders, balls, meshes and the floor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array
from turtlebag.sim.plans import Plan
from turtlebag.sim.raycast import cast, through_circle
from turtlebag.sim.shapes import NO_CIRCLES, Ball, Mesh, Solid


class Prisms(NamedTuple):
    """Upright solids: number k has sides edges[first_edge[k]:first_edge[k + 1]], or circles[k]."""

    edges: Array
    first_edge: NDArray[np.int64]
    circles: Array
    is_circle: NDArray[np.bool_]
    z_min: Array
    z_max: Array


@njit(cache=True)
def pass_through(
    ox: float, oy: float, dx: float, dy: float, edges: Array, circle: Array, is_circle: bool
) -> tuple:
    """Where a level ray enters and leaves an upright convex solid: (in, out) [m], in > out when it misses.

    edges (n, 3): outward normal and offset of each side, n . p <= c inside. From within, `in` is negative.
    """
    if is_circle:
        return through_circle(ox, oy, dx, dy, circle)
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
def cast_rings(origins: Array, directions: Array, height: float, tangents: Array, prisms: Prisms) -> Array:
    """Level distance to the first surface along each beam, (n_azimuths, n_rings) [m], +inf for none.

    origins, directions (n, 2) of each azimuth; beams rise by `tangents` (n_rings,) a metre from
    `height`. A beam meets a solid's side, its top or its underside; else the floor at z = 0.
    """
    n, n_rings = origins.shape[0], tangents.shape[0]
    out = np.full((n, n_rings), math.inf)
    for j in range(n_rings):
        if tangents[j] < 0.0:
            out[:, j] = -height / tangents[j]
    for i in range(n):
        for k in range(prisms.z_min.shape[0]):
            enter, leave = pass_through(
                origins[i, 0],
                origins[i, 1],
                directions[i, 0],
                directions[i, 1],
                prisms.edges[prisms.first_edge[k] : prisms.first_edge[k + 1]],
                prisms.circles[k],
                prisms.is_circle[k],
            )
            if enter > leave or leave < 0.0:
                continue
            enter = max(enter, 0.0)
            for j in range(n_rings):
                if enter >= out[i, j]:
                    continue
                z = height + enter * tangents[j]
                t = enter
                if z > prisms.z_max[k]:
                    t = (prisms.z_max[k] - height) / tangents[j] if tangents[j] < 0.0 else math.inf
                elif z < prisms.z_min[k]:
                    t = (prisms.z_min[k] - height) / tangents[j] if tangents[j] > 0.0 else math.inf
                if t <= leave and t < out[i, j]:
                    out[i, j] = t
    return out


@njit(cache=True)
def cast_balls(
    origins: Array, directions: Array, height: float, tangents: Array, balls: Array, out: Array
) -> None:
    """Shorten `out` as of cast_rings where a ball (x, y, z, radius) stands nearer; balls (k, 4).

    Along o + t (dx, dy, tangent) the distance to the centre is the radius: a quadratic in t.
    """
    for i in range(origins.shape[0]):
        for k in range(balls.shape[0]):
            cx, cy = balls[k, 0] - origins[i, 0], balls[k, 1] - origins[i, 1]
            cz, r = balls[k, 2] - height, balls[k, 3]
            level = cx * directions[i, 0] + cy * directions[i, 1]
            for j in range(tangents.shape[0]):
                square = 1.0 + tangents[j] * tangents[j]
                along = (level + cz * tangents[j]) / square
                inside = along * along - (cx * cx + cy * cy + cz * cz - r * r) / square
                if inside < 0.0:
                    continue
                t = along - math.sqrt(inside)
                if t < 0.0:
                    t = along + math.sqrt(inside)
                if 0.0 <= t < out[i, j]:
                    out[i, j] = t


@njit(cache=True)
def cast_triangles(
    origins: Array, directions: Array, height: float, tangents: Array, triangles: Array, out: Array
) -> None:
    """Shorten `out` as of cast_rings where one of the triangles (k, 3, 3) is nearer.

    Moeller and Trumbore (1997), from either side; triangles that an azimuth's upright plane does not cut
    are stepped over.
    """
    cross = np.zeros(3)
    for i in range(origins.shape[0]):
        ox, oy, dx, dy = origins[i, 0], origins[i, 1], directions[i, 0], directions[i, 1]
        for k in range(triangles.shape[0]):
            left = right = ahead = False
            for a in range(3):
                x, y = triangles[k, a, 0] - ox, triangles[k, a, 1] - oy
                side = dx * y - dy * x
                left, right = left or side >= 0.0, right or side <= 0.0
                ahead = ahead or dx * x + dy * y >= 0.0
            if not (left and right and ahead):
                continue
            e1, e2 = triangles[k, 1] - triangles[k, 0], triangles[k, 2] - triangles[k, 0]
            sx, sy, sz = ox - triangles[k, 0, 0], oy - triangles[k, 0, 1], height - triangles[k, 0, 2]
            cross[0] = sy * e1[2] - sz * e1[1]
            cross[1] = sz * e1[0] - sx * e1[2]
            cross[2] = sx * e1[1] - sy * e1[0]
            for j in range(tangents.shape[0]):
                dz = tangents[j]
                px, py, pz = dy * e2[2] - dz * e2[1], dz * e2[0] - dx * e2[2], dx * e2[1] - dy * e2[0]
                det = e1[0] * px + e1[1] * py + e1[2] * pz
                if det == 0.0:
                    continue
                u = (sx * px + sy * py + sz * pz) / det
                v = (dx * cross[0] + dy * cross[1] + dz * cross[2]) / det
                t = (e2[0] * cross[0] + e2[1] * cross[1] + e2[2] * cross[2]) / det
                if u >= 0.0 and v >= 0.0 and u + v <= 1.0 and 0.0 <= t < out[i, j]:
                    out[i, j] = t


class Scene:
    """Solids as the arrays that rays are cast through."""

    def __init__(self, solids: Sequence[Solid]) -> None:
        upright = [solid for solid in solids if not isinstance(solid, (Ball, Mesh))]
        balls = [solid for solid in solids if isinstance(solid, Ball)]
        sides = [_sides(solid) for solid in upright]
        self._prisms = Prisms(
            edges=np.ascontiguousarray(np.vstack([np.zeros((0, 3)), *sides])),
            first_edge=np.cumsum([0, *(len(side) for side in sides)]).astype(np.int64),
            circles=np.array([[*solid.center, solid.radius] for solid in upright]).reshape(-1, 3),
            is_circle=np.array([solid.is_cylinder for solid in upright], dtype=np.bool_),
            z_min=np.array([solid.z_min for solid in upright], dtype=np.float64),
            z_max=np.array([solid.z_max for solid in upright], dtype=np.float64),
        )
        centres = [[*ball.center, 0.5 * (ball.z_min + ball.z_max), ball.radius] for ball in balls]
        self._balls = np.array(centres, dtype=np.float64).reshape(-1, 4)
        self._plans = [solid for solid in solids if isinstance(solid, Plan)]
        meshes = [
            solid.triangles for solid in solids if isinstance(solid, Mesh) and not isinstance(solid, Plan)
        ]
        self._triangles = np.ascontiguousarray(np.vstack([np.zeros((0, 3, 3)), *meshes]))

    def cast(self, origins: Array, directions: Array, height: float, tangents: Array) -> Array:
        """Level distances (n, n_rings) [m] as of cast_rings, to whatever is nearest."""
        out: Array = cast_rings(origins, directions, height, tangents, self._prisms)
        if len(self._balls):
            cast_balls(origins, directions, height, tangents, self._balls, out)
        if len(self._triangles):
            cast_triangles(origins, directions, height, tangents, self._triangles, out)
        for plan in self._plans:
            _cast_walls(origins, directions, height, tangents, plan, out)
        return out


def _cast_walls(
    origins: Array, directions: Array, height: float, tangents: Array, plan: Plan, out: Array
) -> None:
    """Shorten `out` as of cast_rings where a plan's walls are nearer. They are all of one height, above the
    lidar: a beam that passes over the first passes over all."""
    bearings = np.arctan2(directions[:, 1], directions[:, 0])
    level, _ = cast(origins, directions, bearings, (plan.segments, NO_CIRCLES), math.inf)
    z = height + level[:, None] * tangents
    met = np.isfinite(level)[:, None] & (z >= plan.z_min) & (z <= plan.z_max)
    np.minimum(out, np.where(met, level[:, None], math.inf), out=out)


def _sides(solid: Solid) -> Array:
    """Outward normal and offset of each side of a prism, (n, 3); none for a cylinder."""
    if solid.is_cylinder:
        return np.zeros((0, 3))
    edges = np.roll(solid.polygon, -1, axis=0) - solid.polygon
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=-1) / np.linalg.norm(edges, axis=1, keepdims=True)
    return np.hstack([normals, np.sum(normals * solid.polygon, axis=1, keepdims=True)])
