"""When each part of a scan is taken, by the scans themselves: pairs of scans that turn differently show it.

A point that is taken a time t later than believed lies where the base's motion over t moves it. That is
linear in t, so the point-to-line equations of two scans give the time of each sector of the array; the
relative pose of the pair is eliminated. A time that is common to all sectors moves whole scans, and is not
seen.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.point_to_line import of_the_line
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import LidarSpec
from turtlebag.pipeline.slam.scans.align import match_information
from turtlebag.pipeline.slam.scans.clouds import Clouds
from turtlebag.pipeline.slam.scans.correspondences import Limits, partner_line, relative_pose

# Parts of the array whose times are estimated, and places at which the sweep is first supposed to begin.
SECTORS, PLACES = 36, 72
# Of beams over this share of a turn, any may be the first.
ALL_ROUND = 0.95
# The sweep begins with the first reading unless the squared errors with another are smaller by this.
ELSEWHERE = 9.0
# The turns by odometry, and with them the duration, are off by this share.
TURN_SHARE = 0.03
# No sweep takes longer than this many periods.
LONGEST = 1.1


class SectorTimes(NamedTuple):
    """Normal equations of how much later the sectors are taken than believed [s], (SECTORS, SECTORS),
    (SECTORS,), of some scans; and how badly these match, 0 if all points lie on lines, 1 if none does."""

    h: Array
    g: Array
    misfit: float

    def gain(self, later_s: Array) -> float:
        """The log-likelihood ratio in favour of sectors that are taken so much later (SECTORS,)."""
        return float(-(self.g + 0.5 * self.h @ later_s) @ later_s)


class Sweep(NamedTuple):
    """A lidar with the sweep that explains the times of its sectors best.

    `sigma_s` is the standard deviation of the duration [s], `first_sigma` that of the first beam, infinite
    where nothing shows them; `rest_s` (SECTORS,) is how much later the sectors are by the scans, `later_s`
    how much later than they were believed to be.
    """

    lidar: LidarSpec
    sigma_s: float
    first_sigma: float
    rest_s: Array
    later_s: Array


def sector_of(lidar: LidarSpec, beams: NDArray[np.int64]) -> NDArray[np.int64]:
    """The sector of each of these beams."""
    return beams * SECTORS // lidar.n_beams


def sector_means(lidar: LidarSpec) -> Array:
    """The mean share of the sweep that has passed when the beams of each sector are taken, (SECTORS,)."""
    sectors = sector_of(lidar, np.arange(lidar.n_beams))
    return np.bincount(sectors, lidar.shares, SECTORS) / np.bincount(sectors, minlength=SECTORS)


def believed_s(lidar: LidarSpec) -> Array:
    """The mean time of each sector after the stamp, (SECTORS,) [s]."""
    return sector_means(lidar) * lidar.sweep_s


def all_round(lidar: LidarSpec) -> bool:
    """Whether the beams make a full turn, so that any may be the first."""
    return bool(lidar.n_beams * abs(lidar.angle_increment) > ALL_ROUND * 2.0 * math.pi)


def has_sectors(lidar: LidarSpec) -> bool:
    """Whether there are enough beams to tell the times of sectors."""
    return lidar.n_beams >= 2 * SECTORS


def near_start(lidar: LidarSpec) -> bool:
    """Whether the first beam is as good as the first reading."""
    return min(lidar.first_beam, lidar.n_beams - lidar.first_beam) <= lidar.n_beams // PLACES


def best_sweep(
    lidar: LidarSpec, sectors: Iterable[SectorTimes], period_s: float, first: int | None = None
) -> Sweep:
    """The sweep that explains best the times of the sectors as some stretches show them, if these are
    believed to be those of `lidar`; from a first beam on, or any."""
    # sectors that nothing shows are believed
    h, g, n = period_s**-2.0 * np.eye(SECTORS), np.zeros(SECTORS), lidar.n_beams
    for one in sectors:
        h, g = h + one.h, g + one.g
    later = -np.linalg.solve(h, g)
    by_scans = _visible(believed_s(lidar) + later, h)
    places = range(0, n, max(1, n // PLACES)) if all_round(lidar) else range(1)
    sweeps = [
        _duration(replace(lidar, time_increment=way, first_beam=place), h, by_scans, period_s)
        for way in (1.0, -1.0)
        for place in (places if first is None else [first])
    ]
    cost, best = min(sweeps, key=lambda one: one[0])
    for cost_as_said, as_said in sweeps:
        if as_said.first_beam == 0 and cost_as_said < cost + ELSEWHERE and best.first_beam != 0:
            cost, best = cost_as_said, as_said
    shape, aside = _visible(sector_means(best), h), max(1, n // SECTORS)
    beside = [believed_s(replace(best, first_beam=(best.first_beam + way * aside) % n)) for way in (-1, 1)]
    slope = _visible(beside[1] - beside[0], h) / (2.0 * aside)
    sigma = math.hypot(float(shape @ h @ shape) ** -0.5, TURN_SHARE * best.sweep_s)
    first_sigma = max(float(slope @ h @ slope), 1e-12) ** -0.5
    return Sweep(best, sigma, first_sigma, by_scans - best.sweep_s * shape, later)


def _duration(lidar: LidarSpec, h: Array, by_scans: Array, period_s: float) -> tuple[float, LidarSpec]:
    """The lidar with the most likely duration of its sweep, and its cost."""
    shape = _visible(sector_means(lidar), h)
    duration_s = float(shape @ h @ by_scans) / float(shape @ h @ shape)
    duration_s = min(max(duration_s, 0.0), LONGEST * period_s)
    rest = by_scans - duration_s * shape
    increment = math.copysign(duration_s, lidar.time_increment) / (lidar.n_beams - 1)
    return float(rest @ h @ rest), replace(lidar, time_increment=increment)


def _visible(times: Array, h: Array) -> Array:
    """Times (SECTORS,) without what is common to all."""
    return times - float(h.sum(axis=0) @ times) / float(h.sum())


def sector_times(
    clouds: Clouds, sectors: NDArray[np.int64], twists: Array, T_track_base: Array
) -> SectorTimes:
    """The equations of all pairs of some scans at poses (n, 3), whose bases move by twists (n, 3)
    [m/s, rad/s]; `sectors` (m,) are those of their points."""
    n = len(T_track_base)
    pairs = np.array([(a, b) for a in range(n) for b in range(a + 1, n)])
    h, g, cost, used = _sum_of_pairs(clouds, sectors, twists, T_track_base, pairs, Limits.rough())
    return SectorTimes(match_information(h), match_information(g), cost / max(used, 1))


@njit(cache=True, nogil=True)
def _sum_of_pairs(
    clouds: Clouds, sectors: NDArray, twists: Array, poses: Array, pairs: NDArray, limits: Limits
) -> tuple[Array, Array, float, int]:
    """Normal equations (SECTORS, SECTORS), (SECTORS,); the summed cost of the points, and their number."""
    h, g, cost, used = np.zeros((SECTORS, SECTORS)), np.zeros(SECTORS), 0.0, 0
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        tx, ty, dyaw = relative_pose(poses, a, b)
        c, s = math.cos(dyaw), math.sin(dyaw)
        whole, right = 1e-6 * np.eye(3 + SECTORS), np.zeros(3 + SECTORS)
        there = _half(clouds, sectors, twists, (b, a), (tx, ty, c, s), limits, False, (whole, right))
        ix, iy = -c * tx - s * ty, s * tx - c * ty
        back = _half(clouds, sectors, twists, (a, b), (ix, iy, c, -s), limits, True, (whole, right))
        absorbed = np.linalg.solve(whole[:3, :3].copy(), whole[:3, 3:].copy())
        h += whole[3:, 3:] - whole[3:, :3].copy() @ absorbed
        g += right[3:] - absorbed.T.copy() @ right[:3].copy()
        cost += there[0] + back[0]
        used += there[1] + back[1]
    return h, g, cost, used


@njit(cache=True, nogil=True)
def _half(
    clouds: Clouds,
    sectors: NDArray,
    twists: Array,
    pair: tuple[int, int],
    T_key_scan: tuple[float, float, float, float],
    limits: Limits,
    inverted: bool,
    equations: tuple[Array, Array],
) -> tuple[float, int]:
    """Add the equations (3 + SECTORS) of a scan's points against a key's lines, of a pair (scan, key).

    T_key_scan is as in `linearise`. The unknowns are a right perturbation of the pair's pose, then the times.
    """
    (h, g), (scan, key), cost, used = equations, pair, 0.0, 0
    columns, values = np.array([0, 1, 2, 0, 0]), np.zeros(5)
    for r in range(clouds.starts[scan], clouds.starts[scan + 1]):
        if not clouds.line_ok[r]:
            continue
        used += 1
        row, e, w, j = partner_line(clouds, r, key, T_key_scan, limits)
        if row < 0:
            cost += 1.0
            continue
        point, normal = clouds.points[r], clouds.normals[row]
        line = of_the_line(T_key_scan, (point[0], point[1]), (normal[0], normal[1]))
        values[0], values[1], values[2] = line if inverted else j
        columns[3], columns[4] = 3 + sectors[r], 3 + sectors[row]
        values[3] = j[0] * twists[scan, 0] + j[1] * twists[scan, 1] + j[2] * twists[scan, 2]
        values[4] = line[0] * twists[key, 0] + line[1] * twists[key, 1] + line[2] * twists[key, 2]
        cost += e * e / (limits.sigma * limits.sigma + e * e)
        for a in range(5):
            g[columns[a]] += w * values[a] * e
            for b in range(5):
                h[columns[a], columns[b]] += w * values[a] * values[b]
    return cost, used
