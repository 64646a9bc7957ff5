"""The lattice's searches beside Dijkstra over every state, spelled out."""

import heapq
import itertools
import math

import numpy as np
import pytest

from turtlebag.planners.costmap import clearance_field
from turtlebag.planners.footprint import footprint_free
from turtlebag.planners.footprint_motions import Ground, drives, moves, turns
from turtlebag.planners.grid_distance import grid_distance
from turtlebag.planners.lattice import BACKWARDS, TURN
from turtlebag.planners.lattice_search import (
    BLOCKED,
    SLIP,
    WIDE,
    Floor,
    ends,
    flood,
    next_states,
    number_cells,
    reaches,
    shortest,
    stands_free,
)

RES = 0.05
SHAPE = np.array([[-0.15, -0.06], [0.07, -0.06], [0.07, 0.06], [-0.15, 0.06]])
INNER, OUTER = 0.06, math.hypot(0.15, 0.06)
STEPS = [(a, b) for a, b in itertools.product(range(-2, 3), repeat=2) if math.gcd(a, b) == 1]
HEADINGS = np.array(sorted(STEPS, key=lambda v: math.atan2(v[1], v[0])))
YAWS = np.arctan2(HEADINGS[:, 1], HEADINGS[:, 0])
N = len(HEADINGS)
GAPS = {3: 1, 5: 2, 7: 1}
"""Seeds of rooms with a narrower gap [cells]: of two, only steps over blocked cells pass it; of one, none."""


