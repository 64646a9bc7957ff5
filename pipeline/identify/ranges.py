"""Offset and square of a lidar's ranges, by flat pieces of wall that many scans saw from near and far.

Least squares of all that the scans saw, with reading = r + offset + square r^2: unknown are, besides the two
numbers, where each scan was and by which share its turn of the head was off (eliminated scan by scan), and
where each piece of wall is and which way it faces.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.robust import PER_MEDIAN
from turtlebag.datasets.se2 import Array, wrap
from turtlebag.pipeline.identify.estimates import PARTS, Estimate, Findings, Plot, unknown
from turtlebag.pipeline.slam.scans.scans import Scans
from turtlebag.pipeline.slam.sensors.range_calibration import (
    GRAZING_SINE,
    OFFSET_M,
    SHARE,
    TRIANGULATES_M,
    TURN_SHARE,
    straight_points,
)
from turtlebag.pipeline.slam.sessions import Session

EQUATION = "reading = r + known_offset + known_square r^2, by pieces of wall seen from several ranges"
NAMES = (("known_offset", "m"), ("known_square", "1/m"))
# Scans that are looked at; those taken while turning faster [rad/s] are bent by what their times are off.
SCANS, SLOW = 1500, 0.15
# Pieces of wall reach so far from their middle [m], and their middles are so far apart; scans that must have
# seen one, and pieces that are looked at, those seen most.
REACH_M, APART_M, SEEN, PIECES = 0.3, 0.2, 15, 800
# The equations are solved this many times, each time with points moved by the last solution.
ROUNDS = 2
# A point is of a piece that is this near [m], and faces its way (cosine).
NEAR_M, ALIKE = 0.1, 0.9
# Walls are flat to this [m]; what is off by more sigmas than this is another thing.
FLAT_M, SIGMAS = 0.002, 4.0
# Points so near the lidar's limits, in standard deviations, came back by chance.
CHANCE_SIGMAS = 3.0
# What else the two may be off by [m, 1/m], the share of what is known a priori below which they show, and
# bins of ranges that are drawn.
MODEL, SHOWN = np.array([2e-4, 1.5e-4]), 0.5
BINS = 40
SCAN, PIECE, SQUARE = slice(0, 4), slice(4, 6), slice(6, 8)
"""Columns of an equation: of the scan's pose and turn, of the piece, of offset and square."""


class Points(NamedTuple):
    """Points (m,) on straight surfaces: number of their scan, where they are, the surface's normal and
    where the lidar was in the map, (m, 2), and the reading's variance."""

    scan: NDArray[np.int64]
    p_map: Array
    normal: Array
    lidar: Array
    var: Array

    def corrected(self, errors: Array) -> Points:
        """The points without an offset and a square (2,) of their ranges."""
        ray = self.p_map - self.lidar
        r = np.hypot(*ray.T)
        return self._replace(p_map=self.p_map - ray * ((errors[0] + errors[1] * r * r) / r)[:, None])


class Sightings(NamedTuple):
    """What a scan saw of a piece, (s,): numbers of both, the equations (s, 8), how far the piece is off
    towards the lidar [m], and the weight."""

    scan: NDArray[np.int64]
    piece: NDArray[np.int64]
    rows: Array
    off: Array
    weight: Array

    def some(self, which: NDArray[np.bool_]) -> Sightings:
        """Some of them."""
        return Sightings._make(part[which] for part in self)


class Fit(NamedTuple):
    """Offset and square (2,), their covariance (2, 2) by how parts of the drive disagree, and what is left of
    each sighting (s,) [m]."""

    value: Array
    covariance: Array
    seen: Sightings
    left: Array


def range_findings(session: Session) -> Findings:
    """Offset of the ranges, and what grows with their square."""
    lidar, found = session.recording.lidar, Findings()
    prior = np.array([OFFSET_M, SHARE / max(lidar.range_max, 1e-3)])
    fit, why = None, "a lidar that sees that far measures the time of flight"
    if lidar.range_max <= TRIANGULATES_M:
        fit, why = wall_fit(session, prior), "too few walls were seen from several ranges"
    applied = session.ranges.offset_m, session.ranges.square_per_m
    for k, (name, unit) in enumerate(NAMES):
        sigma = float(fit.covariance[k, k]) ** 0.5 if fit else np.inf
        found.estimates.append(
            Estimate(name, float(fit.value[k]) + applied[k], sigma, unit, EQUATION, "", PARTS - 1)
            if fit and sigma < SHOWN * prior[k]
            else unknown(name, 0.0, unit, EQUATION, why)
        )
    if fit:
        found.correlate([name for name, _ in NAMES], fit.covariance)
        found.plots["ranges"] = _plot(fit, np.array(applied))
    return found


