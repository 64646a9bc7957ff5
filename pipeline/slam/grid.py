"""Occupancy grid from posed scans: hits and misses along every beam, also those without return.

The reflectance model of Haehnel (2004), in the line of Moravec and Elfes (1985): a cell is occupied when
enough of the beams that met it were returned by it. Unlike summed log-odds this keeps a wall that many beams
graze. Beams without return (+inf) clear in a second pass, up to the first surface. Cells are rastered exactly
(Amanatides and Woo 1987), so no cell a beam crosses is missed or counted twice.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray
from pydantic import Field

from turtlebag.datasets.deskew import deskewed
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import FREE, MAX_CELLS, OCCUPIED, UNKNOWN, OccupancyGrid
from turtlebag.datasets.kernels import njit
from turtlebag.datasets.motion import known_motion
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.types import LidarSpec, MountedLidar, Recording
from turtlebag.pipeline.slam.thin_walls import BEHIND_CELLS, thin

MAX_COUNTED = 400_000_000
"""Cells for counting beams; most are cut off when the map is trimmed to its known part."""
# Cells of a band of the grid.
BAND_CELLS = 2_000_000
# Cells with fewer beams than this are not used for the quality of a map.
MIN_MET = 3


class OccupancyConfig(Settings):
    """The occupancy grid."""

    resolution_m: float = Field(default=0.05, ge=0.001, le=1.0, description="side of a cell")
    occupied_share: float = Field(
        default=0.25,
        gt=0.0,
        lt=1.0,
        description="a cell is occupied if at least this share of its beams end in it",
    )
    min_hits: int = Field(default=2, ge=1, description="minimum number of returns for an occupied cell")
    behind_share: float = Field(
        default=0.5,
        ge=0.0,
        le=1.0,
        description="behind a wall a cell stays occupied with at least this share of the wall's hits",
    )
    before_share: float = Field(
        default=0.25,
        ge=0.0,
        le=1.0,
        description="in front of a wall a cell stays occupied with at least this share of the wall's hits",
    )
    margin_m: float = Field(default=0.5, ge=0.0, le=100.0, description="margin around the observed area")
    no_return_m: float = Field(
        default=8.0, ge=0.0, description="range that a beam without return clears; 0: none"
    )


class CheckedGrid(NamedTuple):
    """A grid, how certain its cells are as a whole, and the `confidence` of each (rows, cols), as
    `cell_confidence` gives it."""

    grid: OccupancyGrid
    certainty: Certainty
    confidence: NDArray[np.uint8]


class Counts(NamedTuple):
    """For each cell (rows, cols), how many beams it returned, and how many passed through it."""

    hits: NDArray[np.uint16]
    misses: NDArray[np.uint16]

    @classmethod
    def none(cls, rows: int, cols: int) -> Counts:
        """No beams so far."""
        return cls(*np.zeros((2, rows, cols), dtype=np.uint16))


@dataclass(frozen=True)
class Certainty:
    """How certain the cells are: mean entropy of the cells with at least MIN_MET beams [bit], and the share
    of beams returned by a wall's cells among those that reached them; NaN without such cells."""

    entropy_bits: float
    wall_share: float


def make_grid(
    recording: Recording,
    T_map_base: SE2,
    config: OccupancyConfig,
    usable_range: float,
    motion: SE2 | None = None,
) -> OccupancyGrid:
    """Grid of all scans at poses (n,); cell borders lie on multiples of the resolution."""
    return make_checked_grid(recording, T_map_base, config, usable_range, motion).grid


