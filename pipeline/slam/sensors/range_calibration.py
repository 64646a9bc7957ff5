"""Range calibration: systematic range errors of a lidar, learnt from its own scans.

A triangulating lidar sees the spot of its beam shifted by a constant amount: its ranges
have an offset and an error that grows with the square of the range (the LDS-01's data sheet allows 15 mm at
short range, and 5 % at 3.5 m). Two scans that see one wall from different ranges show both, whatever their
poses: for each pair, the relative pose and the scale between the two turns of the head are eliminated, and
the equations of all pairs are summed. A factor common to all ranges cannot be told from a smaller
world.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.lidars import of_each_lidar
from turtlebag.datasets.point_to_line import linearise, of_the_line
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import NOTHING_M, Recording
from turtlebag.pipeline.slam.graph.partners import overlapping_pairs
from turtlebag.pipeline.slam.odometry.track import Track
from turtlebag.pipeline.slam.scans.align import STEP_COVARIANCE_SCALE
from turtlebag.pipeline.slam.scans.clouds import Clouds
from turtlebag.pipeline.slam.scans.correspondences import Limits, partner_line, relative_pose
from turtlebag.pipeline.slam.scans.scans import Scans

# Lidars that see farther than this [m] measure time of flight, and have no error that grows with the square
# of the range.
TRIANGULATES_M = 12.0
# A priori standard deviations of such lidars: this much [m] at any range, and this share of the farthest
# usable range there, growing with the square of the range.
OFFSET_M, SHARE = 0.01, 0.01
# Standard deviation of the scale between two turns of the head. A guess, but not sensitive: with 0.0067, and
# without a bound, the ranges of 16 simulated drives were 4.1 and 4.6 mm off, without the scale 5.1.
TURN_SHARE = 0.005
# The equations are solved this many times, each time with the points moved by the last solution.
ROUNDS = 5
# Errors smaller than this many standard deviations are none, and those of more a priori are no lidar's: they
# come from a lidar that is tilted, from glass, or from people who walk about.
SIGNIFICANT_SIGMAS, POSSIBLE_SIGMAS = 3.0, 2.0
# Lines this many beams to either side must have the same direction, within this [rad]: lines cut corners and
# bend round pillars, the more so at a distance.
BESIDE, STRAIGHT_RAD = 6, 0.3
# Surfaces met at a smaller sine than this say little about ranges.
GRAZING_SINE = 0.25


@dataclass(frozen=True)
class RangeCalibration:
    """Readings r [m] are `offset_m + square_per_m * r^2` too long. `others` are those of further lidars."""

    offset_m: float = 0.0
    square_per_m: float = 0.0
    others: tuple[RangeCalibration, ...] = ()

    def numbers(self) -> dict[str, float]:
        """Those of the only lidar, or the first."""
        return {"offset_m": self.offset_m, "square_per_m": self.square_per_m}

    def error(self, ranges: Array) -> Array:
        """Error of these readings [m]."""
        return np.asarray(self.offset_m + self.square_per_m * ranges**2)

    def as_metrics(self) -> dict[str, dict[str, float]]:
        """`range_error_m`, at 1 and 3 m, if there is any."""
        near, far = (float(off) for off in self.error(np.array([1.0, 3.0])))
        return {"range_error_m": {"at_1_m": near, "at_3_m": far}} if self != RangeCalibration() else {}

    def applied(self, recording: Recording) -> Recording:
        """The recording with corrected ranges; a return remains a return."""
        if recording.others:
            errors = iter((replace(self, others=()), *self.others))
            return of_each_lidar(recording, lambda part: next(errors).applied(part))
        ranges, lidar = recording.ranges, recording.lidar
        back, metre = lidar.returns(ranges), ranges.dtype.type
        read = np.where(back, ranges, 0.0).astype(np.float64)
        ends = max(lidar.range_min, NOTHING_M), np.nextafter(metre(lidar.range_max), metre(0.0))
        right = np.clip(read - self.error(read), *ends).astype(ranges.dtype)
        return replace(recording, ranges=np.where(back, right, ranges))

    def moved(self, clouds: Clouds) -> Clouds:
        """The clouds with corrected ranges: points along their rays, and lines with them."""
        origin = clouds.origins()
        points, _ = self._along(clouds.points - origin)
        centers, stretch = self._along(clouds.centers - origin)
        ray = clouds.centers - origin
        ray = ray / np.maximum(np.linalg.norm(ray, axis=1), NOTHING_M)[:, None]
        # A radial map stretches along and across the ray; normals transform by its inverse.
        along = (clouds.normals * ray).sum(axis=1)[:, None] * ray
        normals = along / stretch[:, :1] + (clouds.normals - along) / stretch[:, 1:]
        length = np.linalg.norm(normals, axis=1)
        normals = normals / np.where(length > 0.0, length, 1.0)[:, None]
        return clouds._replace(
            points=(origin + points).astype(clouds.points.dtype),
            centers=(origin + centers).astype(clouds.centers.dtype),
            normals=normals.astype(clouds.normals.dtype),
        )

    def _along(self, rays: Array) -> tuple[Array, Array]:
        """Rays (n, 2) with corrected lengths, and the stretch along and across them, (n, 2)."""
        ranges = np.maximum(np.linalg.norm(rays, axis=1), NOTHING_M)
        share = 1.0 - self.error(ranges) / ranges
        return rays * share[:, None], np.column_stack([1.0 - 2.0 * self.square_per_m * ranges, share])


def range_errors(scans: Scans, track: Track) -> RangeCalibration:
    """The range errors of short-range lidars, by the key scans of a track; none of any other."""
    lidars, of_key = scans.recording.lidars, scans.recording.lidar_of[track.keys]
    errors = [RangeCalibration()] * len(lidars)
    for number, lidar in enumerate(lidars):
        keys = track.keys[of_key == number]
        if lidar.spec.range_max <= TRIANGULATES_M and len(keys):
            poses = track.T_track_base[keys]
            farthest = min(scans.usable_m, lidar.spec.range_max)
            errors[number] = calibrate_ranges(*scans.of_keys(keys), poses, farthest)
    some = any(error != RangeCalibration() for error in errors)
    return replace(errors[0], others=tuple(errors[1:]) if some else ())


def calibrate_ranges(
    clouds: Clouds, keys: NDArray[np.int64], T_track_keys: SE2, usable_m: float
) -> RangeCalibration:
    """The calibration that best aligns what key scans (n,) saw; an insignificant or impossible error counts
    as none."""
    value, information, prior = range_fit(clouds, keys, T_track_keys, usable_m)
    significant = value @ information @ value > SIGNIFICANT_SIGMAS**2
    possible = value @ prior @ value < POSSIBLE_SIGMAS**2
    found = RangeCalibration(float(value[0]), float(value[1]))
    return found if significant and possible else RangeCalibration()


def range_fit(
    clouds: Clouds, keys: NDArray[np.int64], T_track_keys: SE2, usable_m: float
) -> tuple[Array, Array, Array]:
    """Offset and square (2,) by key scans (n,) as placed by a front end, what the scans say of them and what
    is known a priori, as informations (2, 2).

    Gauss-Newton steps at fixed poses. If few surfaces were seen from several ranges, the prior dominates: no
    error, to within OFFSET_M and SHARE of `usable_m`.
    """
    pairs = overlapping_pairs(T_track_keys)
    prior = np.diag([OFFSET_M**-2.0, (SHARE / usable_m) ** -2.0])
    value = np.zeros(2)
    for _ in range(ROUNDS):
        moved = RangeCalibration(float(value[0]), float(value[1])).moved(clouds)
        h, g = _equations(moved, keys, T_track_keys.xyt, pairs, Limits.fine())
        value = value - np.linalg.solve(
            h / STEP_COVARIANCE_SCALE + prior, g / STEP_COVARIANCE_SCALE + prior @ value
        )
    return value, h / STEP_COVARIANCE_SCALE, prior


@njit(cache=True, nogil=True)
def _equations(
    clouds: Clouds, keys: NDArray, poses: Array, pairs: NDArray, limits: Limits
) -> tuple[Array, Array]:
    """Normal equations (2, 2), (2,) of offset and square; the relative pose and scale of each pair are
    eliminated."""
    h, g, straight = np.zeros((2, 2)), np.zeros(2), straight_points(clouds, keys)
    information = STEP_COVARIANCE_SCALE / TURN_SHARE**2
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        tx, ty, dyaw = relative_pose(poses, a, b)
        c, s = math.cos(dyaw), math.sin(dyaw)
        whole, right = 1e-9 * np.eye(6), np.zeros(6)
        whole[3, 3] = information
        _half(clouds, straight, (keys[b], keys[a]), (tx, ty, c, s), limits, False, (whole, right))
        ix, iy = -c * tx - s * ty, s * tx - c * ty
        _half(clouds, straight, (keys[a], keys[b]), (ix, iy, c, -s), limits, True, (whole, right))
        absorbed = np.linalg.solve(whole[:4, :4].copy(), whole[:4, 4:].copy())
        h += whole[4:, 4:] - whole[4:, :4].copy() @ absorbed
        g += right[4:] - absorbed.T.copy() @ right[:4].copy()
    return h, g


@njit(cache=True, nogil=True)
def _half(
    clouds: Clouds,
    straight: NDArray,
    pair: tuple[int, int],
    T_key_scan: tuple[float, float, float, float],
    limits: Limits,
    inverted: bool,
    equations: tuple[Array, Array],
) -> None:
    """Add the equations (6, 6), (6,) of a scan's points against a key's lines, of a pair (scan, key).

    T_key_scan is as in `linearise`. The unknowns are a right perturbation of the pair's pose, the share by
    which the pair's second scan has longer ranges than its first, then offset and square.
    """
    points, normals, centers = clouds.points, clouds.normals, clouds.centers
    (h, g), (scan, key) = equations, pair
    origin = clouds.origin[clouds.sensor[scan]]  # both are of one lidar
    row_of = np.zeros(6)
    for r in range(clouds.starts[scan], clouds.starts[scan + 1]):
        if not straight[r]:
            continue
        row, e, w, j = partner_line(clouds, r, key, T_key_scan, limits)
        if row < 0 or not straight[row]:
            continue
        px, py, nx, ny = points[r, 0], points[r, 1], normals[row, 0], normals[row, 1]
        cx, cy = centers[row, 0], centers[row, 1]
        near, near_sine = _ray(px - origin[0], py - origin[1], j[0], j[1])
        far, far_sine = _ray(cx - origin[0], cy - origin[1], nx, ny)
        if min(abs(near_sine), abs(far_sine)) < GRAZING_SINE:
            continue
        # The range at which this ray meets the other scan's line. With that of the reading, its noise would
        # be on both sides of the equation, and shrunken scans would fit better.
        ray_x, ray_y = (px - origin[0]) / near, (py - origin[1]) / near
        near -= e / near_sine
        px, py = origin[0] + near * ray_x, origin[1] + near * ray_y
        aside, _, _ = linearise(T_key_scan, (px, py), (-ny, nx, cx, cy), 0.0)
        if abs(aside) > limits.gate:
            continue
        if inverted:
            j = of_the_line(T_key_scan, (px, py), (nx, ny))
        else:
            _, _, j = linearise(T_key_scan, (px, py), (nx, ny, cx, cy), 0.0)
        row_of[0], row_of[1], row_of[2] = j
        both = 0.5 * (far_sine * far + near_sine * near)
        row_of[3] = both if inverted else -both
        row_of[4] = far_sine - near_sine
        row_of[5] = far_sine * far * far - near_sine * near * near
        for a in range(6):
            g[a] += w * row_of[a] * e
            for b in range(6):
                h[a, b] += w * row_of[a] * row_of[b]


@njit(cache=True)
def _ray(x: float, y: float, nx: float, ny: float) -> tuple[float, float]:
    """Length of a ray, and the sine of its angle to the surface with this normal."""
    length = max(math.hypot(x, y), NOTHING_M)
    return length, (nx * x + ny * y) / length


@njit(cache=True, nogil=True)
def straight_points(clouds: Clouds, keys: NDArray) -> NDArray:
    """Points (m,) of key scans whose surface continues straight to both sides."""
    normals, line_ok = clouds.normals, clouds.line_ok
    out = np.zeros(len(normals), dtype=np.bool_)
    for key in keys:
        first, end = clouds.starts[key], clouds.starts[key + 1]
        for row in range(first, end):
            out[row] = line_ok[row] and row - BESIDE >= first and row + BESIDE < end
            for beside in (row - BESIDE, row + BESIDE):
                if out[row]:
                    dot = normals[beside, 0] * normals[row, 0] + normals[beside, 1] * normals[row, 1]
                    out[row] = line_ok[beside] and dot > math.cos(STRAIGHT_RAD)
    return out
