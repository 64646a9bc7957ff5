"""Drift: the covariance of one key scan's pose relative to another, accumulated along the graph.

Every step and loop has a covariance, heading included. Expressed at the map's origin, as motions
of the whole plane, covariances simply add up along a path through the graph; at its end they
are evaluated at the key scan: equation (4) of docs/how-it-maps.md. So a small heading error moves a distant
place far.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.slam.graph.constraints import Constraint
from turtlebag.pipeline.slam.graph.pose_graph import positive_definite

# The steps' covariances are too large: over 3 to 300 m the squared errors are 0.04 to 0.57 of the accumulated
# covariance (six logs with a reference, the mean of each).
HONEST = 0.25
# A pose is within this many standard deviations: in the plane, 99 of 100 are.
SIGMAS = 3.0
# Covariance of a completely unknown pose.
ANYWHERE = 1e12 * np.eye(3)
# Indices of x, y and yaw among rotation and translation in space.
IN_PLANE = [3, 4, 2]


@dataclass(frozen=True, eq=False)
class Drift:
    """Key poses (n, 3), and the covariances about the origin of the steps between them (n - 1, 3, 3).
    `broken` (n - 1,) are steps with an unknown motion."""

    T_map_keys: Array
    steps: Array
    broken: NDArray[np.bool_]

    def along(self, i: NDArray[np.int64], j: NDArray[np.int64]) -> Array:
        """Covariance accumulated along the log between keys (k,) and others (k,), about the origin, (k, 3,
        3); unbounded over a break."""
        total, part = self._since_first
        gathered = total[np.maximum(i, j)] - total[np.minimum(i, j)]
        gathered[part[i] != part[j]] = ANYWHERE
        return gathered

    @cached_property
    def _since_first(self) -> tuple[Array, NDArray[np.int64]]:
        """The accumulated steps at each key (n, 3, 3), and the unbroken part of the log that it belongs to
        (n,)."""
        total = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(self.steps, axis=0)])
        return total, np.concatenate([[0], np.cumsum(self.broken)])

    def ways(self, loops: Sequence[Constraint]) -> Callable[[int, NDArray[np.int64]], Array]:
        """The covariance from a given key to earlier ones (k,), along the most certain path through steps and
        loops, (k, 3, 3). Between two keys with loops the log is the only way: a key there is as far as the
        nearer of the two, and as it is from that one by the log. So the search is one for all of them."""
        n = len(self.T_map_keys)
        ends = np.array([(c.i, c.j) for c in loops], dtype=np.int64).reshape(-1, 2)
        whole = np.flatnonzero(~self.broken)
        edges = np.vstack([np.column_stack([whole, whole + 1]), ends])
        of_loops = covariances(self.T_map_keys, ends[:, 1], [c.information for c in loops])
        covariance = np.concatenate([self.steps[whole], of_loops])
        # One array layout only, because another would be compiled separately: four seconds during which the
        # robot waits.
        graph = (*_rows(n, edges), covariance, edges, np.ascontiguousarray(self.T_map_keys))
        _, part = self._since_first
        tied = np.unique(np.append(np.flatnonzero(np.append(True, self.broken)), ends))
        search = lru_cache(maxsize=1)(lambda k: _surest(ANYWHERE, *graph, k))

        def from_key(i: int, others: NDArray[np.int64]) -> Array:
            after = int(np.searchsorted(tied, i, side="right"))
            beside = [k for k in tied[after - 1 : after + 1].tolist() if part[k] == part[i]]
            nearer = min(beside, key=lambda k: abs(k - i))
            by_log = self.along(np.full(len(others), i), others)
            from_there = search(nearer)[others]
            reached = from_there[:, :1, :1] < ANYWHERE[0, 0]
            by_loops = from_there + self.along(np.array([i]), np.array([nearer]))
            between = (beside[0] <= others) & (others <= max(i, nearer))
            return np.where(between[:, None, None], by_log, np.where(reached, by_loops, ANYWHERE))

        return from_key


def drift_of(
    T_map_keys: Array, steps: Sequence[Constraint], broken: NDArray[np.bool_] | None = None
) -> Drift:
    """The drift of keys (n, 3) connected by steps."""
    n = len(T_map_keys)
    size = len(steps[0].information) if steps else 3
    information = np.zeros((max(n - 1, 0), size, size))
    along = [c for c in steps if c.j == c.i + 1 < n]
    if along:
        np.add.at(information, [c.i for c in along], np.array([c.information for c in along]))
    of_steps = covariances(T_map_keys, np.arange(1, n), information)
    return Drift(T_map_keys, of_steps, np.zeros(len(of_steps), dtype=bool) if broken is None else broken)


def covariances(T_map_keys: Array, ends: NDArray[np.int64], information: Sequence[Array] | Array) -> Array:
    """Information (k, 3, 3), in space (k, 6, 6), in the frames of keys `ends` (k,) as covariances (k, 3, 3)
    of x, y and yaw about the map's origin."""
    if len(ends) == 0:
        return np.zeros((0, 3, 3))
    own = HONEST * np.linalg.inv(positive_definite(np.asarray(information)))
    if len(information[0]) == 6:
        own = own[:, IN_PLANE][:, :, IN_PLANE]
    moved = plane_motions(T_map_keys[ends])
    return np.asarray(moved @ own @ moved.transpose(0, 2, 1))


