"""Searches on the lattice of cells and headings (see turtlebag.planners.lattice), compiled.

Where the disc around the footprint fits, a cell is one state; elsewhere each of its headings is one.
"""

from __future__ import annotations

import heapq
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array
from turtlebag.planners.footprint import Field32, footprint_free
from turtlebag.planners.footprint_motions import Ground, drives, moves, turns
from turtlebag.planners.grid_distance import GridDistance

BLOCKED, WIDE = -1, -2
SLIP = 4.0
"""What it costs to leave or reach a pose with a slip of a cell to the side; only where no drive does."""
OCTILE = math.cos(math.pi / 8.0)
"""A straight way over eight neighbours' length is no less than this."""
NEAR = 2
"""How many cells and headings from start and goal the lattice is entered and left."""

Numbers = NDArray[np.int32]


class Floor(NamedTuple):
    """What the kernels search: the ground, and its states.

    `numbers` (rows, cols) are those of `number_cells`; `headings` (k, 2) are steps as columns and rows,
    `yaws` (k,) their directions. `stands` and `turns` hold, for each narrow cell and heading, whether the
    footprint stands free there, and turns on the spot to the next heading: 0 not looked at, 1 free, 2 not.
    """

    ground: Ground
    numbers: Numbers
    stands: NDArray[np.int8]
    turns: NDArray[np.int8]
    headings: NDArray[np.int64]
    yaws: Array
    backwards: float
    """What driving backwards costs a cell, beside a cell forwards."""
    turn: float
    """What turning by one heading costs."""


@njit(cache=True)
def number_cells(field: Field32, inner: float, outer: float) -> tuple[Numbers, int]:
    """Each cell: BLOCKED in any heading, WIDE enough for all, or its number among the narrow ones."""
    rows, cols = field.shape
    out = np.empty((rows, cols), dtype=np.int32)
    count = 0
    for r in range(rows):
        for c in range(cols):
            if field[r, c] > outer:
                out[r, c] = WIDE
            elif field[r, c] < inner:
                out[r, c] = BLOCKED
            else:
                out[r, c] = count
                count += 1
    return out, count


@njit(cache=True)
def ends(floor: Floor, pose: Array) -> tuple[NDArray[np.int64], Array]:
    """Lattice states (n, 3) as row, column, heading near a pose, straight to be reached, and the gaps.

    The gaps are in cells. A wide cell counts once, with heading 0.
    """
    res = floor.ground.res
    rows, cols = floor.numbers.shape
    n = len(floor.yaws)
    x, y, yaw = pose[0], pose[1], pose[2]
    row, col = math.floor(y / res), math.floor(x / res)
    out, gaps = np.empty(((2 * NEAR + 1) ** 2 * n, 3), dtype=np.int64), np.empty((2 * NEAR + 1) ** 2 * n)
    count = 0
    for r in range(max(row - NEAR, 0), min(row + NEAR + 1, rows)):
        for c in range(max(col - NEAR, 0), min(col + NEAR + 1, cols)):
            wide = floor.numbers[r, c] == WIDE
            if floor.numbers[r, c] == BLOCKED:
                continue
            cx, cy = (c + 0.5) * res, (r + 0.5) * res
            for k in range(1 if wide else n):
                there = yaw if wide else floor.yaws[k]
                away = abs((there - yaw + math.pi) % (2.0 * math.pi) - math.pi)
                if away > (NEAR + 0.5) * 2.0 * math.pi / n:
                    continue
                reached = reaches(floor.ground, pose, cx, cy, there)
                if reached or moves(floor.ground, (x, y, yaw), (cx, cy, there)):
                    out[count, 0], out[count, 1], out[count, 2] = r, c, k
                    gaps[count] = 1.5 * math.hypot(cx - x, cy - y) / res + (0.0 if reached else SLIP)
                    count += 1
    return out[:count].copy(), gaps[:count].copy()


@njit(cache=True)
def reaches(ground: Ground, pose: Array, x: float, y: float, yaw: float) -> bool:
    """Whether the robot turns, drives and turns from a pose (3,) to another."""
    a, b = pose[:2], np.array([x, y])
    if math.hypot(x - a[0], y - a[1]) < 1e-6:
        return turns(ground, a, pose[2], yaw)
    ahead = math.atan2(y - a[1], x - a[0])
    for way in (ahead, ahead + math.pi):
        if turns(ground, a, pose[2], way) and drives(ground, a, b, way) and turns(ground, b, way, yaw):
            return True
    return False


