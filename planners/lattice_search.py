"""Searches on the lattice of cells and headings (see turtlebag.planners.lattice), compiled.

Where the disc round the footprint has room a cell is one state, elsewhere each of its headings is one.
"""

from __future__ import annotations

import heapq
import math

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array
from turtlebag.planners.footprint import Field32, footprint_free
from turtlebag.planners.oriented import drives, moves, turns
from turtlebag.planners.wavefront import Wave

BLOCKED, WIDE = -1, -2
BACKWARDS, TURN = 2.0, 0.2
"""What driving backwards costs a cell, and turning by one heading, beside a cell forwards."""
SLIP = 4.0
"""What it costs to leave or reach a pose with a slip of a cell to the side; only where no drive does."""
OCTILE = 0.92
"""A straight way over eight neighbours' length is no less than this."""
NEAR_CELLS, NEAR_HEADINGS = 2, 2
"""How far from start and goal the lattice is entered and left."""

Numbers = NDArray[np.int32]


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
def ends(
    field: Field32, res: float, corners: Array, numbers: Numbers, yaws: Array, pose: Array
) -> tuple[NDArray[np.int64], Array]:
    """Lattice states (n, 3) as row, column, heading near a pose, straight to be reached, and the gaps.

    The gaps are in cells. A wide cell counts once, with heading 0.
    """
    rows, cols = numbers.shape
    n = len(yaws)
    x, y, yaw = pose[0], pose[1], pose[2]
    row, col = math.floor(y / res), math.floor(x / res)
    out, gaps = np.empty((25 * n, 3), dtype=np.int64), np.empty(25 * n)
    count = 0
    for r in range(max(row - NEAR_CELLS, 0), min(row + NEAR_CELLS + 1, rows)):
        for c in range(max(col - NEAR_CELLS, 0), min(col + NEAR_CELLS + 1, cols)):
            if numbers[r, c] == BLOCKED:
                continue
            cx, cy = (c + 0.5) * res, (r + 0.5) * res
            for k in range(n):
                there = yaws[k]
                if numbers[r, c] == WIDE:
                    if k > 0:
                        break
                    there = yaw
                away = abs((there - yaw + math.pi) % (2.0 * math.pi) - math.pi)
                if away > (NEAR_HEADINGS + 0.5) * 2.0 * math.pi / n:
                    continue
                slips = moves(field, res, corners, x, y, yaw, cx, cy, there)
                if slips or _reaches(field, res, corners, pose, cx, cy, there):
                    out[count, 0], out[count, 1], out[count, 2] = r, c, k
                    gaps[count] = 1.5 * math.hypot(cx - x, cy - y) / res
                    if not _reaches(field, res, corners, pose, cx, cy, there):
                        gaps[count] += SLIP
                    count += 1
    return out[:count].copy(), gaps[:count].copy()


@njit(cache=True)
def _reaches(field: Field32, res: float, corners: Array, pose: Array, x: float, y: float, yaw: float) -> bool:
    """Whether the robot turns, drives and turns from a pose (3,) to another."""
    a, b = pose[:2], np.array([x, y])
    if math.hypot(x - a[0], y - a[1]) < 1e-6:
        return turns(field, res, corners, a, pose[2], yaw)
    ahead = math.atan2(y - a[1], x - a[0])
    for way in (ahead, ahead + math.pi):
        if (
            turns(field, res, corners, a, pose[2], way)
            and drives(field, res, corners, a, b, way)
            and turns(field, res, corners, b, way, yaw)
        ):
            return True
    return False


@njit(cache=True)
def _step_free(
    field: Field32,
    res: float,
    corners: Array,
    numbers: Numbers,
    r0: int,
    c0: int,
    r1: int,
    c1: int,
    yaw: float,
) -> bool:
    """Whether a step between two cells in one heading is free."""
    if numbers[r0, c0] == WIDE and numbers[r1, c1] == WIDE and abs(r1 - r0) <= 1 and abs(c1 - c0) <= 1:
        return True
    return moves(
        field,
        res,
        corners,
        (c0 + 0.5) * res,
        (r0 + 0.5) * res,
        yaw,
        (c1 + 0.5) * res,
        (r1 + 0.5) * res,
        yaw,
    )