def plane_motions(T_map_keys: Array) -> Array:
    """Small motions in the frames of poses (n, 3) as motions of the plane about its origin, (n, 3, 3)."""
    x, y, yaw = T_map_keys.T
    moved = np.zeros((len(T_map_keys), 3, 3))
    moved[:, 0, 0] = moved[:, 1, 1] = np.cos(yaw)
    moved[:, 1, 0] = np.sin(yaw)
    moved[:, 0, 1] = -moved[:, 1, 0]
    moved[:, 0, 2], moved[:, 1, 2], moved[:, 2, 2] = y, -x, 1.0
    return moved


def read_at(covariance: Array, poses: Array) -> Array:
    """Covariances (..., 3, 3) about the origin as those of poses (..., 3), along the map's axes."""
    x, y = poses[..., 0, None], poses[..., 1, None]
    out = np.array(covariance)
    for half in (out, np.swapaxes(out, -1, -2)):  # the lever's rows, then its columns
        half[..., 0, :] -= y * half[..., 2, :]
        half[..., 1, :] += x * half[..., 2, :]
    return out


def reach(covariance: Array) -> tuple[Array, Array]:
    """How far off [m] and how far turned [rad] a pose with covariance (..., 3, 3) may be."""
    xx, yy, xy = covariance[..., 0, 0], covariance[..., 1, 1], covariance[..., 0, 1]
    largest = 0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy)
    return SIGMAS * np.sqrt(largest), SIGMAS * np.sqrt(covariance[..., 2, 2])


def sigma_m(covariance: Array) -> Array:
    """Standard deviation of a pose's position with covariance (..., 3, 3), where it is largest [m]."""
    return np.asarray(reach(covariance)[0] / SIGMAS)


def likely(squares: Array) -> NDArray[np.bool_]:
    """Whether poses at such squared Mahalanobis distances from each other may be the same."""
    return squares < SIGMAS**2


def _rows(n: int, edges: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """For each key the start of its edges (n + 1,), and the edges of all keys one after another."""
    ends = edges.ravel()
    return np.searchsorted(np.sort(ends), np.arange(n + 1)), np.argsort(ends, kind="stable") // 2


@njit(cache=True)
def _surest(
    anywhere: Array,
    first: NDArray,
    of_key: NDArray,
    covariance: Array,
    edges: NDArray,
    poses: Array,
    start: int,
) -> Array:
    """Dijkstra over the variance that each edge adds to its end and to a point a metre beside it."""
    n = len(poses)
    out = np.empty((n, 3, 3))
    out[:] = anywhere
    best = np.full(n, np.inf)
    by = np.full(n, -1)  # the edge that each key is reached by
    done = np.zeros(n, dtype=np.bool_)
    best[start] = 0.0
    heap = [(0.0, start)]
    while len(heap) > 0:
        cost, k = heapq.heappop(heap)
        if done[k]:
            continue
        done[k] = True
        if k == start:
            out[k] = 0.0
        else:
            before = edges[by[k], 0] + edges[by[k], 1] - k
            for a in range(3):
                for b in range(3):
                    out[k, a, b] = out[before, a, b] + covariance[by[k], a, b]
        for r in range(first[k], first[k + 1]):
            e = of_key[r]
            other = edges[e, 0] + edges[e, 1] - k
            c, x, y = covariance[e], poses[edges[e, 1], 0], poses[edges[e, 1], 1]
            # at the edge's own end: c is about the origin
            xx = c[0, 0] - 2.0 * y * c[0, 2] + y * y * c[2, 2]
            yy = c[1, 1] + 2.0 * x * c[1, 2] + x * x * c[2, 2]
            total = cost + xx + yy + c[2, 2]
            if total < best[other]:
                best[other] = total
                by[other] = e
                heapq.heappush(heap, (total, other))
    return out
