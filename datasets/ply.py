"""Point clouds in binary little-endian PLY files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.number_text import whole
from turtlebag.datasets.se2 import Array

_TYPES = {"double": "<f8", "float": "<f4", "uchar": "u1", "char": "i1", "ushort": "<u2", "short": "<i2",
          "uint": "<u4", "int": "<i4"}  # fmt: skip
_LONGEST_HEADER = 4096
_VERTEX = np.dtype([(axis, "<f8") for axis in "xyz"] + [(name, "u1") for name in ("red", "green", "blue")])


def write_ply(path: Path, points: Array, colours: Array) -> None:
    """Write points (n, 3) [m] with colours (n, 3), 0..1."""
    vertices = np.empty(len(points), _VERTEX)
    for k, axis in enumerate("xyz"):
        vertices[axis] = points[:, k]
    for k, name in enumerate(("red", "green", "blue")):
        vertices[name] = np.floor(colours[:, k] * 255.0 + 0.5)
    properties = [f"property double {axis}" for axis in "xyz"]
    properties += [f"property uchar {name}" for name in ("red", "green", "blue")]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}", *properties]
    path.write_bytes("\n".join([*header, "end_header", ""]).encode() + vertices.tobytes())


def read_ply(path: Path) -> Array:
    """Points (n, 3) of the file's vertices; InputError for any other file."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    end = data.find(b"end_header\n", 0, _LONGEST_HEADER)
    lines = [line.split() for line in data[: max(end, 0)].decode("ascii", "replace").splitlines()]
    if not lines or lines[0] != ["ply"] or ["format", "binary_little_endian", "1.0"] not in lines:
        raise InputError(f"{path}: not a binary little-endian PLY file")
    try:
        count = next(whole(words[2]) for words in lines if words[:2] == ["element", "vertex"])
        layout = np.dtype([(words[2], _TYPES[words[1]]) for words in lines if words[0] == "property"])
        vertices = np.frombuffer(data, layout, count, end + len(b"end_header\n"))
        return np.stack([vertices[axis].astype(np.float64) for axis in "xyz"], axis=-1)
    except (StopIteration, KeyError, IndexError, ValueError):
        raise InputError(f"{path}: no points x, y, z in this PLY file, or it is truncated") from None
