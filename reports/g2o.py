"""Pose graphs in g2o text, read for pictures and checks; those in space as seen from above."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2, Array


@dataclass(frozen=True, eq=False)
class PoseGraph:
    """Keys (n,) and edges (m,): `T_i_j` measured between keys `i` and `j`, information (m, 3, 3)."""

    T_map_keys: SE2
    i: NDArray[np.int64]
    j: NDArray[np.int64]
    T_i_j: SE2
    information: Array

    def residuals(self) -> tuple[Array, Array]:
        """Distance [m] and yaw [rad] between each measurement and the graph's own poses, (m,)."""
        found = self.T_map_keys[self.i].inverse() @ self.T_map_keys[self.j]
        error = self.T_i_j.inverse() @ found
        return np.linalg.norm(error.xy, axis=-1), np.abs(error.yaw)


@dataclass(frozen=True, eq=False)
class LoopRecord:
    """Loop candidates of a graph, (n,) each: keys `i` and `j`, residual [m], and whether it was accepted."""

    i: NDArray[np.int64]
    j: NDArray[np.int64]
    residual_m: Array
    accepted: NDArray[np.bool_]


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


_XY_YAW = (0, 1, 5, 6, 10, 20)
"""Where the upper triangle of a 6 x 6 matrix, row by row, holds that of x, y and yaw."""


def _seen_from_above(pose: list[float]) -> list[float]:
    """x, y and yaw of x, y, z and a quaternion x, y, z, w."""
    x, y, _, qx, qy, qz, qw = pose
    return [x, y, math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))]


def read_g2o(path: Path) -> PoseGraph:
    """Read vertices and edges, SE2 or SE3:QUAT; InputError names a line that is not readable."""
    poses: dict[int, list[float]] = {}
    edges: list[list[float]] = []
    for number, line in enumerate(path.read_text().splitlines(), start=1):
        tag, *fields = line.split() or [""]
        try:
            if tag == "VERTEX_SE2":
                x, y, yaw = (float(field) for field in fields[1:4])
                poses[int(fields[0])] = [x, y, yaw]
            elif tag == "EDGE_SE2":
                edges.append([float(field) for field in fields[:11]])
            elif tag == "VERTEX_SE3:QUAT":
                poses[int(fields[0])] = _seen_from_above([float(field) for field in fields[1:8]])
            elif tag == "EDGE_SE3:QUAT":
                pose, upper = fields[2:9], fields[9:30]
                above = _seen_from_above([float(field) for field in pose])
                kept = [float(upper[k]) for k in _XY_YAW]
                edges.append([float(fields[0]), float(fields[1]), *above, *kept])
        except (ValueError, IndexError):
            raise InputError(f"{path}, line {number}: not a {tag} line") from None
    if not poses or any(len(edge) != 11 for edge in edges):
        raise InputError(f"{path}: not a planar g2o graph")
    index = {key: position for position, key in enumerate(sorted(poses))}
    table = np.array(edges, dtype=np.float64).reshape(-1, 11)
    try:
        i, j = (np.array([index[int(key)] for key in table[:, column]], dtype=np.int64) for column in (0, 1))
    except KeyError as error:
        raise InputError(f"{path}: an edge names vertex {error}, which is not there") from None
    information = np.zeros((len(table), 3, 3))
    rows, columns = np.triu_indices(3)
    information[:, rows, columns] = table[:, 5:]
    information[:, columns, rows] = table[:, 5:]
    vertices = SE2.from_array(np.array([poses[key] for key in sorted(poses)]))
    return PoseGraph(vertices, i, j, SE2.from_array(table[:, 2:5]), information)
