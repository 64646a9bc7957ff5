"""Triangle meshes from STL, OBJ and COLLADA files, in metres."""

from __future__ import annotations

import struct
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.number_text import decimal, decimals, whole
from turtlebag.datasets.se2 import Array


def load_mesh(path: Path) -> Array:
    """Triangles (n, 3, 3) of a file, its unit applied; InputError when it cannot be read.

    COLLADA's unit is honoured and its up axis ignored, as Gazebo Classic does.
    """
    readers = {".stl": _stl, ".obj": _obj, ".dae": _collada}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"{path}: meshes are read from {', '.join(readers)}")
    try:
        triangles = reader(path)
    except (ValueError, IndexError, KeyError, struct.error, ET.ParseError, OSError) as error:
        raise InputError(f"{path}: not a readable mesh ({error})") from None
    if len(triangles) == 0:
        raise InputError(f"{path}: contains no triangles")
    return triangles


def _stl(path: Path) -> Array:
    data = path.read_bytes()
    count = struct.unpack_from("<I", data, 80)[0] if len(data) >= 84 else -1
    if len(data) == 84 + 50 * count:
        records = np.frombuffer(
            data, dtype=np.dtype([("f", "<f4", 12), ("a", "<u2")]), count=count, offset=84
        )
        return records["f"][:, 3:].reshape(-1, 3, 3).astype(np.float64)
    words = [line.split() for line in data.decode().splitlines()]
    corners = [decimals(word[1:4]) for word in words if word[:1] == ["vertex"]]
    return np.array(corners, dtype=np.float64).reshape(-1, 3, 3)


def _obj(path: Path) -> Array:
    corners: list[list[float]] = []
    faces: list[list[int]] = []
    for line in path.read_text().splitlines():
        word = line.split()
        if word[:1] == ["v"]:
            corners.append(decimals(word[1:4]))
        elif word[:1] == ["f"]:
            numbers = [whole(part.split("/")[0]) for part in word[1:]]
            numbers = [n - 1 if n > 0 else len(corners) + n for n in numbers]
            faces += [[numbers[0], numbers[i], numbers[i + 1]] for i in range(1, len(numbers) - 1)]
    return np.array(corners, dtype=np.float64)[np.array(faces, dtype=np.int64).reshape(-1, 3)]


def _collada(path: Path) -> Array:
    root = ET.parse(path).getroot()
    space = root.tag.partition("}")[0] + "}" if root.tag.startswith("{") else ""
    unit = root.find(f"{space}asset/{space}unit")
    metre = decimal(unit.get("meter", "1")) if unit is not None else 1.0
    geometries = {str(g.get("id")): _geometry(g, space) for g in root.iter(f"{space}geometry")}
    placed = [
        part
        for scene in root.iter(f"{space}visual_scene")
        for node in scene.findall(f"{space}node")
        for part in _placed(node, np.eye(4), geometries, space)
    ]
    return metre * np.vstack([np.zeros((0, 3, 3)), *(placed or list(geometries.values()))])


def _placed(node: ET.Element, transform: Array, geometries: dict[str, Array], space: str) -> list[Array]:
    """Triangles of a scene node and the nodes below it, moved by their matrices."""
    for matrix in node.findall(f"{space}matrix"):
        transform = transform @ np.array(decimals((matrix.text or "").split())).reshape(4, 4)
    for move in node.findall(f"{space}translate"):
        shift = np.eye(4)
        shift[:3, 3] = decimals((move.text or "").split())
        transform = transform @ shift
    for scale in node.findall(f"{space}scale"):
        transform = transform @ np.diag([*decimals((scale.text or "").split()), 1.0])
    out = []
    for instance in node.findall(f"{space}instance_geometry"):
        triangles = geometries[str(instance.get("url", "")).lstrip("#")]
        out.append(triangles @ transform[:3, :3].T + transform[:3, 3])
    for child in node.findall(f"{space}node"):
        out += _placed(child, transform, geometries, space)
    return out


def _geometry(geometry: ET.Element, space: str) -> Array:
    """Triangles of one COLLADA geometry (triangles and polylists)."""
    arrays = {
        str(source.get("id")): np.array(decimals((values.text or "").split())).reshape(-1, 3)
        for source in geometry.iter(f"{space}source")
        if (values := source.find(f"{space}float_array")) is not None
        and len((values.text or "").split()) % 3 == 0
    }
    vertices = {
        str(v.get("id")): str(i.get("source")).lstrip("#")
        for v in geometry.iter(f"{space}vertices")
        for i in v.findall(f"{space}input")
        if i.get("semantic") == "POSITION"
    }
    parts = [np.zeros((0, 3, 3))]
    for kind in ("triangles", "polylist", "polygons"):
        for group in geometry.iter(f"{space}{kind}"):
            inputs = group.findall(f"{space}input")
            stride = 1 + max(whole(i.get("offset", "0")) for i in inputs)
            corner = next(i for i in inputs if i.get("semantic") == "VERTEX")
            positions = arrays[vertices[str(corner.get("source")).lstrip("#")]]
            for p in group.findall(f"{space}p"):
                numbers = np.array([whole(v) for v in (p.text or "").split()], dtype=np.int64)
                index = numbers.reshape(-1, stride)[:, whole(corner.get("offset", "0"))]
                counts = (group.findtext(f"{space}vcount") or "").split() if kind == "polylist" else []
                sizes = [whole(c) for c in counts] or (
                    [len(index)] if kind == "polygons" else [3] * (len(index) // 3)
                )
                parts.append(positions[_fans(index, sizes)])
    return np.vstack(parts)


def _fans(index: np.ndarray, sizes: list[int]) -> np.ndarray:
    """Polygons of the given corner counts as triangles, (n, 3) indices."""
    triangles, start = [], 0
    for size in sizes:
        face = index[start : start + size]
        triangles += [[face[0], face[i], face[i + 1]] for i in range(1, size - 1)]
        start += size
    return np.array(triangles, dtype=np.int64).reshape(-1, 3)
