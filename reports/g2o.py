"""Planar pose graphs in g2o text: read for pictures and checks."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datasets.errors import InputError
from datasets.se2 import SE2, Array


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
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(f"{path}: not a record of loops") from None
    i, j = table[:, 0].astype(np.int64), table[:, 1].astype(np.int64)
    return LoopRecord(i, j, table[:, 2], table[:, 3] > 0.5)


def read_g2o(path: Path) -> PoseGraph:
    """Read VERTEX_SE2 and EDGE_SE2 lines; InputError names a line that is neither readable nor known."""
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
