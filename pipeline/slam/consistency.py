"""Which recognised places can be true together: pairwise consistency and its largest agreeing sets.

Pairwise consistent measurements (PCM), Mangelson et al. (2018): two places recognised by two submaps are
consistent when the cycle through both closes as well as the drift between them allows. What is true is
consistent with all else that is true; what a repeating building fakes agrees with less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from datasets.se2 import Array, between, compose
from pipeline.slam.chain import Chain

# How well a cycle must close: floors, and what a metre of drift adds.
CLOSE_M, CLOSE_RAD = 0.4, 0.1
DRIFT_SHARE, TURN_PER_DRIFT = 0.5, 0.04
# Beyond this drift two places say nothing about each other [m].
COMPARABLE_M = 8.0


@dataclass(frozen=True, eq=False)
class Recognised:
    """Key i recognised at key j's place: `T_j_i` (3,), how well the scans fit there, and what became of it.

    `score` is of the coarse correlation, `overlap` the share of points that fit, `denied` the share of
    points that one saw through and the other as a wall.
    """

    i: int
    j: int
    T_j_i: Array
    score: float
    overlap: float
    denied: float
    rmse: float
    information: Array
    verdict: str = "candidate"

    def judged(self, verdict: str) -> Recognised:
        """The same with a verdict."""
        return replace(self, verdict=verdict)


def consistency(found: Sequence[Recognised], T_map_keys: Array, chain: Chain) -> tuple[NDArray, NDArray]:
    """Matrices (n, n) over pairs: whether they can be compared at all, and whether they agree."""
    n = len(found)
    comparable, agree = np.zeros((n, n), dtype=bool), np.eye(n, dtype=bool)
    for a in range(n):
        for b in range(a + 1, n):
            one, two = found[a], found[b]
            drift = float(chain.drift_between(np.array([one.i, one.j]), np.array([two.i, two.j])).sum())
            if drift > COMPARABLE_M:
                continue
            comparable[a, b] = comparable[b, a] = True
            through_one = compose(one.T_j_i, between(T_map_keys[one.i], T_map_keys[two.i]))
            through_two = compose(between(T_map_keys[one.j], T_map_keys[two.j]), two.T_j_i)
            apart = between(through_one, through_two)
            close = np.hypot(apart[0], apart[1]) < CLOSE_M + DRIFT_SHARE * drift
            agree[a, b] = agree[b, a] = bool(close and abs(apart[2]) < CLOSE_RAD + TURN_PER_DRIFT * drift)
    return comparable, agree


def agreeing_sets(found: Sequence[Recognised], agree: NDArray[np.bool_]) -> list[list[int]]:
    """Sets of places that all agree pairwise, the best supported first; each place is in one at most.

    A largest clique is grown greedily from every place (Pattabiraman et al. 2015), taken out, and again.
    """
    left, overlap = set(range(len(found))), np.array([place.overlap for place in found])
    sets = []
    while left:
        among = np.array(sorted(left))
        grown = [_grow(seed, among, agree, overlap) for seed in among.tolist()]
        best = max(grown, key=lambda members: (support(found, members), len(members)))
        sets.append(sorted(best))
        left -= set(best)
    return sets


def support(found: Sequence[Recognised], members: Sequence[int]) -> int:
    """How many different submaps were recognised in a set."""
    return len({found[k].i for k in members})


def _grow(seed: int, left: NDArray[np.int64], agree: NDArray[np.bool_], overlap: Array) -> list[int]:
    members, candidates = [seed], left[(left != seed) & agree[seed, left]]
    while len(candidates):
        inside = np.count_nonzero(agree[np.ix_(candidates, candidates)], axis=1)
        best = np.where(inside == inside.max(), overlap[candidates], -np.inf).argmax()
        chosen = int(candidates[best])
        members.append(chosen)
        candidates = candidates[(candidates != chosen) & agree[chosen, candidates]]
    return members


def competing(
    one: Sequence[int], two: Sequence[int], comparable: NDArray[np.bool_], agree: NDArray[np.bool_]
) -> bool:
    """Whether two sets cannot both be true: most of what can be compared between them disagrees."""
    pairs = comparable[np.ix_(list(one), list(two))]
    against = pairs & ~agree[np.ix_(list(one), list(two))]
    return bool(2 * np.count_nonzero(against) > np.count_nonzero(pairs) > 0)