@njit(cache=True)
def next_states(
    floor: Floor, r: int, c: int, k: int, near: bool, out: NDArray[np.int64], costs: Array
) -> int:
    """Fill `out` (n, 3) with the states a step away, not yet checked, and `costs` (n,) with cells of way.

    A wide cell is left in every heading; with `near` only to its eight neighbours.
    """
    rows, cols = floor.numbers.shape
    n, count = len(floor.headings), 0
    wide = floor.numbers[r, c] == WIDE
    for h in range(n) if wide else range(k, k + 1):
        dc, dr = floor.headings[h, 0], floor.headings[h, 1]
        if near and max(abs(dc), abs(dr)) > 1:
            continue
        for way in (1, -1):
            r1, c1 = r + way * dr, c + way * dc
            if r1 < 0 or c1 < 0 or r1 >= rows or c1 >= cols or floor.numbers[r1, c1] == BLOCKED:
                continue
            # Between wide cells the opposite heading drives forwards.
            if way == 1 or not (wide and floor.numbers[r1, c1] == WIDE):
                out[count, 0], out[count, 1], out[count, 2] = r1, c1, h
                costs[count] = math.hypot(dc, dr) * (1.0 if way == 1 else floor.backwards)
                count += 1
    for turn in (1, -1):
        if not wide:
            out[count, 0], out[count, 1], out[count, 2] = r, c, (k + turn) % n
            costs[count] = floor.turn
            count += 1
    return count


@njit(cache=True)
def _free(floor: Floor, r: int, c: int, k: int, to: NDArray[np.int64]) -> bool:
    """Whether a step of `next_states` is free: the footprint stands there, and moves or turns on the way."""
    r1, c1, h = to[0], to[1], to[2]
    if not stands_free(floor, r1, c1, h, h):
        return False
    if r1 == r and c1 == c:
        n = len(floor.yaws)
        return stands_free(floor, r, c, k, h) if h == (k + 1) % n else stands_free(floor, r, c, h, k)
    if floor.numbers[r, c] == WIDE and floor.numbers[r1, c1] == WIDE and max(abs(r1 - r), abs(c1 - c)) <= 1:
        return True
    res, yaw = floor.ground.res, floor.yaws[h]
    there = ((c1 + 0.5) * res, (r1 + 0.5) * res, yaw)
    return moves(floor.ground, ((c + 0.5) * res, (r + 0.5) * res, yaw), there)


@njit(cache=True)
def stands_free(floor: Floor, r: int, c: int, k: int, to: int) -> bool:
    """Whether the footprint stands free on a cell, turning from heading k to the next one or keeping k."""
    number = floor.numbers[r, c]
    if number < 0:
        return bool(number == WIDE)
    memo = floor.stands if to == k else floor.turns
    at = number * len(floor.yaws) + k
    if memo[at] == 0:
        field, res, corners = floor.ground
        x, y, yaw = (c + 0.5) * res, (r + 0.5) * res, floor.yaws[k]
        if to == k:
            free = footprint_free(field, res, corners, x, y, yaw)
        else:
            free = moves(floor.ground, (x, y, yaw), (x, y, floor.yaws[to]))
        memo[at] = 1 if free else 2
    return bool(memo[at] == 1)


@njit(cache=True)
def flood(floor: Floor, starts: NDArray[np.int64], goals: NDArray[np.int64]) -> bool:
    """Whether the lattice joins any of some states (n, 3) with any of others (m, 3).

    Expands from both in turn: the smaller of two parts that are not joined says no.
    """
    n = len(floor.headings)
    reach = math.sqrt((floor.ground.corners**2).sum(axis=1).max())
    # The headings reached of each cell as bits, by either side.
    reached = np.zeros((2, *floor.numbers.shape), dtype=np.int64)
    stacks = [[(np.int64(0), np.int64(0), np.int64(0))] for _ in range(2)]
    out, costs = np.empty((2 * n + 2, 3), dtype=np.int64), np.empty(2 * n + 2)
    for side in range(2):
        stacks[side].clear()
        for r, c, k in starts if side == 0 else goals:
            reached[side, r, c] |= _bits(floor, r, c, k)
            stacks[side].append((r, c, k))
            if reached[0, r, c] & reached[1, r, c]:
                return True
    side = 1
    while True:
        side = 1 - side
        for _ in range(64):
            if len(stacks[side]) == 0:
                return False
            r, c, k = stacks[side].pop()
            # Amid wide cells the eight neighbours lead everywhere.
            amid = floor.numbers[r, c] == WIDE and floor.ground.field[r, c] > reach + 3.2 * floor.ground.res
            for to in out[: next_states(floor, r, c, k, amid, out, costs)]:
                bits = _bits(floor, to[0], to[1], to[2])
                if reached[side, to[0], to[1]] & bits == bits or not _free(floor, r, c, k, to):
                    continue
                reached[side, to[0], to[1]] |= bits
                if reached[0, to[0], to[1]] & reached[1, to[0], to[1]]:
                    return True
                stacks[side].append((to[0], to[1], to[2]))


