"""Key clouds as places: neighbouring key clouds together, as points and as surfels around one of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets import se3
from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.slam3d.surfels import Surfels, make_surfels


@dataclass(eq=False)
class Keys:
    """The key clouds: thinned points (n, 3) each in the base frame, all seen from `origin` (3,) in it."""

    origin: Array
    clouds: list[NDArray[np.float32]] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.clouds)


def gathered(keys: Keys, T_map_keys: Array, anchor: int, members: Iterable[int]) -> tuple[Array, Array]:
    """Points (n, 3) of the member keys in the frame of key `anchor`, and where each was seen from."""
    T_anchor_map = se3.inverse(T_map_keys[anchor])
    points, views = [], []
    for k in members:
        T = T_anchor_map @ T_map_keys[k]
        points.append(se3.moved(T, keys.clouds[k].astype(np.float64)))
        views.append(np.broadcast_to(se3.moved(T, keys.origin[None]), points[-1].shape))
    return np.ascontiguousarray(np.vstack(points)), np.ascontiguousarray(np.vstack(views))


def around(anchor: int, reach: int, count: int) -> range:
    """Keys up to `reach` before and after one, in time."""
    return range(max(0, anchor - reach), min(count, anchor + reach + 1))


class Places:
    """Surfels of each key's surroundings at fixed poses, made when first asked for."""

    def __init__(self, keys: Keys, T_map_keys: Array, voxel: float, reach: int) -> None:
        self._keys, self._T, self._voxel, self._reach = keys, T_map_keys, voxel, reach
        self._made: dict[int, Surfels] = {}

    def surfels(self, anchor: int) -> Surfels:
        """The place of one key, in its frame."""
        if anchor not in self._made:
            members = around(anchor, self._reach, len(self._T))
            self._made[anchor] = make_surfels(*gathered(self._keys, self._T, anchor, members), self._voxel)
        return self._made[anchor]

    def forget(self, anchor: int) -> None:
        """Free the memory of a place that is not needed again soon."""
        self._made.pop(anchor, None)