def _plot(fit: Fit, applied: Array) -> Plot:
    """Error of the readings by range, in bins."""
    value, (sine, square) = fit.value + applied, fit.seen.rows[:, SQUARE].T
    r, off = np.sqrt(square / sine), fit.left / sine
    edges = np.quantile(r, np.linspace(0.0, 1.0, BINS + 1))
    bins = [(r >= low) & (r <= high) for low, high in itertools.pairwise(edges)]
    x = np.array([np.median(r[one]) for one in bins])
    y = np.array([np.median(off[one]) for one in bins]) + value[0] + value[1] * x**2
    line = np.linspace(0.0, float(x[-1]), BINS)
    names = tuple(name for name, _ in NAMES)
    return Plot(
        names, "Errors of the ranges",
        "How much too long readings of walls are that were seen from several ranges, medians; line: the fit.",
        "range [m]", "too long by [mm]", {"walls": (x, 1e3 * y)},
        {"fit": (line, 1e3 * (value[0] + value[1] * line**2))},
    )  # fmt: skip


def wall_fit(session: Session, prior: Array) -> Fit | None:
    """The errors that the session's ranges still have; `prior` are their deviations a priori. None where no
    piece of wall was seen by enough scans."""
    points, total, fit = points_of(session), np.zeros(2), None
    limits = session.recording.lidar.range_min, session.recording.lidar.range_max
    for _ in range(ROUNDS):
        fit = _fit(points, limits, prior)
        if fit is None:
            return None
        total, points = total + fit.value, points.corrected(fit.value)
    return fit._replace(value=total) if fit else None


def _fit(points: Points, limits: tuple[float, float], prior: Array) -> Fit | None:
    """The least squares of the points, first of all and then without what is another thing."""
    pieces, fit = pieces_of(points), None
    seen = sightings(points, pieces, limits) if len(pieces) else None
    for _ in range(2):
        if seen is None:
            return None
        often = np.bincount(seen.piece, minlength=len(pieces))
        most = np.argsort(-often, kind="stable")[:PIECES]
        seen = seen.some(np.isin(seen.piece, most[often[most] >= SEEN]))
        if len(seen.off) == 0:
            return None
        fit = solve(seen, prior)
        off = np.abs(fit.left) * np.sqrt(seen.weight)
        seen = seen.some(off <= SIGMAS * PER_MEDIAN * float(np.median(off)))
    return fit


