"""The scans of a log as points with surface lines, the input of all matching.

Points of all scans lie in one array, scan i in rows `starts[i]:starts[i + 1]`; the numba kernels take
the tuple whole. Each point carries the line fitted to its neighbours on the same
surface; where there is none (lone returns, corners of the visible part) `line_ok` is False.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.deskew import deskewed
from turtlebag.datasets.kernels import njit
from turtlebag.datasets.lidars import returns, runs
from turtlebag.datasets.motion import known_motion
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.threads import in_parts
from turtlebag.datasets.types import NOTHING_M, Recording
from turtlebag.pipeline.slam.scans.range_noise import LEAST_M, RangeNoise, range_noise

# A scan with fewer points, or fewer points with a surface line, cannot be matched; nor are lines used if most
# points have none: posts, table legs, thin trunks.
MIN_LINES, LINE_SHARE = 8, 0.3
# Returns up to this far apart [m], or this many beam spacings of a perpendicular hit, may lie on one surface:
# at a grazing angle, those of a wall are far apart. With the reach in place of both, acapulco, the long
# corridor and ACES get worse by up to a tenth.
MIN_GAP_M, GRAZING = 0.06, 6.0
# A line extends this far from its point [m], or this many beam spacings, and on to MAX_REACH_M while its
# direction is less certain than it should be.
MIN_REACH_M, REACH_BEAMS, MAX_REACH_M, SURE_RAD = 0.12, 4.0, 0.6, 0.04
# A line is rejected if its returns deviate from it by more than noise explains, at one error in a thousand.
Z_SURFACE = 3.09
# A line whose direction is less certain than this is not used.
UNSURE_RAD = 0.3


class Clouds(NamedTuple):
    """Points of many scans; `points`, `normals`, `centers` are (m, 2) in the base frame at the scan's stamp.

    `normals` are unit vectors towards the sensor, `centers` a point of the fitted line (its centroid);
    `point_var` is the variance of each point along its normal [m^2], `normal_var` that of the normal's
    direction [rad^2]; `table` is (n_scans, n_bins): for a bearing about the lidar, the row of the point
    seen there, or -1. What is fitted is in single precision: 2 micrometres at 30 m. `sensor` (n_scans,) says
    which lidar took each scan; `origin` (lidars, 2) is where it sits, and of the columns of `table` the first
    `bins` (lidars,) are its own.
    """

    points: Array
    normals: NDArray[np.float32]
    centers: NDArray[np.float32]
    line_ok: NDArray[np.bool_]
    point_var: NDArray[np.float32]
    normal_var: NDArray[np.float32]
    starts: NDArray[np.int64]
    table: NDArray[np.int32]
    origin: Array
    bins: NDArray[np.int64]
    sensor: NDArray[np.uint8]

    def of(self, scan: int) -> Array:
        """Points of one scan, (k, 2)."""
        return self.points[self.starts[scan] : self.starts[scan + 1]]

    def origins(self) -> Array:
        """Where the lidar sits that measured each point, (m, 2), or (1, 2) if it is the only one."""
        if len(self.origin) == 1:
            return self.origin
        return np.repeat(self.origin[self.sensor], np.diff(self.starts), axis=0)

    def lines(self, scan: int) -> int:
        """Points of one scan that have a surface line."""
        return int(np.count_nonzero(self.line_ok[self.starts[scan] : self.starts[scan + 1]]))

    def has_lines(self, scan: int) -> bool:
        """Whether a scan can be matched by lines at all."""
        return self.lines(scan) >= MIN_LINES

    def placed_by(self, scan: int) -> Literal["lines", "points", "nothing"]:
        """Whether a scan is matched by lines or by points."""
        points, lines = int(self.starts[scan + 1] - self.starts[scan]), self.lines(scan)
        if lines >= max(MIN_LINES, LINE_SHARE * points):
            return "lines"
        return "points" if points >= MIN_LINES else "nothing"


class KeyScans(NamedTuple):
    """The key scans of a log: `keys` (k,) are their numbers in the clouds."""

    clouds: Clouds
    keys: NDArray[np.int64]


PER_POINT = ("points", "normals", "centers", "line_ok", "point_var", "normal_var")
"""The arrays of Clouds with a row for each point."""


def point_information(points: Array) -> Array:
    """Information (3, 3) about the pose from matched points (n, 2), for errors of 1 m each."""
    n, (x, y) = len(points), points.sum(axis=0)
    return np.array([[n, 0.0, -y], [0.0, n, x], [-y, x, float((points**2).sum())]])


def make_clouds(
    recording: Recording,
    usable_range: float,
    motion: SE2 | None = None,
    noise: RangeNoise | None = None,
    scans: NDArray[np.int64] | None = None,
) -> Clouds:
    """Deskewed points of every scan, or of `scans` (k,) numbered anew.

    `motion` (n, KNOTS) is the base's during each sweep as `sweep_motion` gives it; None uses the log's own
    odometry where the beams are taken one after another. `noise` is the lidar's; None estimates it from the
    log.
    """
    noise = range_noise(recording, usable_range) if noise is None else noise
    some = slice(None) if scans is None else scans
    readings, knots = recording.ranges[some], known_motion(recording, motion)[some].xyt
    lidars, sensor = recording.lidars, recording.lidar_of[some]
    valid = returns(recording, some) & (readings <= usable_range)
    starts = np.concatenate([[0], np.cumsum(valid.sum(axis=1))]).astype(np.int64)
    points, point_var = np.empty((starts[-1], 2)), np.empty(starts[-1], dtype=np.float32)
    origin = np.array([lidar.T_base_lidar.xy for lidar in lidars], dtype=np.float64)
    increments = [abs(part.lidar.angle_increment) * part.stride for _, part in recording.parts()]
    bins = np.array([max(8, round(2.0 * math.pi / increment)) for increment in increments])
    normals, centers = (np.zeros(points.shape, dtype=np.float32) for _ in range(2))
    line_ok, normal_var = np.zeros(len(points), dtype=np.bool_), np.zeros(len(points), dtype=np.float32)
    table = np.full((len(readings), bins.max()), -1, dtype=np.int32)
    fitted = normals, centers, line_ok, point_var, normal_var

    def prepare(rows: slice) -> None:
        for run in runs(sensor, rows):
            k = int(sensor[run.start])
            part, spec = starts[run.start : run.stop + 1], lidars[k].spec
            these, seen = slice(part[0], part[-1]), valid[run, : spec.n_beams]
            ranges = readings[run, : spec.n_beams][seen].astype(np.float64)
            beams = spec.directions, spec.shares
            _place(seen, ranges, beams, lidars[k].T_base_lidar.xyt, knots[run], points[these])
            centers[these], point_var[these] = points[these], noise.of(k).variance(ranges)
            fit_lines(points, part, origin[k], increments[k], fitted)
            bearing_tables(points, part, origin[k], table[run, : bins[k]])

    in_parts(prepare, len(readings))
    return Clouds(points, *fitted, starts, table, origin, bins, sensor)


@njit(cache=True, nogil=True)
def _place(
    valid: NDArray,
    ranges: Array,
    beams: tuple[Array, Array],
    T_base_lidar: Array,
    motion: Array,
    points: Array,
) -> None:
    """End points of the valid beams (n, beams) with these ranges (m,), in the base frame at the sweep's
    start; `beams` are their unit vectors and when in the sweep they are taken."""
    row = 0
    for scan in range(len(valid)):
        origins, directions = deskewed(beams[0], beams[1], T_base_lidar, motion[scan])
        for beam in np.flatnonzero(valid[scan]):
            points[row, 0] = origins[beam, 0] + ranges[row] * directions[beam, 0]
            points[row, 1] = origins[beam, 1] + ranges[row] * directions[beam, 1]
            row += 1


class Line(NamedTuple):
    """A line through a point and some of its neighbours: cosine and sine of twice its direction, its centroid
    from the point [m], the variance along its normal [m^2] and that of its direction [rad^2]."""

    cos2: float
    sin2: float
    mx: float
    my: float
    var: float
    turn_var: float


@njit(cache=True, nogil=True)
def fit_lines(
    points: Array, starts: NDArray, origin: Array, increment: float, lines: tuple[NDArray, ...]
) -> None:
    """Total least squares line through each point's neighbours in beam order, into `lines`: normals, centers,
    line_ok, point_var, normal_var.

    The line grows beam by beam to both sides as long as its residuals pass a chi-squared test against the
    noise, up to the reach that makes its direction certain enough. `point_var` comes in as the variance of
    the ranges.
    """
    normals, centers, ok, point_var, normal_var = lines
    # Allocated once, because numba counts references to a list at every access, with atomic operations.
    ends, alive = np.zeros(2, dtype=np.int64), np.zeros(2, dtype=np.bool_)
    for scan in range(len(starts) - 1):
        for i in range(starts[scan], starts[scan + 1]):
            px, py = points[i, 0], points[i, 1]
            ray_x, ray_y = px - origin[0], py - origin[1]
            distance = math.hypot(ray_x, ray_y)
            ray = ray_x / max(distance, NOTHING_M), ray_y / max(distance, NOTHING_M)
            beams, range_var = (starts[scan], starts[scan + 1]), np.float64(point_var[i])
            windows = search_windows(distance * increment, range_var)
            count, line = grow_line(points, i, beams, ray, windows, range_var, ends, alive)
            if count < 3 or line.turn_var > UNSURE_RAD * UNSURE_RAD:
                continue
            normals[i, 0], normals[i, 1] = facing_normal(line.cos2, line.sin2, ray)
            centers[i, 0], centers[i, 1] = px + line.mx, py + line.my
            point_var[i], normal_var[i] = line.var, line.turn_var
            ok[i] = True


@njit(cache=True, forceinline=True, _nrt=False)
def search_windows(spacing: float, range_var: float) -> tuple[float, float, float]:
    """Squares of how far a line extends, how far it may, and how far successive returns on it are apart
    [m^2], where beams are so far apart [m]."""
    reach = min(max(MIN_REACH_M, REACH_BEAMS * spacing), 2.0 * MAX_REACH_M)
    gap = min(max(MIN_GAP_M, GRAZING * spacing), MAX_REACH_M)
    # the noise also separates neighbours
    return reach**2, max(MAX_REACH_M, reach) ** 2, gap**2 + 2.0 * Z_SURFACE**2 * range_var


@njit(cache=True, forceinline=True, _nrt=False)
def grow_line(
    points: Array,
    i: int,
    beams: tuple[int, int],
    ray: tuple[float, float],
    windows: tuple[float, float, float],
    range_var: float,
    ends: NDArray,
    alive: NDArray,
) -> tuple[int, Line]:
    """The line through point `i` and its neighbours within `beams`, and the number of its points. `ends` and
    `alive` (2,), of its two sides, are overwritten."""
    (reach2, farthest2, gap2), (px, py) = windows, (points[i, 0], points[i, 1])
    sums, count = (0.0, 0.0, 0.0, 0.0, 0.0), 1
    line = Line(1.0, 0.0, 0.0, 0.0, range_var, math.inf)
    ends[:], alive[:] = i, True
    while alive[0] or alive[1]:
        for side in range(2):
            if not alive[side]:
                continue
            last = ends[side]
            j = last - 1 if side == 0 else last + 1
            alive[side] = False
            if j < beams[0] or j >= beams[1]:
                continue
            x, y = points[j, 0], points[j, 1]
            dx, dy, lx, ly = x - px, y - py, x - points[last, 0], y - points[last, 1]
            off2 = dx * dx + dy * dy
            too_far = off2 > reach2 and (off2 > farthest2 or line.turn_var < SURE_RAD * SURE_RAD)
            if too_far or lx * lx + ly * ly > gap2:
                continue
            more = (sums[0] + dx, sums[1] + dy, sums[2] + dx * dx, sums[3] + dx * dy, sums[4] + dy * dy)
            longer, misfit = line_through(more, count + 1, ray, range_var)
            if count >= 2 and misfit > longer.var * chi_squared_limit(count - 1):
                continue
            alive[side], ends[side] = True, j
            sums, line = more, longer
            count += 1
    return count, line


@njit(cache=True, forceinline=True, _nrt=False)
def line_through(
    sums: tuple[float, float, float, float, float], n: int, ray: tuple[float, float], range_var: float
) -> tuple[Line, float]:
    """The line of n points, by the sums of their x, y, xx, xy, yy [m, m^2], and the sum of its squared
    residuals [m^2]; the noise of their ranges [m^2] lies along `ray`."""
    (sx, sy, sxx, sxy, syy), (ray_x, ray_y) = sums, ray
    ray_xx, ray_xy, ray_yy = ray_x * ray_x, ray_x * ray_y, ray_y * ray_y
    ax, ay = sx / n, sy / n
    cxx, cxy, cyy = sxx / n - ax * ax, sxy / n - ax * ay, syy / n - ay * ay
    # the noise lies along the rays: left in, it would turn the line towards them
    own = range_var * (n - 1) / n
    half = 0.5 * (cxx - cyy - own * (ray_xx - ray_yy))
    mixed = cxy - own * ray_xy
    root = math.sqrt(half * half + mixed * mixed)
    large = 0.5 * (cxx + cyy - own) + root
    # cosine and sine of twice the line's direction, and its normal's square along the ray
    c2, s2 = (half / root, mixed / root) if root > 0.0 else (1.0, 0.0)
    small = max(0.5 * (cxx + cyy) - 0.5 * (cxx - cyy) * c2 - cxy * s2, 0.0)
    across2 = 0.5 * ((1.0 - c2) * ray_xx - 2.0 * s2 * ray_xy + (1.0 + c2) * ray_yy)
    # a few returns close together do not determine the angle between line and ray
    spread = max(n * large, LEAST_M * LEAST_M)
    noise = range_var * min(1.0, across2 + range_var / spread) + LEAST_M * LEAST_M
    return Line(c2, s2, ax, ay, noise, noise / spread), n * small


@njit(cache=True, forceinline=True, _nrt=False)
def facing_normal(cos2: float, sin2: float, ray: tuple[float, float]) -> tuple[float, float]:
    """Unit normal of a line, against the ray, from cosine and sine of twice the line's direction."""
    # of the half angle, by the larger of its two parts
    if cos2 > 0.0:
        ny = math.sqrt(0.5 * (1.0 + cos2))
        nx = -0.5 * sin2 / ny
    else:
        nx = -math.sqrt(0.5 * (1.0 - cos2))
        ny = -0.5 * sin2 / nx
    return (-nx, -ny) if nx * ray[0] + ny * ray[1] > 0.0 else (nx, ny)


@njit(cache=True, nogil=True)
def chi_squared_limit(freedom: int) -> float:
    """The chi-squared that noise alone exceeds as rarely as Z_SURFACE says (Wilson and Hilferty 1931)."""
    share = 2.0 / (9.0 * freedom)
    return freedom * (1.0 - share + Z_SURFACE * math.sqrt(share)) ** 3


@njit(cache=True, nogil=True)
def bearing_tables(points: Array, starts: NDArray, origin: Array, table: NDArray) -> None:
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