@njit(cache=True)
def _bits(floor: Floor, r: int, c: int, k: int) -> np.int64:
    """The headings that a state stands for: all of them on a wide cell."""
    if floor.numbers[r, c] == WIDE:
        return (np.int64(1) << len(floor.headings)) - 1
    return np.int64(1) << k


@njit(cache=True)
def shortest(
    floor: Floor, starts: NDArray[np.int64], costs: Array, goals: NDArray[np.int64], rest: GridDistance
) -> NDArray[np.int64]:
    """States (n, 3) as column, row, heading (-1: any) of the cheapest way (A*, Hart 1968); empty: none.

    `rest` is the distance to the goal over eight neighbours, in cells.
    """
    n, states = len(floor.headings), floor.numbers.size + len(floor.stands)
    cost = np.full(states, np.inf, dtype=np.float32)
    before = np.full(states, -1, dtype=np.int64)
    is_goal = np.zeros(states, dtype=np.bool_)
    # Of the narrow states, in the order that `number_cells` counts in.
    cells = np.flatnonzero(floor.numbers >= 0)
    for state in goals:
        is_goal[_id(floor, state[0], state[1], state[2])] = True
    # A step may lead over a blocked cell, which `rest` does not: it knows nothing of what lies beyond.
    ahead = OCTILE * np.where(np.isfinite(rest), rest, 0.0)
    queue = [(0.0, 0.0, 0)]
    queue.clear()
    for i in range(len(starts)):
        r, c = starts[i, 0], starts[i, 1]
        at = _id(floor, r, c, starts[i, 2])
        if costs[i] < cost[at]:
            cost[at] = costs[i]
            heapq.heappush(queue, (float(costs[i] + ahead[r, c]), float(costs[i]), at))
    out, way = np.empty((2 * n + 2, 3), dtype=np.int64), np.empty(2 * n + 2)
    while len(queue) > 0:
        _, d, at = heapq.heappop(queue)
        if d > cost[at] + 1e-3:
            continue
        if is_goal[at]:
            return _trace(floor, at, before, cells)
        c, r, k = _state(floor, at, cells)
        count = next_states(floor, r, c, max(k, 0), False, out, way)
        for i in range(count):
            to = out[i]
            there = _id(floor, to[0], to[1], to[2])
            if d + way[i] >= cost[there] - 1e-4:
                continue
            if _free(floor, r, c, max(k, 0), to):
                cost[there], before[there] = d + way[i], at
                heapq.heappush(queue, (float(d + way[i] + ahead[to[0], to[1]]), d + way[i], there))
    return np.empty((0, 3), dtype=np.int64)


@njit(cache=True)
def _id(floor: Floor, r: int, c: int, k: int) -> int:
    """The number of a state: one for a wide cell, one for each heading on a narrow one."""
    rows, cols = floor.numbers.shape
    if floor.numbers[r, c] == WIDE:
        return r * cols + c
    return rows * cols + int(floor.numbers[r, c]) * len(floor.headings) + k


@njit(cache=True)
def _state(floor: Floor, at: int, cells: NDArray[np.int64]) -> tuple[int, int, int]:
    """Column, row, heading (-1: any) of a state by its number."""
    rows, cols = floor.numbers.shape
    n, narrow = len(floor.headings), at - rows * cols
    cell = at if narrow < 0 else cells[narrow // n]
    return cell % cols, cell // cols, -1 if narrow < 0 else narrow % n


@njit(cache=True)
def _trace(floor: Floor, at: int, before: NDArray[np.int64], cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """States (n, 3) as column, row, heading (-1: any) from the first one to this."""
    count, state = 0, at
    while state >= 0:
        count, state = count + 1, before[state]
    out = np.empty((count, 3), dtype=np.int64)
    while at >= 0:
        count -= 1
        out[count, 0], out[count, 1], out[count, 2] = _state(floor, at, cells)
        at = before[at]
    return out
