"""Every scan of a log as points with surface lines: what all matching works on.

Points of all scans lie in one array, scan i in rows `starts[i]:starts[i + 1]` (the layout keeps the
numba kernels free of objects). Each point carries the line fitted to its neighbours on the same
surface; where there is none (lone returns, corners of the visible part) `line_ok` is False.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from datasets.kernels import njit
from datasets.se2 import SE2, Array
from datasets.types import Recording
from pipeline.slam.threads import in_parts

# Fewer points with a surface line than this place nothing by their lines; so does a scan most of whose
# points have none: posts, table legs, thin trunks.
MIN_LINES, LINE_SHARE = 8, 0.3
# Fewer points than this place nothing at all.
MIN_POINTS = 8
# A range below this is how some drivers write "no return".
NOTHING_M = 0.01
# Between scans farther apart than this the robot may have done anything.
LONGEST_STEP_S = 1.0
# Neighbours on a surface are looked for within this many beam spacings, at least this far apart.
WINDOW_BEAMS = 4
MIN_WINDOW_M = 0.12
MAX_GAP_M = 0.6
# A wall hit at a grazing angle has widely spaced returns: up to this many beam spacings of a
# perpendicular hit the returns still count as one surface.
GRAZING = 6.0


@dataclass(frozen=True, eq=False)
class Clouds:
    """Points of many scans; `points`, `normals`, `centers` are (m, 2) in the base frame at the scan's stamp.

    `normals` are unit vectors towards the sensor, `centers` a point of the fitted line (its centroid);
    `table` is (n_scans, n_bins): for a bearing about the lidar, the row of the point seen there, or -1.
    """

    points: Array
    normals: Array
    centers: Array
    line_ok: NDArray[np.bool_]
    starts: NDArray[np.int64]
    table: NDArray[np.int32]
    origin: Array

    def __len__(self) -> int:
        return len(self.starts) - 1

    def of(self, scan: int) -> Array:
        """Points of one scan, (k, 2)."""
        return self.points[self.starts[scan] : self.starts[scan + 1]]

    def lines(self, scan: int) -> int:
        """Points of one scan that have a surface line."""
        return int(np.count_nonzero(self.line_ok[self.starts[scan] : self.starts[scan + 1]]))

    def placed_by(self, scan: int) -> Literal["lines", "points", "nothing"]:
        """What a scan is matched by."""
        points, lines = int(self.starts[scan + 1] - self.starts[scan]), self.lines(scan)
        if lines >= max(MIN_LINES, LINE_SHARE * points):
            return "lines"
        return "points" if points >= MIN_POINTS else "nothing"

    def lines_per_scan(self) -> NDArray[np.int64]:
        """Points with a surface line in each scan, (n,)."""
        total = np.concatenate([[0], np.cumsum(self.line_ok)])
        return np.asarray(np.diff(total[self.starts]))


def point_information(points: Array) -> Array:
    """What matched points (n, 2) tell of the pose they are seen from, (3, 3), for errors of 1 m each."""
    n, (x, y) = len(points), points.sum(axis=0)
    return np.array([[n, 0.0, -y], [0.0, n, x], [-y, x, float((points**2).sum())]])


def make_clouds(recording: Recording, usable_range: float, motion: SE2 | None = None) -> Clouds:
    """Points of every scan, the robot's motion during the sweep undone.

    `motion` holds, per scan, the base pose at the end of the sweep seen from its start; None uses the
    log's own odometry where the beams are taken one after another.
    """
    lidar = recording.lidar
    least = max(lidar.range_min, NOTHING_M)
    valid = (recording.ranges >= least) & (recording.ranges <= min(lidar.range_max, usable_range))
    starts = np.concatenate([[0], np.cumsum(valid.sum(axis=1))]).astype(np.int64)
    scan_of, beam_of = np.nonzero(valid)
    points_lidar = lidar.directions[beam_of] * recording.ranges[valid][:, None].astype(np.float64)
    points = recording.T_base_lidar @ points_lidar
    if lidar.time_increment != 0.0:
        motion = motion if motion is not None else sweep_motion(recording)
        if motion is not None:
            points = _deskewed(points, motion, scan_of, beam_of / max(lidar.n_beams - 1, 1))
    origin = np.array(recording.T_base_lidar.xy, dtype=np.float64)
    increment = abs(lidar.angle_increment)
    n_bins = max(8, round(2.0 * math.pi / increment))
    normals, centers, line_ok = np.zeros_like(points), points.copy(), np.zeros(len(points), dtype=np.bool_)
    table = np.full((len(recording), n_bins), -1, dtype=np.int32)

    def prepare(scans: slice) -> None:
        _fit_lines(points, starts[scans.start : scans.stop + 1], origin, increment, normals, centers, line_ok)
        _bearing_tables(points, starts[scans.start : scans.stop + 1], origin, table[scans])

    in_parts(prepare, len(recording))
    return Clouds(points, normals, centers, line_ok, starts, table, origin)


def sweep_motion(recording: Recording) -> SE2 | None:
    """Base pose at the end of each sweep seen from its start, by odometry; None without a stream."""
    if recording.odometry is None or len(recording.odometry) < 2:
        return None
    sweep_ns = round(recording.lidar.time_increment * (recording.lidar.n_beams - 1) * 1e9)
    start = recording.odometry.at(recording.stamps_ns)
    return start.inverse() @ recording.odometry.at(recording.stamps_ns + sweep_ns)


def sweep_motion_by_track(recording: Recording, T_track_base: SE2) -> SE2:
    """As `sweep_motion`, from where the scans themselves were placed (n,): for logs without odometry.

    A scan that is not corrected yet is placed as of the middle of its sweep, so the speed during the
    sweep is the mean of those before and after.
    """
    sweep_s = recording.lidar.time_increment * (recording.lidar.n_beams - 1)
    seconds = np.diff(recording.stamps_ns) * 1e-9
    steps = (T_track_base[:-1].inverse() @ T_track_base[1:]).xyt
    known = (seconds > 0.0) & (seconds < LONGEST_STEP_S)
    speed = np.where(known[:, None], steps / np.where(known, seconds, 1.0)[:, None], 0.0)
    around = np.concatenate([speed[:1], speed, speed[-1:]])
    return SE2(0.5 * (around[:-1] + around[1:]) * sweep_s)


def _deskewed(points: Array, motion: SE2, scan_of: NDArray, fraction: Array) -> Array:
    """Each point moved into the base frame at the sweep's start, the base moving evenly."""
    delta = motion[scan_of].xyt * fraction[:, None]
    return SE2(delta) @ points


