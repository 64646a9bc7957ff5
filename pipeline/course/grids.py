"""Lesson 5: grids."""

from __future__ import annotations

from functools import cache

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, maximum_filter

from turtlebag.datasets.grid import FREE, OCCUPIED, UNKNOWN, Cells, OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.course.contracts import GridMapper
from turtlebag.pipeline.course.lesson import Case, Lesson, once
from turtlebag.pipeline.course.rooms import CELL_M, NOISE_M, angles, draw_map, drive, true_map, true_ranges

GOOD, FAIR = 0.03, 0.12
SCANS, STEP_M = 30, 0.2
PERSON_M, AHEAD_M, STANDS = 0.2, 0.8, 4
"""Radius of somebody in the way, distance from the start, and for how many scans."""
LATER = 3
"""How often, for each hit of somebody, a beam must pass there later, for the cell to count as free."""
LEAST_CELLS = 8
"""Of somebody."""
SAMPLE_M = 0.02


@cache
def area() -> OccupancyGrid:
    """The true map in a grid that is larger at two sides: it must not look the same upside down."""
    grid = true_map()
    return OccupancyGrid(
        np.pad(grid.cells, ((0, 17), (0, 9)), constant_values=UNKNOWN), CELL_M, grid.T_map_grid
    )


def make(rng: np.random.Generator) -> Case:
    """Scans of a drive, in the first of which somebody stands in the way, and the map as far as seen.

    The truth is 1 for walls, 0 for free cells, -1 where somebody stood and later nobody, 0.5 elsewhere.
    """
    truth = np.zeros(0)
    while np.sum(truth < 0.0) < LEAST_CELLS:
        poses = drive(rng, SCANS - 1, STEP_M)
        clean = np.array([true_ranges(pose) for pose in poses])
        ranges, somebody = clean.copy(), SE2.from_array(poses[0]) @ np.array([AHEAD_M, 0.0])
        for k in range(STANDS):
            ranges[k] = np.minimum(ranges[k], to_circle(poses[k], somebody))
        truth = truth_of(poses, clean, ranges)
    noisy = ranges + NOISE_M * rng.standard_normal(ranges.shape)
    asked = {"poses": poses, "ranges": noisy, "angles": angles()}
    new = {"resolution": CELL_M, "origin": area().T_map_grid.xy, "shape": np.array(area().shape)}
    return Case(new, (asked,), truth)


def truth_of(poses: Array, clean: Array, ranges: Array) -> Array:
    """What a map of these scans should be, (rows, cols)."""
    room = distance_transform_edt(area().cells == FREE)
    passed, hit = seen(poses, clean)
    later, _ = seen(poses[STANDS:], clean[STANDS:])
    _, somebody = seen(poses[:STANDS], ranges[:STANDS])
    truth = np.full(area().shape, 0.5)
    truth[(passed > 1) & (room > 1.5)] = 0.0
    stood = (somebody > 0) & (room > 2.0)
    truth[stood] = np.where(later >= LATER * somebody, -1.0, 0.5)[stood]
    truth[(hit > 0) & (area().cells == OCCUPIED)] = 1.0
    return truth


def to_circle(pose: Array, middle: Array) -> Array:
    """Range of each beam to somebody, (m,) [m]; inf where it misses."""
    x, y = middle - pose[:2]
    beams = pose[2] + angles()
    along = x * np.cos(beams) + y * np.sin(beams)
    inside = PERSON_M**2 - (x**2 + y**2) + along**2
    return np.where((inside > 0.0) & (along > 0.0), along - np.sqrt(np.maximum(inside, 0.0)), np.inf)


def seen(poses: Array, ranges: Array) -> tuple[Cells, Cells]:
    """In how many scans beams pass through each cell, and in how many one ends in it, (rows, cols) each."""
    passed, hit = np.zeros(area().shape, np.int64), np.zeros(area().shape, np.int64)
    along = np.arange(0.0, 3.5, SAMPLE_M)[:, None]
    for pose, row in zip(poses, ranges, strict=True):
        beams = np.stack([np.cos(pose[2] + angles()), np.sin(pose[2] + angles())], axis=-1)
        passed += mask((pose[:2] + along[..., None] * beams)[along < row - CELL_M])
        hit += mask((pose[:2] + (row[:, None] + 1e-3) * beams)[np.isfinite(row)])
    return passed, hit


def mask(points: Array) -> NDArray[np.bool_]:
    """The cells in which points (n, 2) lie, (rows, cols)."""
    cells = area().cell_of(points)
    cells = cells[area().contains(cells)]
    inside = np.zeros(area().shape, bool)
    inside[cells[:, 0], cells[:, 1]] = True
    return inside


def shares(case: Case, answer: Array) -> tuple[float, float, float]:
    """Shares of the free cells, the walls and the cells where somebody stood that are wrong."""
    near = maximum_filter(answer, size=3) > 0.5
    wrong = (answer[case.truth == 0.0] >= 0.5, ~near[case.truth == 1.0], answer[case.truth == -1.0] >= 0.5)
    free, walls, person = (float(one.mean()) if len(one) else 0.0 for one in wrong)
    return free, walls, person


def error(case: Case, answer: Array) -> float:
    """The largest share of cells that are wrong; 1 for what is no probability."""
    return 1.0 if answer.min() < 0.0 or answer.max() > 1.0 else max(shares(case, answer))


def words(case: Case, answer: Array) -> str:
    """Which mistake it looks like."""
    if answer.min() < 0.0 or answer.max() > 1.0:
        span = f"{answer.min():.1f} to {answer.max():.1f}"
        return f"not probabilities: {span}; that of log odds l is 1 / (1 + exp(-l))"
    free, walls, person = shares(case, answer)
    usual = {
        "upside down: row 0 must have the lowest y": answer[::-1],
        "left and right are exchanged: column 0 must have the lowest x": answer[:, ::-1],
        "occupied and free are exchanged": 1.0 - answer,
    }
    for said, mended in usual.items():
        if max(shares(case, mended)) <= FAIR < max(free, walls):
            return said
    if free > max(FAIR, walls):
        return f"{100 * free:.0f} % of the free cells are not free: beams clear what they pass"
    if walls > FAIR:
        return f"{100 * walls:.0f} % of the walls are missing"
    if person > FAIR:
        return "where somebody stood it is still occupied: beams that pass later must lower the probability"
    return f"{100 * free:.0f} % of the free cells and {100 * walls:.0f} % of the walls are wrong"


def draw(axes: Axes, case: Case, result: Array | None, colour: str) -> None:
    """The map, dark where it is occupied."""
    draw_map(axes)
    if result is not None:
        shown = np.where(result < 0.0, 0.0, result)
        axes.imshow(shown, cmap="Greys", vmin=0.0, vmax=1.0, origin="lower", extent=area().extent())
        axes.plot(*case.questions[0]["poses"][:, :2].T, ".", markersize=2, color=colour)


LESSON = Lesson(
    5, "Grids", (GridMapper,), "of the cells", GOOD, FAIR, make, once, error, words, draw,
)  # fmt: skip
