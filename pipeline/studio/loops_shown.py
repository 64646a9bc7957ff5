"""The pose graph for display, and the two scans of a loop overlaid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.deskew import deskewed
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.mapper import SlamResult
from turtlebag.pipeline.slam.online.mapper import Mapper
from turtlebag.pipeline.studio.view import Graph, LoopMarks

STEP, LOOP = 0, 1


@dataclass(frozen=True, eq=False)
class ShownLoop:
    """A loop: key numbers, the pose of key i relative to key j (3,), and its description."""

    i: int
    j: int
    T_j_i: Array
    told: str


@dataclass(frozen=True, eq=False)
class ShownGraph:
    """Poses of the key scans, their scan numbers in the log (n,), and the loops."""

    graph: Graph
    keys: NDArray[np.int64]
    loops: tuple[ShownLoop, ...]

    @property
    def pairs(self) -> set[tuple[int, int]]:
        """The scan numbers of each loop."""
        return {(int(self.keys[loop.i]), int(self.keys[loop.j])) for loop in self.loops}

    def laid(self, log: Recording, scan: int, place: int, motion: SE2 | None = None) -> LoopMarks:
        """A scan overlaid on a place by the loop between them or, without one, by the map.

        InputError for scans that are no key scans.
        """
        i, j = (self._key(number) for number in (scan, place))
        T_map_keys = SE2(self.graph.nodes)
        T_j_i = T_map_keys[j].inverse() @ T_map_keys[i]
        told = "no loop between these scans"
        for loop in self.loops:
            if (loop.i, loop.j) == (i, j):
                measured, told = SE2(loop.T_j_i), loop.told
                off = (measured.inverse() @ T_j_i).xyt
                left = f"{np.hypot(off[0], off[1]):.3f} m, {np.rad2deg(abs(off[2])):.2f} deg residual"
                T_j_i, told = measured, f"{told}; {left}"
        laid = T_map_keys[j] @ T_j_i @ points_of(log, scan, motion)
        return LoopMarks(scan, place, laid, T_map_keys[j] @ points_of(log, place, motion), told)

    def _key(self, scan: int) -> int:
        key = int(np.searchsorted(self.keys, scan))
        if key == len(self.keys) or self.keys[key] != scan:
            raise InputError(f"loop_show: scan {scan} is not in the graph; choose one of its nodes")
        return key


def graph_of(result: SlamResult) -> ShownGraph:
    """The graph of a finished map, with the accepted loops."""
    loops = []
    for loop in result.loops:
        if loop.accepted:
            told = f"found by distance: score {loop.score:.2f}, overlap {loop.overlap:.2f}"
            loops.append(ShownLoop(loop.i, loop.j, loop.T_j_i, f"{told}, {loop.rmse * 1e3:.0f} mm RMSE"))
    for place in result.recognised:
        if place.verdict == "accepted":
            told = (
                f"place recognised: overlap {place.overlap:.2f}, {place.violation:.1%} free-space violations"
            )
            loops.append(ShownLoop(place.i, place.j, place.T_j_i, told))
    return _shown(result.T_map_keys, result.keys, loops)


def graph_of_mapper(mapper: Mapper, first: int) -> ShownGraph:
    """The graph of a map that is being made, whose scan 0 is scan `first` of the log."""
    loops = [
        ShownLoop(c.j, c.i, c.T_i_j, "found while mapping") for c in mapper.constraints if c.kind == "loop"
    ]
    return _shown(mapper.T_map_keys, mapper.keys + first, loops)


def _shown(T_map_keys: SE2, keys: NDArray[np.int64], loops: list[ShownLoop]) -> ShownGraph:
    steps = [(k, k + 1, STEP) for k in range(len(keys) - 1)]
    edges = np.array([*steps, *((loop.i, loop.j, LOOP) for loop in loops)], dtype=np.int32).reshape(-1, 3)
    return ShownGraph(Graph(T_map_keys.xyt.copy(), edges), keys, tuple(loops))


def points_of(recording: Recording, scan: int, motion: SE2 | None = None) -> Array:
    """Where the beams of a scan ended, (n, 2) in the base frame at its stamp.

    `motion` (n_scans, knots) is the base's during each sweep; without it a sweep is taken as one instant.
    """
    seen = recording.scan(scan)
    T_base_lidar, hit = recording.lidars[seen.sensor].T_base_lidar, seen.valid()
    knots = np.zeros((1, 3)) if motion is None else motion[scan].xyt
    origins, directions = deskewed(seen.lidar.directions, seen.lidar.shares, T_base_lidar.xyt, knots)
    return origins[hit] + seen.ranges[hit, None] * directions[hit]