def points_of(session: Session) -> Points:
    """What the scans saw that were taken while the robot hardly turned."""
    recording, poses = session.recording, session.carried().T_track_base
    waits = np.maximum(seconds(np.diff(recording.stamps_ns)), 1e-3)
    turning = np.abs(wrap(np.diff(poses.yaw))) / waits
    slow = np.maximum(np.append(turning, 0.0), np.append(0.0, turning)) < SLOW
    numbers = np.flatnonzero(slow & (recording.lidar_of == 0))
    numbers = numbers[:: max(1, len(numbers) // SCANS)]
    clouds = Scans.of(recording, recording.lidar.range_max).clouds(numbers)
    straight = straight_points(clouds, np.arange(len(numbers)))
    scan = np.repeat(np.arange(len(numbers)), np.diff(clouds.starts))[straight]
    T_map_base = poses[numbers][scan]
    points, normals = (part[straight].astype(np.float64) for part in (clouds.points, clouds.normals))
    towards = T_map_base @ (points + normals)
    p_map, lidar = T_map_base @ points, T_map_base @ np.broadcast_to(clouds.origin[0], points.shape)
    return Points(scan, p_map, towards - p_map, lidar, clouds.point_var[straight].astype(np.float64))


def pieces_of(points: Points) -> Array:
    """Middles and normals (k, 4) of flat pieces of wall, no two of a kind side by side."""
    way = np.round(np.arctan2(points.normal[:, 1], points.normal[:, 0]) / (0.25 * np.pi)) % 8
    cells = np.column_stack([np.floor(points.p_map / (2.0 * APART_M)), way]).astype(np.int64)
    _, first, count = np.unique(cells, axis=0, return_index=True, return_counts=True)
    some = slice(None, None, 7)
    p, normals = points.p_map[some], points.normal[some]
    tree = scipy.spatial.cKDTree(p) if len(p) else None
    found: list[Array] = []
    for row in first[count >= 2 * SEEN]:
        assert tree is not None
        middle, normal = points.p_map[row], points.normal[row]
        for _ in range(3):  # the line of its surroundings, moved into their middle
            near = np.array(tree.query_ball_point(middle, REACH_M), dtype=np.int64)
            near = near[(normals[near] @ normal > ALIKE) & (np.abs((p[near] - middle) @ normal) < NEAR_M)]
            if len(near) < 10:
                break
            middle = p[near].mean(axis=0)
            across = np.linalg.eigh(np.cov(p[near].T))[1][:, 0]
            normal = across if across @ normal > 0.0 else -across
        else:
            beside = [one for one in found if np.hypot(*(one[:2] - middle)) < APART_M]
            if all(one[2:] @ normal < ALIKE for one in beside):
                found.append(np.concatenate([middle, normal]))
    return np.array(found).reshape(-1, 4)


def sightings(points: Points, pieces: Array, limits: tuple[float, float]) -> Sightings:
    """What each scan saw of each piece, within the `limits` [m] of the ranges."""
    around = min(4, len(pieces))
    distance, near = scipy.spatial.cKDTree(pieces[:, :2]).query(points.p_map, list(range(1, around + 1)))
    piece = np.full(len(near), -1)
    for k in range(around - 1, -1, -1):
        one = pieces[near[:, k]]
        across = ((points.p_map - one[:, :2]) * one[:, 2:]).sum(axis=1)
        alike = (points.normal * one[:, 2:]).sum(axis=1) > ALIKE
        fits = alike & (np.abs(across) < NEAR_M) & (distance[:, k] < REACH_M)
        piece[fits] = near[fits, k]
    middle, normal = pieces[piece, :2], pieces[piece, 2:]
    off = ((points.p_map - middle) * normal).sum(axis=1)
    along = normal[:, 0] * (points.p_map - middle)[:, 1] - normal[:, 1] * (points.p_map - middle)[:, 0]
    ray = points.p_map - points.lidar
    read = np.hypot(*ray.T)
    sine = (ray * normal).sum(axis=1) / read
    r = read - off / np.where(sine == 0.0, 1.0, sine)  # by the piece: a reading has noise
    chance = CHANCE_SIGMAS * np.sqrt(points.var) / np.maximum(np.abs(sine), GRAZING_SINE)
    good = (piece >= 0) & (np.abs(sine) > GRAZING_SINE) & (r > limits[0] + chance) & (r < limits[1] - chance)
    base = points.lidar - points.p_map  # any place turns a scan as well
    turned = normal[:, 0] * base[:, 1] - normal[:, 1] * base[:, 0]
    ones = np.ones(len(r))
    columns = np.column_stack([normal, turned, sine * r, -ones, -along, sine, sine * r * r, off, points.var])[
        good
    ]
    pairs, of_pair, count = np.unique(
        points.scan[good] * len(pieces) + piece[good], return_inverse=True, return_counts=True
    )
    means = np.column_stack([np.bincount(of_pair, column) / count for column in columns.T])
    weight = 1.0 / (means[:, 9] / count + FLAT_M**2)
    return Sightings(pairs // len(pieces), pairs % len(pieces), means[:, :8], means[:, 8], weight)


def solve(seen: Sightings, prior: Array) -> Fit:
    """The least squares of all sightings."""
    used, piece = np.unique(seen.piece, return_inverse=True)
    size = 2 * len(used) + 2
    first = np.unique(seen.scan, return_index=True)[1]
    bounds = np.append(first, len(seen.scan))
    whole, right = np.zeros((size, size)), np.zeros(size)
    parts = []
    for a, b in itertools.pairwise(bounds):
        own = seen.rows[a:b]
        n, w, y = b - a, seen.weight[a:b], seen.off[a:b]
        others = np.zeros((n, 2 * n + 2))
        others[np.arange(n), np.arange(n)], others[np.arange(n), n + np.arange(n)] = own[:, PIECE].T
        others[:, 2 * n :] = own[:, SQUARE]
        scan = own[:, SCAN]
        scaled = scan.T * w
        inverse = np.linalg.inv(scaled @ scan + np.diag([1e-3, 1e-3, 1e-3, TURN_SHARE**-2.0]))
        free = np.eye(n) - scan @ inverse @ scaled  # what the scan's own unknowns leave of anything
        at = np.concatenate([2 * piece[a:b], 2 * piece[a:b] + 1, [size - 2, size - 1]])
        reduced = (others.T * w) @ free
        whole[np.ix_(at, at)] += reduced @ others
        right[at] += reduced @ y
        parts.append((at, reduced, others, free, y))
    whole[np.diag_indices(size)] += np.concatenate([np.ones(size - 2), prior**-2.0])
    inverse = np.linalg.inv(whole)
    x = inverse @ right
    scores, residuals = np.zeros((PARTS, size)), []
    for k, (at, reduced, others, free, y) in enumerate(parts):
        left = y - others @ x[at]
        scores[k * PARTS // len(parts), at] += reduced @ left
        residuals.append(free @ left)
    ours, known = scores @ inverse[:, -2:], inverse[-2:, -2:] / prior
    # parts that show nothing agree: then what is known a priori is all there is
    covariance = ours.T @ ours * PARTS / (PARTS - 1.0) + known @ known.T + np.diag(MODEL**2)
    return Fit(x[-2:], covariance, seen, np.concatenate(residuals))
