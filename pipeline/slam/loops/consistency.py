"""Pairwise consistency of recognised places (PCM), and the largest consistent sets.

Mangelson et al. (2018): two places recognised by two submaps are consistent if the cycle through both closes
within the drift between them. True places are consistent with all other true ones; false ones in a
repetitive building with fewer.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.slam.graph.constraints import Loop
from turtlebag.pipeline.slam.graph.drift import Drift, covariances, likely, reach, read_at


def consistency(
    found: Sequence[Loop], drift: Drift, reach_m: float, covariance_scale: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Matrices (n, n) over pairs of places: whether they can be compared at all, and whether they agree.

    Each place moves the newer part of the log onto the older one. If both are true, the two motions are
    nearly equal: within the covariance of the paths between them and of the places themselves (their
    information divided by `covariance_scale`), equation (5) of docs/how-it-maps.md. Beyond `reach_m`, two
    places cannot be compared.
    """
    n, T = len(found), drift.T_map_keys
    comparable, agree = np.zeros((n, n), dtype=bool), np.eye(n, dtype=bool)
    if n == 0:
        return comparable, agree
    i, j = np.array([place.i for place in found]), np.array([place.j for place in found])
    moves = SE2(T[j]) @ SE2(np.array([place.T_j_i for place in found])) @ SE2(T[i]).inverse()
    at_place = (moves @ SE2(T[i])).xyt
    own = covariances(at_place, np.arange(n), [place.information / covariance_scale for place in found])
    turned = _about(moves)
    for a in range(n):
        others = np.arange(a + 1, n)
        if len(others) == 0:
            continue
        at = np.full(len(others), a)
        ways = drift.along(j[at], j[others]) + turned[a] @ drift.along(i[at], i[others]) @ turned[a].T
        covariance = read_at(ways + own[a] + own[others], at_place[others])
        near = reach(covariance)[0] < reach_m
        covariance, b = covariance[near], others[near]
        comparable[a, b] = comparable[b, a] = True
        by_a = moves[a] @ SE2(T[i[b]])
        apart = np.column_stack([by_a.xy - at_place[b, :2], (moves[b].inverse() @ moves[a]).yaw])
        squares = np.einsum("na,na->n", apart, np.linalg.solve(covariance, apart[..., None])[..., 0])
        agree[a, b] = agree[b, a] = likely(squares)
    return comparable, agree


def _about(moves: SE2) -> Array:
    """Matrices (n, 3, 3) that carry motions of the plane about the origin along with rigid moves (n,)."""
    out = moves.matrix()
    out[:, 0, 2], out[:, 1, 2] = moves.y, -moves.x
    return out


def agreeing_sets(found: Sequence[Loop], agree: NDArray[np.bool_]) -> list[list[int]]:
    """Sets of places that all agree pairwise, the best supported first; each place is in one at most.

    A largest clique is grown greedily from every place (Pattabiraman et al. 2015), taken out, and again.
    """
    left, overlap = set(range(len(found))), np.array([place.overlap for place in found])
    sets = []
    while left:
        among = np.array(sorted(left))
        grown = [grow_set(seed, among, agree, overlap).tolist() for seed in among.tolist()]
        best = max(grown, key=lambda members: (support(found, members), len(members)))
        sets.append(sorted(best))
        left -= set(best)
    return sets


def support(found: Sequence[Loop], members: Sequence[int]) -> int:
    """The number of different submaps recognised in a set."""
    return len({found[k].i for k in members})


@njit(cache=True)
def grow_set(seed: int, left: NDArray, agree: NDArray, overlap: Array) -> NDArray:
    """The set grown from one place among those `left` (n,): the next member is the candidate that agrees with
    most other candidates, and of several the one that fits best."""
    members, candidates = [seed], left[(left != seed) & agree[seed, left]]
    inside = np.zeros(len(candidates), dtype=np.int64)
    for a in range(len(candidates)):
        for b in range(len(candidates)):
            inside[a] += agree[candidates[a], candidates[b]]
    while len(candidates) > 0:
        best = 0
        for a in range(1, len(candidates)):
            more = inside[a] - inside[best]
            if more > 0 or (more == 0 and overlap[candidates[a]] > overlap[candidates[best]]):
                best = a
        chosen = candidates[best]
        members.append(chosen)
        stays = np.array([k != chosen and agree[chosen, k] for k in candidates])
        for gone in candidates[~stays]:
            for a in range(len(candidates)):
                inside[a] -= agree[candidates[a], gone]
        candidates, inside = candidates[stays], inside[stays]
    return np.array(members)


def competing(
    one: Sequence[int], two: Sequence[int], comparable: NDArray[np.bool_], agree: NDArray[np.bool_]
) -> bool:
    """Whether two sets cannot both be true: most of what can be compared between them disagrees."""
    pairs = comparable[np.ix_(list(one), list(two))]
    against = pairs & ~agree[np.ix_(list(one), list(two))]
    return bool(2 * np.count_nonzero(against) > np.count_nonzero(pairs) > 0)