@njit(cache=True)
def _stands(
    field: Field32,
    res: float,
    corners: Array,
    numbers: Numbers,
    known: NDArray[np.int8],
    yaws: Array,
    r: int,
    c: int,
    k: int,
    to: int,
) -> bool:
    """Whether the footprint stands free on a cell, turning from heading k `to` another or keeping k.

    Looked up once for each narrow cell and heading k: `known` is for turns to the next one, or for none.
    """
    number = numbers[r, c]
    if number < 0:
        return bool(number == WIDE)
    at = number * len(yaws) + k
    if known[at] == 0:
        x, y = (c + 0.5) * res, (r + 0.5) * res
        if to == k:
            free = footprint_free(field, res, corners, x, y, yaws[k])
        else:
            free = moves(field, res, corners, x, y, yaws[k], x, y, yaws[to])
        known[at] = 1 if free else 2
    return bool(known[at] == 1)


@njit(cache=True)
def flood(
    field: Field32,
    res: float,
    corners: Array,
    numbers: Numbers,
    stands: NDArray[np.int8],
    turning: NDArray[np.int8],
    headings: NDArray[np.int64],
    yaws: Array,
    starts: NDArray[np.int64],
    goals: NDArray[np.int64],
) -> bool:
    """Whether the lattice joins any of some states (n, 3) with any of others (m, 3).

    Spreads from both in turn: the smaller of two parts that are not joined says no.
    """
    rows, cols = numbers.shape
    n = len(headings)
    reach = 0.0
    for k in range(len(corners)):
        reach = max(reach, math.hypot(corners[k, 0], corners[k, 1]))
    everything = (np.int64(1) << n) - 1
    reached = np.zeros((2, rows, cols), dtype=np.int64)
    stacks = [[(0, 0, 0)], [(0, 0, 0)]]
    for side in range(2):
        stacks[side].clear()
        for state in starts if side == 0 else goals:
            r, c, k = int(state[0]), int(state[1]), int(state[2])
            bits = everything if numbers[r, c] == WIDE else np.int64(1) << k
            reached[side, r, c] |= bits
            stacks[side].append((r, c, k))
            if reached[0, r, c] & reached[1, r, c]:
                return True
    while True:
        for side in range(2):
            for _ in range(64):
                if len(stacks[side]) == 0:
                    return False
                r, c, k = stacks[side].pop()
                wide = numbers[r, c] == WIDE
                # Amid wide cells the eight neighbours lead everywhere.
                amid = wide and field[r, c] > reach + 3.2 * res
                for h in range(n) if wide else range(k, k + 1):
                    if amid and max(abs(headings[h, 0]), abs(headings[h, 1])) > 1:
                        continue
                    for way in (1, -1):
                        r1, c1 = r + way * int(headings[h, 1]), c + way * int(headings[h, 0])
                        if r1 < 0 or c1 < 0 or r1 >= rows or c1 >= cols or numbers[r1, c1] == BLOCKED:
                            continue
                        bits = everything if numbers[r1, c1] == WIDE else np.int64(1) << h
                        if reached[side, r1, c1] & bits == bits:
                            continue
                        if not _stands(field, res, corners, numbers, stands, yaws, r1, c1, h, h):
                            continue
                        if not _step_free(field, res, corners, numbers, r, c, r1, c1, yaws[h]):
                            continue
                        reached[side, r1, c1] |= bits
                        if reached[0, r1, c1] & reached[1, r1, c1]:
                            return True
                        stacks[side].append((r1, c1, h))
                if wide:
                    continue
                for turn in (1, -1):
                    h = (k + turn) % n
                    if reached[side, r, c] >> h & 1:
                        continue
                    if not _stands(field, res, corners, numbers, stands, yaws, r, c, h, h):
                        continue
                    low, high = (k, h) if turn == 1 else (h, k)
                    if not _stands(field, res, corners, numbers, turning, yaws, r, c, low, high):
                        continue
                    reached[side, r, c] |= np.int64(1) << h
                    if reached[0, r, c] & reached[1, r, c]:
                        return True
                    stacks[side].append((r, c, h))


