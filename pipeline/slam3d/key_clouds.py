"""Key clouds as places: neighbouring key clouds together, as surfels around one of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets import se3
from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.slam3d.surfels import LOOSE, Fit, Seen, Surfels, fit, make_surfels

REACH = 3
"""Keys before and after one that make its place."""


@dataclass(eq=False)
class Keys:
    """The key clouds: thinned points (n, 3) each in the base frame, all seen from `origin` (3,) in it."""

    origin: Array
    clouds: list[NDArray[np.float32]] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.clouds)

    def points(self, key: int, most: int) -> Array:
        """At most about `most` points (n, 3) of a key."""
        return thinned(self.clouds[key], most).astype(np.float64)


def thinned(values: NDArray[Any], most: int) -> NDArray[Any]:
    """About `most` of the values (n, ...), evenly spaced."""
    return np.ascontiguousarray(values[:: max(1, len(values) // most)])


def gathered(keys: Keys, T_map_keys: Array, anchor: int, members: Iterable[int]) -> tuple[Array, Array]:
    """Points (n, 3) of the member keys in the frame of key `anchor`, and where each was seen from."""
    T_anchor_map = se3.inverse(T_map_keys[anchor])
    points, views = [], []
    for k in members:
        T = T_anchor_map @ T_map_keys[k]
        points.append(se3.moved(T, keys.clouds[k].astype(np.float64)))
        views.append(np.broadcast_to(se3.moved(T, keys.origin[None]), points[-1].shape))
    return np.ascontiguousarray(np.vstack(points)), np.ascontiguousarray(np.vstack(views))


class Places:
    """The surroundings of keys at fixed poses (n, 4, 4); only those used last are kept."""

    def __init__(self, keys: Keys, T_map_keys: Array, voxel: float) -> None:
        self._keys, self.T_map_keys, self._voxel = keys, T_map_keys, voxel
        self._tree = scipy.spatial.cKDTree(T_map_keys[:, :3, 3])
        self._last: tuple[int, Surfels] | None = None

    def nearest(self, T_map: Array) -> int:
        """The key nearest to a pose (4, 4)."""
        return int(self._tree.query(T_map[:3, 3])[1])

    def points(self, anchor: int) -> tuple[Array, Array]:
        """Points of a place in the frame of its key, and where each was seen from."""
        members = range(max(0, anchor - REACH), min(len(self._keys), anchor + REACH + 1))
        return gathered(self._keys, self.T_map_keys, anchor, members)

    def fit(self, anchor: int, points: Array, T_guess: Array, gate: float, prior: Array = LOOSE) -> Fit:
        """Points (n, 3) of a cloud aligned with the place of a key, from where it is seen from there."""
        if self._last is None or self._last[0] != anchor:
            self._last = anchor, make_surfels(*self.points(anchor), self._voxel)
        seen = Seen(points, self._keys.origin)
        return fit(self._last[1], seen, T_guess, gate=gate, prior=prior, iterations=8)
