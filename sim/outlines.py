"""Outlines of the marked cells of a grid: closed, and as straight as the cells allow."""

from __future__ import annotations

import contourpy
import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.se2 import Array

Mask = NDArray[np.bool_]
TOLERANCES_CELLS = (0.6, 0.5, 0.35)
"""How far an outline may be moved to make it straight: the first with which the cells stay what they are. A
contour passes every cell's centre at 0.354 cells at least, so that with the last no cell can change."""
LEAST_EQUAL = 0.995
"""Share of the marked cells, and of the others, that must stay what they are; all others within one cell."""
SMALLEST = 8
"""Corners and middles of a single cell's outline, which stays what it is."""
SINGLE = 5
"""Points of a single cell's contour, whose last one is its first."""
EIGHT = np.ones((3, 3), dtype=np.bool_)


def outlines(marked: Mask) -> list[Array]:
    """Closed outlines (n, 2), x and y in cells from the grid's outer corner, of marked cells (rows, cols).

    The first point is not repeated. Cells that touch at a corner belong together, so that no beam passes
    between them. Rasterised again (`filled`) they are nearly the marked cells, see LEAST_EQUAL.
    """
    rows, cols = np.nonzero(marked)
    if len(rows) == 0:
        return []
    corner = np.array([cols.min(), rows.min()])
    part = marked[rows.min() : rows.max() + 1, cols.min() : cols.max() + 1]
    padded = np.pad(part, 1)
    touching = _touching(padded)
    chains = [_chain(np.round(2.0 * line[:-1]) / 2.0, touching) for line in _contours(padded)]
    for tolerance in TOLERANCES_CELLS:
        lines = [_simplified(*chain, tolerance) for chain in chains]
        if tolerance == TOLERANCES_CELLS[-1] or _is_equal(filled(lines, padded.shape, 0.0), padded):
            break
    return [line - 0.5 + corner for line in lines]


def least_corners(marked: Mask) -> int:
    """What the outlines of marked cells (rows, cols) have at least, told before they are made straight: four
    corners round a single cell, three round others."""
    return sum(4 if len(line) == SINGLE else 3 for line in _contours(np.pad(marked, 1)))


def filled(lines: list[Array], shape: tuple[int, int], first: float = 0.5) -> Mask:
    """Which cells' centres lie inside of closed outlines (n, 2), by the even-odd rule, (rows, cols).

    The centre of cell (0, 0) is at x = y = `first`; all in cells.
    """
    x0, y0, x1, y1 = edges(lines).T
    # Rows whose centres an edge passes: it changes all cells to the right of where it does.
    low, high = np.ceil(np.minimum(y0, y1) - first), np.ceil(np.maximum(y0, y1) - first)
    count = np.maximum(high - low, 0.0).astype(np.int64)
    edge = np.repeat(np.arange(len(count)), count)
    row = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count) + low[edge].astype(np.int64)
    x = x0[edge] + (row + first - y0[edge]) * (x1 - x0)[edge] / (y1 - y0)[edge]
    col = np.clip(np.ceil(x - first), 0, shape[1]).astype(np.int64)
    within = (row >= 0) & (row < shape[0])
    changes = np.zeros((shape[0], shape[1] + 1), dtype=np.uint8)
    np.add.at(changes, (row[within], col[within]), 1)
    return np.asarray(np.cumsum(changes & 1, axis=1, dtype=np.uint8)[:, :-1] & 1, dtype=np.bool_)


def edges(lines: list[Array]) -> Array:
    """The edges (n, 4) x0, y0, x1, y1 of closed lines (k, 2)."""
    return np.vstack([np.zeros((0, 4)), *(np.hstack([line, np.roll(line, -1, axis=0)]) for line in lines)])


def _contours(padded: Mask) -> list[Array]:
    """Closed lines (n, 2) between marked cells and others, through the middles of the cells' sides; the first
    point is repeated. A level just below the middle joins cells that touch at a corner."""
    generator = contourpy.contour_generator(z=padded.astype(np.float64), name="serial")
    return [np.asarray(line) for line in generator.lines(0.5 - 1e-6)]