def make_checked_grid(
    recording: Recording,
    T_map_base: SE2,
    config: OccupancyConfig,
    usable_range: float,
    motion: SE2 | None = None,
) -> CheckedGrid:
    """As `make_grid`, with the quality of the counts behind it."""
    resolution, views = config.resolution_m, _views(recording, T_map_base, config, usable_range)
    seen = [view.length.max(axis=1)[:, None] for view in views]
    ends = zip(views, seen, strict=True)
    spans = [((v.T_map_lidar.xy - s).min(axis=0), (v.T_map_lidar.xy + s).max(axis=0)) for v, s in ends]
    low, high = np.min([low for low, _ in spans], axis=0), np.max([high for _, high in spans], axis=0)
    corner = np.floor((low - config.margin_m) / resolution)
    extent = np.ceil((high + config.margin_m) / resolution) - corner
    _require_cells(extent[::-1].tolist(), MAX_COUNTED, resolution)
    cols, rows = extent.astype(int)
    knots = known_motion(recording, motion).xyt
    if rows * cols > MAX_CELLS and not knots.any():
        # much of the counted area may be trimmed, so only an area that is too large for certain is refused
        _require_cells(_known(views, resolution), MAX_CELLS, resolution)
    counts, T_grid_base = Counts.none(rows, cols), T_map_base.xyt - np.array([*(corner * resolution), 0.0])
    for with_return in (True, False):
        for view in views:
            spec, beams = view.lidar.spec, (view.length, view.returned == with_return)
            seen_from = (spec.directions, spec.shares, view.lidar.T_base_lidar.xyt, knots[view.scans])
            how = with_return, config.occupied_share
            cast_beams(counts, resolution, beams, seen_from, T_grid_base[view.scans], how)
    grid = trimmed(classify(counts, config), corner, config)
    col, row = np.rint(grid.T_map_grid.xy / resolution - corner).astype(int)
    kept = (slice(row, row + grid.shape[0]), slice(col, col + grid.shape[1]))
    confidence = cell_confidence(grid.cells, Counts(*(c[kept] for c in counts)), config.occupied_share)
    return CheckedGrid(grid, certainty(counts, config.min_hits), confidence)


def cell_confidence(cells: NDArray[np.int8], counts: Counts, occupied_share: float) -> NDArray[np.uint8]:
    """The probability, in 255ths, that each cell (rows, cols) is as it is drawn: that of many more beams it
    would return `occupied_share`, or fewer where it is free (Beta distribution, Jeffreys' prior); 0 where it
    is unknown."""
    confidence = np.zeros(cells.shape, dtype=np.uint8)
    for rows in bands(cells):
        known = cells[rows] != UNKNOWN
        # few different numbers of hits and misses occur, so each pair of them is computed once
        pair = counts.hits[rows][known].astype(np.uint32) << 16 | counts.misses[rows][known]
        pairs, which = np.unique(pair, return_inverse=True)
        free = scipy.special.betainc((pairs >> 16) + 0.5, (pairs & 0xFFFF) + 0.5, occupied_share)
        surely = np.rint(255.0 * free).astype(np.uint8)[which]
        confidence[rows][known] = np.where(cells[rows][known] == OCCUPIED, 255 - surely, surely)
    return confidence


class View(NamedTuple):
    """The scans (k,) of one lidar among all, its poses (k,), and its beams, as of `beam_lengths`."""

    scans: NDArray[np.int64]
    lidar: MountedLidar
    T_map_lidar: SE2
    length: NDArray[np.float32]
    returned: NDArray[np.bool_]


def _views(recording: Recording, T_map_base: SE2, config: OccupancyConfig, usable_range: float) -> list[View]:
    views = []
    for (scans, part), lidar in zip(recording.parts(), recording.lidars, strict=True):
        usable = min(part.lidar.range_max, usable_range)
        no_return = min(usable, config.no_return_m)
        beams = beam_lengths(np.asarray(part.ranges), part.lidar, usable, no_return, part.stride)
        if len(scans):
            views.append(View(scans, lidar, T_map_base[scans] @ part.T_base_lidar, *beams))
    return views