@njit(cache=True, nogil=True)
def _fit_lines(
    points: Array,
    starts: NDArray,
    origin: Array,
    increment: float,
    normals: Array,
    centers: Array,
    ok: NDArray,
) -> None:
    """Total least squares line through each point's neighbours in beam order, into the last three."""
    for scan in range(len(starts) - 1):
        lo, hi = starts[scan], starts[scan + 1]
        for i in range(lo, hi):
            px, py = points[i, 0], points[i, 1]
            distance = math.hypot(px - origin[0], py - origin[1])
            spacing = distance * increment
            radius = min(max(MIN_WINDOW_M, WINDOW_BEAMS * spacing), 2.0 * MAX_GAP_M)
            gap = min(max(0.5 * MIN_WINDOW_M, GRAZING * spacing), MAX_GAP_M)
            sx, sy, sxx, sxy, syy, count = 0.0, 0.0, 0.0, 0.0, 0.0, 1
            for step in (-1, 1):
                qx, qy = px, py
                j = i + step
                while lo <= j < hi:
                    x, y = points[j, 0], points[j, 1]
                    if math.hypot(x - qx, y - qy) > gap or math.hypot(x - px, y - py) > radius:
                        break
                    dx, dy = x - px, y - py
                    sx += dx
                    sy += dy
                    sxx += dx * dx
                    sxy += dx * dy
                    syy += dy * dy
                    count += 1
                    qx, qy = x, y
                    j += step
            if count < 3:
                continue
            mx, my = sx / count, sy / count
            cxx, cxy, cyy = sxx / count - mx * mx, sxy / count - mx * my, syy / count - my * my
            half = 0.5 * (cxx - cyy)
            root = math.sqrt(half * half + cxy * cxy)
            large, small = 0.5 * (cxx + cyy) + root, 0.5 * (cxx + cyy) - root
            if large < 1e-8 or small > 0.08 * large:
                continue
            angle = 0.5 * math.atan2(2.0 * cxy, cxx - cyy)
            nx, ny = -math.sin(angle), math.cos(angle)
            if nx * (origin[0] - px) + ny * (origin[1] - py) < 0.0:
                nx, ny = -nx, -ny
            normals[i, 0], normals[i, 1] = nx, ny
            centers[i, 0], centers[i, 1] = px + mx, py + my
            ok[i] = True


@njit(cache=True, nogil=True)
def _bearing_tables(points: Array, starts: NDArray, origin: Array, table: NDArray) -> None:
    """Row of the nearest point in each bearing bin about the lidar, per scan, into a table of -1."""
    n_bins = table.shape[1]
    scale = n_bins / (2.0 * math.pi)
    for scan in range(len(starts) - 1):
        for i in range(starts[scan], starts[scan + 1]):
            dx, dy = points[i, 0] - origin[0], points[i, 1] - origin[1]
            b = math.floor((math.atan2(dy, dx) + math.pi) * scale) % n_bins
            old = table[scan, b]
            if old >= 0:
                ox, oy = points[old, 0] - origin[0], points[old, 1] - origin[1]
                if ox * ox + oy * oy <= dx * dx + dy * dy:
                    continue
            table[scan, b] = i
