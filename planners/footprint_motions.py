"""Straight drives and turns on the spot of a footprint, checked cell by cell.

Poses (x, y, yaw) are in the grid frame of the clearance field.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array
from turtlebag.planners.footprint import Field32, footprint_free


class Ground(NamedTuple):
    """A clearance field [m], its resolution, and the footprint that moves there.

    `corners` (n, 2) is the footprint in the base frame, grown by the required margin [m].
    """

    field: Field32
    res: float
    corners: Array


Pose = tuple[float, float, float]


@njit(cache=True)
def moves(ground: Ground, a: Pose, b: Pose) -> bool:
    """Whether the footprint can move straight from one pose to another while turning the shorter way."""
    return _free(ground, a, b[0] - a[0], b[1] - a[1], (b[2] - a[2] + math.pi) % (2.0 * math.pi) - math.pi)


@njit(cache=True)
def _free(ground: Ground, a: Pose, dx: float, dy: float, angle: float) -> bool:
    """Whether the footprint can move straight from a pose by (dx, dy) while turning by an angle.

    Between two checks no corner moves farther than half a cell.
    """
    field, res, corners = ground
    way = math.hypot(dx, dy) + abs(angle) * math.sqrt((corners**2).sum(axis=1).max())
    steps = max(1, math.ceil(way / (0.5 * res)))
    for i in range(steps + 1):
        f = i / steps
        if not footprint_free(field, res, corners, a[0] + f * dx, a[1] + f * dy, a[2] + f * angle):
            return False
    return True


@njit(cache=True)
def drives(ground: Ground, a: Array, b: Array, yaw: float) -> bool:
    """Whether the footprint can move straight from a to b (2,) in one heading."""
    return moves(ground, (a[0], a[1], yaw), (b[0], b[1], yaw))


@njit(cache=True)
def turning(ground: Ground, at: Array, old: float, new: float) -> float:
    """The free turn on the spot from one heading to another, the shorter way first; NaN if neither is
    free."""
    if np.isnan(old) or np.isnan(new):
        return 0.0
    short = (new - old + math.pi) % (2.0 * math.pi) - math.pi
    for angle in (short, short - math.copysign(2.0 * math.pi, short)):
        if _free(ground, (at[0], at[1], old), 0.0, 0.0, angle):
            return angle
    return np.nan


@njit(cache=True)
def turns(ground: Ground, at: Array, old: float, new: float) -> bool:
    """Whether the footprint can turn on the spot from one heading to another, either way; NaN is any
    heading."""
    return not np.isnan(turning(ground, at, old, new))


@njit(cache=True)
def pull(ground: Ground, path: Array, first_yaw: float, last_yaw: float) -> tuple[Array, Array]:
    """The longest straight drives along a dense polyline (n, 2), forwards or else backwards.

    Returns corners (m, 2) and the headings (m - 1,) between them. The robot turns at the corners, from
    `first_yaw` at the start and to `last_yaw` at the end; NaN there is any heading.
    """
    kept, yaws = np.empty_like(path), np.empty(len(path))
    kept[0] = path[0]
    count, at, yaw = 1, 0, first_yaw
    last = len(path) - 1
    while at < last:
        target, heading = last, np.nan
        while target > at:
            heading = _straight(ground, path, at, target, yaw, last_yaw)
            if not np.isnan(heading) or target == at + 1:
                break
            target -= 1
        if np.isnan(heading):
            heading = math.atan2(path[target, 1] - path[at, 1], path[target, 0] - path[at, 0])
        kept[count], yaws[count - 1] = path[target], heading
        count, at, yaw = count + 1, target, heading
    return kept[:count].copy(), yaws[: count - 1].copy()


@njit(cache=True)
def _straight(ground: Ground, path: Array, at: int, target: int, yaw: float, last_yaw: float) -> float:
    """The heading in which the robot can drive from one point to another and continue from there; NaN if
    there is none."""
    ahead = math.atan2(path[target, 1] - path[at, 1], path[target, 0] - path[at, 0])
    for way in (ahead, ahead + math.pi):
        if (
            turns(ground, path[at], yaw, way)
            and drives(ground, path[at], path[target], way)
            and _goes_on(ground, path, target, way, last_yaw)
        ):
            return way
    return np.nan


@njit(cache=True)
def _goes_on(ground: Ground, path: Array, at: int, yaw: float, last_yaw: float) -> bool:
    """Whether the robot can turn from a heading into the next piece of the path."""
    if at == len(path) - 1:
        return turns(ground, path[at], yaw, last_yaw)
    ahead = math.atan2(path[at + 1, 1] - path[at, 1], path[at + 1, 0] - path[at, 0])
    return turns(ground, path[at], yaw, ahead) or turns(ground, path[at], yaw, ahead + math.pi)


@njit(cache=True)
def free_from(ground: Ground, poses: Array) -> int:
    """The first of the poses (n, 3) from which the path is free to its end; n if the goal is not free.

    Each piece is driven in the heading of its own line, forwards or backwards, whichever is nearer to its
    pose's yaw; the robot turns on the spot into it.
    """
    n = len(poses)
    after = poses[n - 1, 2]
    if not footprint_free(ground.field, ground.res, ground.corners, poses[n - 1, 0], poses[n - 1, 1], after):
        return n
    for i in range(n - 1):
        k = n - 2 - i
        a, b = poses[k, :2], poses[k + 1, :2]
        yaw = poses[k, 2]
        if math.hypot(b[0] - a[0], b[1] - a[1]) > 1e-6:
            yaw = math.atan2(b[1] - a[1], b[0] - a[0])
            if k > 0 and math.cos(yaw - poses[k, 2]) < 0.0:
                yaw += math.pi
        if not (turns(ground, b, yaw, after) and drives(ground, a, b, yaw)):
            return k + 1
        after = yaw
    return 0 if turns(ground, poses[0, :2], poses[0, 2], after) else 1