def certainty(counts: Counts, min_hits: int) -> Certainty:
    """How well the beams agree on the cells: a wall that is drawn twice is seen through, and so uncertain."""
    sums = np.zeros(4)
    for rows in bands(counts.hits):
        hits, misses = counts.hits[rows], counts.misses[rows]
        met = hits.astype(np.int32) + misses
        known = met >= MIN_MET
        share, walls = hits[known] / met[known], hits[known] >= min_hits
        entropy = scipy.special.entr(share) + scipy.special.entr(1.0 - share)
        sums += [entropy.sum(), len(share), share[walls].sum(), np.count_nonzero(walls)]
    entropy_nats, cells, wall_shares, wall_cells = sums.tolist()
    if cells == 0:
        return Certainty(math.nan, math.nan)
    wall_share = wall_shares / wall_cells if wall_cells else math.nan
    return Certainty(entropy_nats / cells / math.log(2.0), wall_share)


def bands(cells: NDArray[Any]) -> Iterator[slice]:
    """Rows of cells (rows, cols) in small bands: what is computed of all at once takes much memory."""
    rows, cols = cells.shape
    height = max(1, BAND_CELLS // max(cols, 1))
    yield from (slice(row, row + height) for row in range(0, rows, height))


def beam_lengths(
    ranges: NDArray[np.float32], lidar: LidarSpec, usable: float, no_return: float, stride: int = 1
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Length over which each beam is free [m], and whether it ends on a surface, (n, beams) each.

    A lone beam without return between two returns is a dropout, not open space, and is not used. Neighbours
    are about `stride` beams away.
    """
    surface, nothing = lidar.returns(ranges), lidar.silent(ranges)
    returned, far = surface & (ranges <= usable), surface & (ranges > usable)
    open_space, beams = np.zeros_like(nothing), ranges.shape[1]
    for apart in range(stride - stride // 4, stride + stride // 4 + 1):
        padded = np.pad(nothing | far, ((0, 0), (apart, apart)), mode="edge")
        open_space |= nothing & (padded[:, :beams] | padded[:, -beams:])
    length = open_space * np.float32(no_return)
    length[far] = usable
    np.copyto(length, ranges, where=returned)
    return length, returned


def classify(counts: Counts, config: OccupancyConfig) -> NDArray[np.int8]:
    """Occupied, free or unknown: equation (6) of docs/how-it-maps.md, and walls thinned."""
    cells = np.full(counts.hits.shape, UNKNOWN, dtype=np.int8)
    for rows in bands(cells):
        hits, band = counts.hits[rows], cells[rows]
        seen = hits.astype(np.int32) + counts.misses[rows]
        band[seen > hits] = FREE
        band[(hits >= config.min_hits) & (hits >= config.occupied_share * seen)] = OCCUPIED
    thin(cells, counts.hits, config.behind_share, config.before_share)
    return cells


def trimmed(cells: NDArray[np.int8], corner: Array, config: OccupancyConfig) -> OccupancyGrid:
    """The known part of cells (rows, cols) with a margin; `corner` is in cells, x first. InputError if the
    map is too large for any program."""
    known_rows = np.flatnonzero((cells != UNKNOWN).any(axis=1))
    known_cols = np.flatnonzero((cells != UNKNOWN).any(axis=0))
    if len(known_rows) == 0:
        known_rows = known_cols = np.array([0])
    border = math.ceil(config.margin_m / config.resolution_m)
    r0, r1 = max(known_rows[0] - border, 0), known_rows[-1] + border + 1
    c0, c1 = max(known_cols[0] - border, 0), known_cols[-1] + border + 1
    kept = cells[r0:r1, c0:c1].copy()
    _require_cells(kept.shape, MAX_CELLS, config.resolution_m)
    x, y = (corner + np.array([c0, r0])) * config.resolution_m
    return OccupancyGrid(kept, config.resolution_m, SE2.from_xyt(x, y, 0.0))


def _known(views: Sequence[View], resolution: float) -> tuple[int, int]:
    """The least rows and columns of the map: beams that returned passed all cells but the last, whose return
    may have overshot."""
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for _, lidar, T_map_lidar, length, returned in views:
        free = np.where(returned, length, 0.0)
        for angle, reach in zip(lidar.spec.angles.tolist(), free.T, strict=True):
            yaw, passed = T_map_lidar.yaw + angle, np.maximum(reach - (BEHIND_CELLS + 1) * resolution, 0.0)
            ends = T_map_lidar.xy + passed[:, None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
            low, high = np.minimum(low, ends.min(axis=0)), np.maximum(high, ends.max(axis=0))
    cols, rows = np.floor((high - low) / resolution).astype(int).tolist()
    return rows, cols


def _require_cells(shape: Sequence[float], most: int, resolution: float) -> None:
    """InputError for more cells than allowed, naming a resolution [m] that leaves a tenth to spare."""
    rows, cols = shape
    if rows * cols > most:
        fits = 1.1 * resolution * math.sqrt(rows / most * cols)
        raise InputError(
            f"the map would have {rows:.12g} x {cols:.12g} cells; choose a larger grid.resolution_m, "
            f"{fits:.2g} m say (it is {resolution:g} m)"
        )


@njit(cache=True)
def cast_beams(
    counts: Counts,
    resolution: float,
    beams: tuple[NDArray, NDArray],
    lidar: tuple[Array, Array, Array, Array],
    T_grid_base: Array,
    how: tuple[bool, float],
) -> None:
    """Trace some beams of one lidar: those that returned first, and then those that did not, which surfaces
    stop.

    `beams` are lengths, as of `beam_lengths`, and which to trace; `lidar` are the unit vectors of the beams,
    when in the sweep they are taken, T_base_lidar, and the base's motion during each sweep, as of
    `known_motion`. `how` says whether they returned, and the share of hits of a surface.
    """
    (length, chosen), (directions, fractions, T_base_lidar, motion) = beams, lidar
    n_scans, n_beams = length.shape
    for scan in range(n_scans):
        origins, ways = deskewed(directions, fractions, T_base_lidar, motion[scan])
        c, s = math.cos(T_grid_base[scan, 2]), math.sin(T_grid_base[scan, 2])
        for beam in range(n_beams):
            reach = float(length[scan, beam])
            if reach <= 0.0 or not chosen[scan, beam]:
                continue
            x = T_grid_base[scan, 0] + c * origins[beam, 0] - s * origins[beam, 1]
            y = T_grid_base[scan, 1] + s * origins[beam, 0] + c * origins[beam, 1]
            dx = c * ways[beam, 0] - s * ways[beam, 1]
            dy = s * ways[beam, 0] + c * ways[beam, 1]
            trace(counts, (x / resolution, y / resolution), (dx, dy), reach / resolution, how[0], how[1])


@njit(cache=True)
def trace(
    counts: Counts,
    start: tuple[float, float],
    direction: tuple[float, float],
    length: float,
    returned: bool,
    share: float,
) -> None:
    """Count one beam from `start` (x, y) along the unit vector `direction`, all in cells.

    The cell before the return is spared: range noise and the wall's own thickness put returns there.
    A beam without return ends at the first cell that others saw occupied.
    """
    (hits, misses), (x, y), (dx, dy) = counts, start, direction
    rows, cols = hits.shape
    col, row = math.floor(x), math.floor(y)
    end_col, end_row = math.floor(x + dx * length), math.floor(y + dy * length)
    step_c, step_r = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    next_c = ((col + (step_c > 0)) - x) / dx if dx != 0.0 else math.inf
    next_r = ((row + (step_r > 0)) - y) / dy if dy != 0.0 else math.inf
    delta_c = abs(1.0 / dx) if dx != 0.0 else math.inf
    delta_r = abs(1.0 / dy) if dy != 0.0 else math.inf
    spared = length - 1.0 if returned else length
    while not (col == end_col and row == end_row):
        leave = min(next_c, next_r)
        if 0 <= row < rows and 0 <= col < cols:
            if leave > spared and misses[row, col] > 0:
                break
            if not returned and hits[row, col] > share * (hits[row, col] + misses[row, col]):
                return
            if misses[row, col] < 65535:
                misses[row, col] += 1
        if leave > length:
            break
        if next_c < next_r:
            col += step_c
            next_c += delta_c
        else:
            row += step_r
            next_r += delta_r
    if returned and 0 <= end_row < rows and 0 <= end_col < cols and hits[end_row, end_col] < 65535:
        hits[end_row, end_col] += 1