@njit(cache=True)
def shortest(
    field: Field32,
    res: float,
    corners: Array,
    numbers: Numbers,
    stands: NDArray[np.int8],
    turning: NDArray[np.int8],
    headings: NDArray[np.int64],
    yaws: Array,
    starts: NDArray[np.int64],
    costs: Array,
    goals: NDArray[np.int64],
    rest: Wave,
) -> NDArray[np.int64]:
    """States (n, 3) as column, row, heading (-1: any) of the cheapest way (A*, Hart 1968); empty: none.

    `rest` is the distance to the goal over eight neighbours, in cells.
    """
    rows, cols = numbers.shape
    n, size = len(headings), rows * cols
    narrow = len(stands) // n
    cost = np.full(size + narrow * n, np.inf, dtype=np.float32)
    before = np.full(size + narrow * n, -1, dtype=np.int64)
    is_goal = np.zeros(size + narrow * n, dtype=np.bool_)
    # Cells of the narrow states, to find the way back.
    cell_of = np.empty(narrow, dtype=np.int64)
    for r in range(rows):
        for c in range(cols):
            if numbers[r, c] >= 0:
                cell_of[numbers[r, c]] = r * cols + c
    for state in goals:
        is_goal[_id(numbers, size, cols, n, state[0], state[1], state[2])] = True
    queue = [(0.0, 0.0, 0)]
    queue.clear()
    for i in range(len(starts)):
        r, c = int(starts[i, 0]), int(starts[i, 1])
        at = _id(numbers, size, cols, n, r, c, starts[i, 2])
        if costs[i] < cost[at]:
            cost[at] = costs[i]
            heapq.heappush(queue, (float(costs[i] + OCTILE * rest[r, c]), float(costs[i]), at))
    while len(queue) > 0:
        _, d, at = heapq.heappop(queue)
        if d > cost[at] + 1e-3:
            continue
        if is_goal[at]:
            return _trace(at, before, cell_of, size, cols, n)
        wide = at < size
        cell = at if wide else int(cell_of[(at - size) // n])
        k = 0 if wide else (at - size) % n
        r, c = cell // cols, cell % cols
        for h in range(n) if wide else range(k, k + 1):
            length = math.hypot(headings[h, 0], headings[h, 1])
            for way in (1, -1):
                r1, c1 = r + way * int(headings[h, 1]), c + way * int(headings[h, 0])
                if r1 < 0 or c1 < 0 or r1 >= rows or c1 >= cols or not math.isfinite(rest[r1, c1]):
                    continue
                if way == -1 and wide and numbers[r1, c1] == WIDE:
                    continue
                there = _id(numbers, size, cols, n, r1, c1, h)
                nd = d + length * (1.0 if way == 1 else BACKWARDS)
                if nd >= cost[there] - 1e-4:
                    continue
                if not _stands(field, res, corners, numbers, stands, yaws, r1, c1, h, h):
                    continue
                if not _step_free(field, res, corners, numbers, r, c, r1, c1, yaws[h]):
                    continue
                cost[there] = nd
                before[there] = at
                heapq.heappush(queue, (float(nd + OCTILE * rest[r1, c1]), nd, there))
        if wide:
            continue
        for turn in (1, -1):
            h = (k + turn) % n
            there = at - k + h
            if d + TURN >= cost[there] - 1e-4:
                continue
            if not _stands(field, res, corners, numbers, stands, yaws, r, c, h, h):
                continue
            low, high = (k, h) if turn == 1 else (h, k)
            if not _stands(field, res, corners, numbers, turning, yaws, r, c, low, high):
                continue
            cost[there] = d + TURN
            before[there] = at
            heapq.heappush(queue, (float(d + TURN + OCTILE * rest[r, c]), d + TURN, there))
    return np.empty((0, 3), dtype=np.int64)


@njit(cache=True)
def _id(numbers: Numbers, size: int, cols: int, n: int, r: int, c: int, k: int) -> int:
    """The number of a state: one for a wide cell, one for each heading on a narrow one."""
    if numbers[r, c] == WIDE:
        return r * cols + c
    return size + int(numbers[r, c]) * n + k


@njit(cache=True)
def _trace(
    at: int, before: NDArray[np.int64], cell_of: NDArray[np.int64], size: int, cols: int, n: int
) -> NDArray[np.int64]:
    """States (n, 3) as column, row, heading (-1: any) from the first one to this."""
    count, state = 0, at
    while state >= 0:
        count, state = count + 1, int(before[state])
    out = np.empty((count, 3), dtype=np.int64)
    while at >= 0:
        count -= 1
        cell = at if at < size else int(cell_of[(at - size) // n])
        out[count, 0], out[count, 1] = cell % cols, cell // cols
        out[count, 2] = -1 if at < size else (at - size) % n
        at = int(before[at])
    return out
