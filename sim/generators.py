"""World generators: mazes, offices and forests by seed, so that nothing is tuned to three maps."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.number_text import decimal
from turtlebag.datasets.seeds import stream
from turtlebag.sim.shapes import Solid, box, cylinder

HEIGHT = (0.0, 1.0)
WALL_M = 0.1

Pose = tuple[float, float, float]
Generated = tuple[list[Solid], Pose]


def maze(seed: int, *, cells: int = 8, cell: float = 1.0, openings: float = 0.1) -> Generated:
    """A maze of cells x cells with corridors of `cell` less the wall [m]: every cell can be reached.

    Grown by a random depth-first walk; a share of `openings` of the walls left is then taken out, so
    that there are loops to close. The spawn is the middle of the lower left cell.
    """
    rng = stream(seed, "maze")
    # right[r, c]: a wall between (r, c) and (r, c + 1); above[r, c]: between (r, c) and (r + 1, c).
    right, above = np.ones((cells, cells - 1), dtype=bool), np.ones((cells - 1, cells), dtype=bool)
    seen = np.zeros((cells, cells), dtype=bool)
    seen[0, 0] = True
    trail = [(0, 0)]
    while trail:
        r, c = trail[-1]
        near = [(r + dr, c + dc) for dr, dc in ((0, 1), (1, 0), (0, -1), (-1, 0))]
        ways = [(i, j) for i, j in near if 0 <= i < cells and 0 <= j < cells and not seen[i, j]]
        if not ways:
            trail.pop()
            continue
        i, j = ways[int(rng.integers(len(ways)))]
        if i == r:
            right[r, min(c, j)] = False
        else:
            above[min(r, i), c] = False
        seen[i, j] = True
        trail.append((i, j))
    right &= rng.random(right.shape) >= openings
    above &= rng.random(above.shape) >= openings
    return _maze_walls(right, above, cells, cell), (cell / 2.0, cell / 2.0, 0.0)


def _maze_walls(right: np.ndarray, above: np.ndarray, cells: int, cell: float) -> list[Solid]:
    size = cells * cell
    walls = _frame(size, size)
    for c in range(cells - 1):
        for first, last in _runs(right[:, c]):
            walls.append(_wall((c + 1) * cell, first * cell, (c + 1) * cell, last * cell))
    for r in range(cells - 1):
        for first, last in _runs(above[r]):
            walls.append(_wall(first * cell, (r + 1) * cell, last * cell, (r + 1) * cell))
    return [_named(wall, k) for k, wall in enumerate(walls)]


def office(seed: int, *, width: float = 16.0, door: float = 0.95) -> Generated:
    """An office floor: a ring corridor around a core, rooms with doors on all sides, desks and shelves.

    The spawn is in the lower corridor.
    """
    rng = stream(seed, "office")
    depth, corridor = 3.2, 1.7
    rows = np.cumsum([0.0, depth, corridor, depth, corridor, depth])
    inner = (corridor, width - corridor)
    walls = _frame(width, float(rows[-1]))
    furniture: list[Solid] = []
    for low, high, x_min, x_max, doors in (
        (rows[0], rows[1], 0.0, width, (rows[1],)),
        (rows[2], rows[3], *inner, (rows[2], rows[3])),
        (rows[4], rows[5], 0.0, width, (rows[4],)),
    ):
        cuts = _cuts(rng, x_min, x_max)
        walls += [_wall(x, low, x, high) for x in (cuts[1:-1] if x_max == width else cuts)]
        for left, right in itertools.pairwise(cuts):
            with_door = doors[int(rng.integers(len(doors)))]
            spare = right - left - door
            side = min(0.7, 0.4 * spare)
            at = left + side + (spare - 2.0 * side) * float(rng.random())
            for y in {low, high} - {0.0, rows[-1]}:
                if y == with_door:
                    walls += [_wall(left, y, at, y), _wall(at + door, y, right, y)]
                else:
                    walls.append(_wall(left, y, right, y))
            furniture += _furniture(rng, left, right, low, high, (at + door / 2.0, with_door))
    solids = [_named(wall, k) for k, wall in enumerate(walls)]
    return solids + furniture, (width / 2.0, float(rows[1] + corridor / 2.0), 0.0)


def _furniture(
    rng: np.random.Generator, left: float, right: float, low: float, high: float, door: tuple[float, float]
) -> list[Solid]:
    """A desk or shelf along each of some walls of a room, away from its door."""
    out: list[Solid] = []
    inset = 0.05 + WALL_M / 2.0
    for side in ("left", "right", "far"):
        if rng.random() > 0.6:
            continue
        long, deep = float(rng.uniform(0.8, 1.4)), float(rng.uniform(0.35, 0.65))
        if side == "far":
            x = float(rng.uniform(left + 0.8, right - 0.8))
            y = high - inset - deep / 2.0 if door[1] == low else low + inset + deep / 2.0
            size = (min(long, right - left - 1.6), deep)
        else:
            x = left + inset + deep / 2.0 if side == "left" else right - inset - deep / 2.0
            y = float(rng.uniform(low + 1.1, high - 1.1))
            size = (deep, min(long, 1.0))
        if np.hypot(x - door[0], y - door[1]) > 1.4 and size[0] > 0.2:
            out.append(box(f"furniture_{left:.1f}_{low:.1f}_{side}", (x, y), size, 0.0, HEIGHT))
    return out


def forest(seed: int, *, density: float = 0.35, size: float = 12.0) -> Generated:
    """Random cylinders, `density` a square metre, in a walled square; between any two at least 0.7 m.

    The spawn is the middle, with a metre of room. So dense that no more fit, fewer are set.
    """
    rng = stream(seed, "forest")
    solids = [_named(wall, k) for k, wall in enumerate(_frame(size, size))]
    trunks: list[tuple[float, float, float]] = []
    wanted = round(density * size * size)
    for _ in range(60 * wanted):
        if len(trunks) == wanted:
            break
        radius = float(rng.uniform(0.05, 0.25))
        x, y = (float(value) for value in rng.uniform(radius + 0.75, size - radius - 0.75, 2))
        far = all(np.hypot(x - tx, y - ty) > radius + tr + 0.7 for tx, ty, tr in trunks)
        if far and np.hypot(x - size / 2.0, y - size / 2.0) > radius + 1.0:
            trunks.append((x, y, radius))
    solids += [cylinder(f"tree_{k}", (x, y), radius, HEIGHT) for k, (x, y, radius) in enumerate(trunks)]
    return solids, (size / 2.0, size / 2.0, 0.0)


LIMITS = {
    "cells": (2, 60),
    "cell": (0.6, 5.0),
    "openings": (0.0, 1.0),
    "width": (12.0, 60.0),
    "door": (0.6, 1.1),
    "density": (0.0, 5.0),
    "size": (4.0, 60.0),
}
"""Least and greatest value of each generator's parameters; those of whole numbers are whole."""
LONGEST_SEED = 100


