"""Points against lines: the residual that mapping and localisation minimise, its weight and its derivative.

A point of a scan lies on a line that another scan, or a map, has of the same surface (Censi 2008). Equations
are numbered as in docs/how-it-maps.md.
"""

from __future__ import annotations

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array

Jacobian = tuple[float, float, float]
"""Derivative of a distance [m] by a motion x, y [m], yaw [rad]."""


# Called once per point, so all is inlined; nothing makes arrays, so nothing needs reference counts (`_nrt`).


@njit(cache=True, forceinline=True, _nrt=False)
def linearise(
    T_line_scan: tuple[float, float, float, float],
    point: tuple[float, float],
    line: tuple[float, float, float, float],
    inv_sigma2: float,
) -> tuple[float, float, Jacobian]:
    """Distance e [m] of a scan's point from a line, its robust weight w (0 to 1) and its derivative j (3,).

    T = T_line_scan is x, y, and the cosine and sine of the yaw; the point p is in the frame of the scan, the
    line, its unit normal n and a point c on it, in its own. `inv_sigma2` is 1 / s^2 [1/m^2].

    (1) e = n . (T p - c)
    (2) w = (1 + e^2 / s^2)^-2, after Geman and McClure: s off, a point counts a quarter
    (3) j = (n', p x n') with n' = R^T n, by a motion (x, y, yaw) of the scan in its own frame. H = sum of
        w/s^2 j j^T is the information about that motion, less what errors of the normals fake (`observable`);
        with g = sum of w/s^2 j e, the Gauss-Newton step is -H^-1 g.
    """
    (tx, ty, c, s), (px, py), (nx, ny, cx, cy) = T_line_scan, point, line
    x, y = tx + c * px - s * py, ty + s * px + c * py
    e = nx * (x - cx) + ny * (y - cy)
    bx, by = c * nx + s * ny, -s * nx + c * ny
    w = 1.0 / (1.0 + e * e * inv_sigma2)
    return e, w * w, (bx, by, by * px - bx * py)


@njit(cache=True, forceinline=True, _nrt=False)
def of_the_line(
    T_line_scan: tuple[float, float, float, float], point: tuple[float, float], normal: tuple[float, float]
) -> Jacobian:
    """The derivative of (3) by a motion of the line's frame instead, in that frame."""
    (tx, ty, c, s), (px, py), (nx, ny) = T_line_scan, point, normal
    x, y = tx + c * px - s * py, ty + s * px + c * py
    return -nx, -ny, -(x * ny - y * nx)


@njit(cache=True, forceinline=True, _nrt=False)
def add_equation(h: Array, g: Array, w: float, j: Jacobian, e: float) -> None:
    """Add an equation j x = -e of some weight to H and g, (3, 3), (3,), of (3); only to H's upper half."""
    j0, j1, j2 = j
    h[0, 0] += w * j0 * j0
    h[0, 1] += w * j0 * j1
    h[0, 2] += w * j0 * j2
    h[1, 1] += w * j1 * j1
    h[1, 2] += w * j1 * j2
    h[2, 2] += w * j2 * j2
    g[0] += w * j0 * e
    g[1] += w * j1 * e
    g[2] += w * j2 * e
