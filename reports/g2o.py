"""Pose graphs in g2o text, read for pictures and checks; those in space as seen from above."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.number_text import decimals, whole
from turtlebag.datasets.se2 import SE2, Array


@dataclass(frozen=True, eq=False)
class PoseGraph:
    """Keys (n,) in the order of their numbers, and how many edges join them."""

    T_map_keys: SE2
    edges: int


@dataclass(frozen=True, eq=False)
class LoopRecord:
    """Loop candidates of a graph, (n,) each: keys `i` and `j`, residual [m], and whether it was accepted."""

    i: NDArray[np.int64]
    j: NDArray[np.int64]
    residual_m: Array
    accepted: NDArray[np.bool_]

    def kept(self, keys: int) -> tuple[NDArray[np.int64], Array]:
        """Keys (n, 2) and residuals [m] of the accepted ones in a graph of so many keys."""
        chosen = self.accepted & (np.maximum(self.i, self.j) < keys)
        return np.stack([self.i[chosen], self.j[chosen]], axis=1), self.residual_m[chosen]


def read_loops(path: Path) -> LoopRecord:
    """The loops of a `graph.json`; InputError when it is not one."""
    try:
        loops = json.loads(path.read_text())["loops"]
        rows = [(loop["i"], loop["j"], loop["residual_m"], loop["verdict"] == "accepted") for loop in loops]
        table = np.array(rows, dtype=np.float64).reshape(-1, 4)
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
        raise InputError(f"{path}: not a record of loops") from None
    i, j = table[:, 0].astype(np.int64), table[:, 1].astype(np.int64)
    return LoopRecord(i, j, table[:, 2], table[:, 3] > 0.5)


def read_g2o(path: Path) -> PoseGraph:
    """Read vertices and count edges, SE2 or SE3:QUAT; InputError names a line that is not readable."""
    poses: dict[int, list[float]] = {}
    joined: list[int] = []
    for number, line in enumerate(path.read_text().splitlines(), start=1):
        tag, *fields = line.split() or [""]
        try:
            if tag == "VERTEX_SE2":
                x, y, yaw = decimals(fields[1:4])
                poses[whole(fields[0])] = [x, y, yaw]
            elif tag == "VERTEX_SE3:QUAT":
                x, y, _, qx, qy, qz, qw = decimals(fields[1:8])
                yaw = math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
                poses[whole(fields[0])] = [x, y, yaw]
            elif tag in ("EDGE_SE2", "EDGE_SE3:QUAT"):
                joined += [whole(fields[0]), whole(fields[1])]
        except (ValueError, IndexError):
            raise InputError(f"{path}, line {number}: not a {tag} line") from None
    if not poses:
        raise InputError(f"{path}: not a g2o graph")
    if missing := set(joined) - set(poses):
        raise InputError(f"{path}: an edge names vertex {min(missing)}, which is not there")
    vertices = SE2.from_array(np.array([poses[key] for key in sorted(poses)]))
    return PoseGraph(vertices, len(joined) // 2)