class Room:
    """A field, its numbered cells, and fresh memories of what stands and turns."""

    def __init__(self, seed: int, share: float = 0.03, rows: int = 17, cols: int = 21, gap: int = 4):
        lethal = np.random.default_rng(seed).random((rows, cols)) < share
        if seed % 2:
            # a wall with a gap that only some headings pass
            lethal[:, cols // 2] = True
            lethal[5 : 5 + gap, cols // 2] = False
        self.field = clearance_field(lethal, RES)
        self.ground = Ground(self.field, RES, SHAPE)
        self.numbers, self.narrow = number_cells(self.field, INNER, OUTER)

    def args(self):
        size = self.narrow * N
        memory = np.zeros(size, dtype=np.int8), np.zeros(size, dtype=np.int8)
        return Floor(self.ground, self.numbers, *memory, HEADINGS, YAWS, BACKWARDS, TURN)

    def state(self, r, c, k):
        return (r, c, -1) if self.numbers[r, c] == WIDE else (r, c, k)

    def stands(self, r, c, h):
        if self.numbers[r, c] < 0:
            return bool(self.numbers[r, c] == WIDE)
        return footprint_free(self.field, RES, SHAPE, (c + 0.5) * RES, (r + 0.5) * RES, YAWS[h])

    def onwards(self, state):
        """States that a state leads to, each with what the step costs."""
        r, c, k = state
        x, y = (c + 0.5) * RES, (r + 0.5) * RES
        for h in range(N) if k < 0 else (k,):
            dc, dr = HEADINGS[h].tolist()
            for way, factor in ((1, 1.0), (-1, BACKWARDS)):
                r1, c1 = r + way * dr, c + way * dc
                if not (0 <= r1 < self.numbers.shape[0] and 0 <= c1 < self.numbers.shape[1]):
                    continue
                if self.numbers[r1, c1] == BLOCKED or not self.stands(r1, c1, h):
                    continue
                both_wide = self.numbers[r, c] == WIDE == self.numbers[r1, c1] and max(abs(dr), abs(dc)) == 1
                there = (c1 + 0.5) * RES, (r1 + 0.5) * RES, YAWS[h]
                if both_wide or moves(self.ground, (x, y, YAWS[h]), there):
                    yield self.state(r1, c1, h), factor * math.hypot(dr, dc)
        for turn in (1, -1) if k >= 0 else ():
            h = (k + turn) % N
            if self.stands(r, c, h) and moves(self.ground, (x, y, YAWS[k]), (x, y, YAWS[h])):
                yield (r, c, h), TURN

    def costs(self, starts):
        """Dijkstra: the least cost of every state that some of the starts, by their costs, lead to."""
        best = {}
        queue = [(cost, state) for state, cost in starts.items()]
        heapq.heapify(queue)
        while queue:
            cost, state = heapq.heappop(queue)
            if state in best:
                continue
            best[state] = cost
            for there, step in self.onwards(state):
                if there not in best:
                    heapq.heappush(queue, (cost + step, there))
        return best


def standing(floor, rng, columns):
    while True:
        r, c, k = int(rng.integers(2, 15)), int(rng.integers(*columns)), int(rng.integers(N))
        if floor.numbers[r, c] != BLOCKED and floor.stands(r, c, k):
            return r, c, 0 if floor.numbers[r, c] == WIDE else k


def test_cells_are_blocked_wide_or_numbered_row_by_row():
    field = np.array([[0.1, 0.3, 0.5], [0.2, 0.9, 0.05], [0.4, 0.3, 0.2]], dtype=np.float32)
    numbers, count = number_cells(field, float(field[1, 0]), float(field[2, 0]))
    assert numbers.tolist() == [[BLOCKED, 0, WIDE], [1, WIDE, BLOCKED], [2, 3, 4]]
    assert count == 5


@pytest.mark.parametrize("near", [False, True])
def test_a_step_leads_to_a_cell_that_is_not_blocked_or_turns_on_a_narrow_one(near):
    room, k = Room(1), 3
    floor, numbers = room.args(), room.numbers
    out, costs = np.empty((2 * N + 2, 3), dtype=np.int64), np.empty(2 * N + 2)
    for (r, c), number in np.ndenumerate(numbers):
        if number == BLOCKED:
            continue
        expected = [] if number == WIDE else [((r, c, (k + turn) % N), TURN) for turn in (1, -1)]
        for h, way in itertools.product(range(N) if number == WIDE else (k,), (1, -1)):
            dc, dr = HEADINGS[h].tolist()
            r1, c1 = r + way * dr, c + way * dc
            inside = 0 <= r1 < numbers.shape[0] and 0 <= c1 < numbers.shape[1]
            if not inside or numbers[r1, c1] == BLOCKED or (near and max(abs(dc), abs(dr)) > 1):
                continue
            if way == 1 or not number == WIDE == numbers[r1, c1]:
                expected.append(((r1, c1, h), math.hypot(dc, dr) * (1.0 if way == 1 else BACKWARDS)))
        n = next_states(floor, r, c, k, near, out, costs)
        found = zip(map(tuple, out[:n].tolist()), costs[:n].tolist(), strict=True)
        assert sorted(found) == sorted(expected)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_states_are_joined_when_dijkstra_gets_from_one_to_the_other(seed):
    gap = GAPS.get(seed, 4)
    floor, rng = Room(seed, gap=gap), np.random.default_rng(seed)
    starts = [standing(floor, rng, (2, 7))]
    reached = floor.costs({floor.state(*state): 0.0 for state in starts})
    told = []
    for columns in ((2, 6), (6, 12), (13, 19), (13, 19), (13, 19)):
        goal = standing(floor, rng, columns)
        joined = flood(floor.args(), np.array(starts), np.array([goal]))
        assert joined == (floor.state(*goal) in reached)
        assert flood(floor.args(), np.array([goal]), np.array(starts)) == joined
        told.append(joined)
    assert gap > 1 or told[2:] == [False] * 3
    both = [standing(floor, rng, (13, 19)), starts[0]]
    assert flood(floor.args(), np.array(starts), np.array(both))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_the_way_through_the_lattice_is_the_cheapest(seed):
    gap = GAPS.get(seed, 4)
    floor, rng = Room(seed, gap=gap), np.random.default_rng(seed + 100)
    starts = list({floor.state(*s): s for s in (standing(floor, rng, (2, 7)) for _ in range(3))}.values())
    costs = rng.uniform(0.0, 4.0, len(starts))
    reached = floor.costs({floor.state(*s): cost for s, cost in zip(starts, costs, strict=True)})
    found = 0
    for _ in range(4):
        goal = standing(floor, rng, (10, 19))
        rest = grid_distance(floor.numbers != BLOCKED, goal[0], goal[1], np.inf)
        way = shortest(floor.args(), np.array(starts), costs, np.array([goal]), rest)
        if floor.state(*goal) not in reached:
            assert len(way) == 0
            continue
        found += 1
        states = [(r, c, k) for c, r, k in way.tolist()]
        assert states[-1] == floor.state(*goal)
        first = [s for s in range(len(starts)) if floor.state(*starts[s]) == states[0]]
        total = min(costs[s] for s in first)
        for state, there in itertools.pairwise(states):
            total += min(step for onward, step in floor.onwards(state) if onward == there)
        assert total == pytest.approx(reached[floor.state(*goal)], abs=0.01)
    assert (found == 0) == (gap == 1)


def test_of_several_goals_the_nearest_is_taken_and_a_start_that_is_a_goal_is_there_at_once():
    floor = Room(0, share=0.0)
    start, near, far = (8, 6, 0), (8, 9, 0), (8, 15, 0)
    assert all(floor.numbers[s[:2]] == WIDE for s in (start, near, far))
    rest = np.minimum(*(grid_distance(floor.numbers != BLOCKED, *s[:2], np.inf) for s in (near, far)))
    way = shortest(floor.args(), np.array([start]), np.zeros(1), np.array([far, near]), rest)
    assert way.tolist() == [[c, 8, -1] for c in (6, 7, 8, 9)]
    at_once = shortest(
        floor.args(), np.array([start]), np.zeros(1), np.array([far, start]), np.zeros_like(rest)
    )
    assert at_once.tolist() == [[6, 8, -1]]
    # cheaper to begin at the one that costs less
    two = np.array([[8, 12, 0], [8, 8, 0]])
    way = shortest(floor.args(), two, np.array([5.0, 0.5]), np.array([near]), rest)
    assert way[:, 0].tolist() == [8, 9]


@pytest.mark.parametrize("seed", range(6))
def test_the_states_near_a_pose_are_those_straight_to_be_reached(seed):
    floor, rng = Room(seed, share=0.05), np.random.default_rng(seed)
    cells = np.argwhere(floor.numbers != BLOCKED)
    counted = 0
    for _ in range(12):
        row, col = cells[rng.integers(len(cells))]
        (x, y), yaw = (np.array([col, row]) + rng.random(2)) * RES, rng.uniform(-7.0, 7.0)
        pose = np.array([x, y, yaw])
        states, gaps = ends(floor.args(), pose)
        expected = {}
        for r, c, k in itertools.product(range(row - 2, row + 3), range(col - 2, col + 3), range(N)):
            if not (0 <= r < 17 and 0 <= c < 21) or floor.numbers[r, c] == BLOCKED:
                continue
            wide = floor.numbers[r, c] == WIDE
            yaw = pose[2] if wide else YAWS[k]
            if (wide and k > 0) or abs(math.remainder(yaw - pose[2], 2 * math.pi)) > 2.5 * 2 * math.pi / N:
                continue
            x, y = (c + 0.5) * RES, (r + 0.5) * RES
            driven = reaches(floor.ground, pose, x, y, yaw)
            if driven or moves(floor.ground, tuple(pose), (x, y, yaw)):
                gap = 1.5 * math.hypot(x - pose[0], y - pose[1]) / RES
                expected[r, c, k] = gap + (0.0 if driven else SLIP)
        assert [tuple(s) for s in states.tolist()] == list(expected)
        np.testing.assert_allclose(gaps, list(expected.values()))
        counted += len(expected)
    assert counted > 20


@pytest.mark.parametrize("seed", range(4))
def test_a_pose_is_reached_by_a_turn_a_drive_and_a_turn_either_way_round(seed):
    floor, rng = Room(seed, share=0.05), np.random.default_rng(seed)
    told = {True: 0, False: 0}
    for _ in range(150):
        pose = np.array([*rng.uniform(0.15, [0.9, 0.7]), rng.uniform(-3.0, 3.0)])
        x, y, yaw = *(pose[:2] + rng.normal(0.0, 0.08, 2)), rng.uniform(-3.0, 3.0)
        there, ahead = np.array([x, y]), math.atan2(y - pose[1], x - pose[0])
        ground = floor.ground
        expected = any(
            turns(ground, pose[:2], pose[2], way)
            and drives(ground, pose[:2], there, way)
            and turns(ground, there, way, yaw)
            for way in (ahead, ahead + math.pi)
        )
        assert reaches(ground, pose, x, y, yaw) == expected
        assert reaches(ground, pose, pose[0], pose[1], yaw) == turns(ground, pose[:2], pose[2], yaw)
        told[expected] += 1
    assert min(told.values()) > 15


@pytest.mark.parametrize("seed", range(3))
def test_what_stands_or_turns_is_looked_up_once_and_remembered(seed):
    floor = Room(seed, share=0.05)
    known = floor.args()
    ground = floor.ground
    for r, c, k in itertools.product(range(17), range(21), range(N)):
        h = (k + 1) % N
        x, y = (c + 0.5) * RES, (r + 0.5) * RES
        here, number = floor.numbers[r, c] != BLOCKED and floor.stands(r, c, k), floor.numbers[r, c]
        turned = here if number < 0 else moves(ground, (x, y, YAWS[k]), (x, y, YAWS[h]))
        for _ in range(2):
            assert stands_free(known, r, c, k, k) == here
            assert stands_free(known, r, c, k, h) == turned
        if number >= 0:
            assert known.stands[number * N + k] == (1 if here else 2)
            assert known.turns[number * N + k] == (1 if turned else 2)