def seeded(
    where: str, settings: str, limits: Mapping[str, tuple[float, float]]
) -> tuple[int, dict[str, Any]]:
    """The seed and the numbers of `SEED,key=number,...`, each within its limits; InputError for any other."""
    seed, *pairs = settings.split(",")
    if not seed.isdecimal() or len(seed) > LONGEST_SEED:
        raise InputError(f"{where}: needs a seed, as in {where.removesuffix(settings).rstrip(':')}:7")
    options: dict[str, Any] = {}
    for pair in pairs:
        key, _, text = pair.partition("=")
        if key not in limits:
            raise InputError(f"{where}: has no option '{key}' (it has: {', '.join(limits)})")
        (low, high), whole = limits[key], isinstance(limits[key][0], int)
        try:
            value = decimal(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high or (whole and value % 1.0):
            kind = "a whole number from" if whole else "a number from"
            raise InputError(f"{where}: {key}={text}: must be {kind} {low:g} to {high:g}")
        options[key] = int(value) if whole else value
    return int(seed), options


GENERATORS: dict[str, Callable[..., Generated]] = {"maze": maze, "office": office, "forest": forest}


def _wall(x0: float, y0: float, x1: float, y1: float) -> Solid:
    """An upright or level wall between two points, its ends rounded off by half its thickness."""
    size = (abs(x1 - x0) + WALL_M, abs(y1 - y0) + WALL_M)
    return box("", ((x0 + x1) / 2.0, (y0 + y1) / 2.0), size, 0.0, HEIGHT)


def _frame(x: float, y: float) -> list[Solid]:
    return [_wall(0.0, 0.0, x, 0.0), _wall(0.0, y, x, y), _wall(0.0, 0.0, 0.0, y), _wall(x, 0.0, x, y)]


def _named(wall: Solid, number: int) -> Solid:
    return Solid(f"wall_{number}", wall.z_min, wall.z_max, wall.center, wall.polygon)


def _runs(flags: np.ndarray) -> list[tuple[int, int]]:
    """(first, past the last) index of every run of True."""
    padded = np.concatenate([[False], flags, [False]])
    changes = np.nonzero(padded[1:] != padded[:-1])[0]
    return [(int(a), int(b)) for a, b in zip(changes[::2], changes[1::2], strict=True)]


def _cuts(rng: np.random.Generator, low: float, high: float) -> list[float]:
    """Borders of rooms about 2.1 to 5 m wide between two walls."""
    n = int(rng.integers(int(np.ceil((high - low) / 4.2)), int((high - low) / 2.6) + 1))
    widths = rng.uniform(0.8, 1.2, n)
    return (low + np.concatenate([[0.0], np.cumsum(widths)]) * ((high - low) / widths.sum())).tolist()