def _is_equal(found: Mask, wanted: Mask) -> bool:
    """Whether nearly all cells are what they should be, and the others have one that is beside them."""
    for value in (True, False):
        right, cells = found == value, wanted == value
        beside = scipy.ndimage.binary_dilation(right, EIGHT)
        if np.count_nonzero(right & cells) < LEAST_EQUAL * np.count_nonzero(cells) or (cells & ~beside).any():
            return False
    return True


def _touching(padded: Mask) -> Mask:
    """Where four cells meet of which two opposite ones are marked."""
    a, b, c, d = padded[:-1, :-1], padded[:-1, 1:], padded[1:, :-1], padded[1:, 1:]
    return np.asarray((a == d) & (b == c) & (a != b))


def _chain(line: Array, touching: Mask) -> tuple[Array, Mask]:
    """The corners of a closed contour and the middles of its sides, (n, 2), and which of them are fit to be
    corners of a straighter line: square corners and those middles, which lie between the ups and downs of a
    slope's steps."""
    before, after = line - np.roll(line, 1, axis=0), np.roll(line, -1, axis=0) - line
    line = line[before[:, 0] * after[:, 1] != before[:, 1] * after[:, 0]]
    line, square = _squared(line, touching)
    chain = np.stack([line, 0.5 * (line + np.roll(line, -1, axis=0))], axis=1).reshape(-1, 2)
    fit = np.stack([square, ~(square & np.roll(square, -1))], axis=1).ravel()
    first = int(np.argmax(fit)) if len(chain) > SMALLEST else 0
    return np.roll(chain, -first, axis=0), np.roll(fit, -first)


def _squared(line: Array, touching: Mask) -> tuple[Array, Mask]:
    """The line with square corners where a contour cuts them off between two sides of at least a cell, and
    which of its points those are."""
    edge = np.roll(line, -1, axis=0) - line
    length = np.abs(edge).max(axis=1)
    level, upright = (edge[:, 1] == 0.0) & (length >= 1.0), (edge[:, 0] == 0.0) & (length >= 1.0)
    # After a level side its end's height stays, after an upright one its x.
    from_level, from_upright = (
        np.roll(level, 1) & np.roll(upright, -1),
        np.roll(upright, 1) & np.roll(level, -1),
    )
    end = np.roll(line, -1, axis=0)
    corner = np.where(
        from_level[:, None], np.stack([end[:, 0], line[:, 1]], -1), np.stack([line[:, 0], end[:, 1]], -1)
    )
    cut = (from_level | from_upright) & (np.abs(edge) == 0.5).all(axis=1)
    cell = np.floor(corner).astype(np.int64)
    # Where two pockets touch, square corners would leave no wall between them.
    cut &= ~touching[cell[:, 1], cell[:, 0]]
    kept = ~np.roll(cut, 1)
    return np.where(cut[:, None], corner, line)[kept], cut[kept]


def _simplified(chain: Array, fit: Mask, tolerance: float) -> Array:
    """Some of the points of a closed chain (n, 2), all others within the tolerance of the lines between them:
    Douglas and Peucker (1973), split at the fit point nearest to the farthest."""
    n, fits = len(chain), np.flatnonzero(fit)
    if n <= SMALLEST:
        return chain[::2]
    closed = np.vstack([chain, chain[:1]])
    far = int(fits[np.argmax(np.hypot(*(chain[fits] - chain[0]).T))]) or n // 2
    kept = np.zeros(n + 1, dtype=np.bool_)
    kept[[0, far, n]] = True
    spans = [(0, far), (far, n)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        distance = _to_chord(closed[first + 1 : last], closed[first], closed[last])
        worst = first + 1 + int(np.argmax(distance))
        if distance[worst - first - 1] > tolerance:
            low, high = np.searchsorted(fits, [first + 1, last])
            near = fits[low:high]
            middle = int(near[np.argmin(np.abs(near - worst))]) if len(near) else worst
            kept[middle] = True
            spans += [(first, middle), (middle, last)]
    return chain[kept[:n]]


def _to_chord(points: Array, a: Array, b: Array) -> Array:
    """Distance of points (n, 2) to the stretch from a to b, (n,)."""
    along, offset = b - a, points - a
    share = np.clip(offset @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
    return np.hypot(*(offset - share[:, None] * along).T)
