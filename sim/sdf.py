"""Gazebo SDF: worlds and models with static boxes, cylinders, spheres, planes and meshes, as our solids."""

from __future__ import annotations

import math
import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import scipy

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.number_text import decimal, decimals
from turtlebag.datasets.se2 import Array
from turtlebag.sim.meshes import load_mesh
from turtlebag.sim.shapes import Solid, ball, cylinder, mesh, prism

UPRIGHT = 1e-6
"""A box or cylinder tilted by more than this sine is taken as a mesh."""
ROUND = 48
"""Corners of a tilted cylinder's rim."""

PATHS = ("GAZEBO_MODEL_PATH", "GAZEBO_RESOURCE_PATH", "GZ_SIM_RESOURCE_PATH", "IGN_GAZEBO_RESOURCE_PATH")
"""Variables with the folders in which Gazebo, by its version, looks for models."""
FUEL = re.compile(
    r"https?://(?:fuel|app)\.(?:gazebosim|ignitionrobotics)\.org/(?:[\d.]+/)?(?P<owner>[^/]+)/(?:fuel/)?models/"
    r"(?P<name>[^/]+)(?:/(?:\d+|tip)(?=/|$))?(?:/files(?=/|$))?(?P<rest>.*)"
)
"""Where Gazebo's library of models has one, or a file of one."""
FLOOR_AND_LIGHT = ("ground_plane", "sun")
"""Models of nearly every world that no lidar sees: the floor is there anyway."""

BOX_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


def load_sdf(path: Path) -> tuple[str, list[Solid]]:
    """Name and solids of a .world or .sdf file; everything in it is static.

    Poses nest (model in model, link, collision); models' poses in a `<state>` override, as Gazebo
    saves them. `<include>` is looked for beside the file, in folders `models` near it and on the paths of
    Gazebo. InputError names what cannot be read, and all that is not found in one line.
    """
    root = _parse(path)
    world = root.find("world")
    top = world if world is not None else root
    solids: list[Solid] = []
    reader = _Reader(path)
    for number, (name, transform, collision) in enumerate(reader.collisions(top, reader.state_poses(world))):
        solids += reader.solid(f"{name}_{number}", transform, collision)
    if reader.missing:
        raise InputError(
            f"{path}: not found: {', '.join(reader.missing)}; "
            "put the models beside the file, or set GAZEBO_MODEL_PATH to the folder that holds them"
        )
    return str(top.get("name") or path.stem), solids


def _parse(path: Path) -> ET.Element:
    try:
        root = ET.parse(path).getroot()
    except (ET.ParseError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not readable as SDF ({error})") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    if root.tag not in ("sdf", "gazebo", "world", "model"):
        raise InputError(f"{path}: not an SDF file (its root is <{root.tag}>)")
    return root


def pose_matrix(text: str | None) -> Array:
    """`x y z roll pitch yaw` as a (4, 4) matrix, nothing as the identity; ValueError when it is neither."""
    matrix = np.eye(4)
    if text is None or not text.strip():
        return matrix
    values = decimals(text.split())
    if len(values) != 6 or not all(math.isfinite(value) for value in values):
        raise ValueError(f"pose '{' '.join(text.split())}' is not six finite numbers")
    (cr, cp, cy), (sr, sp, sy) = np.cos(values[3:]), np.sin(values[3:])
    matrix[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    matrix[:3, 3] = values[:3]
    return matrix


class _Reader:
    """Walks one file and what it includes."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.missing: dict[str, None] = {}
        """URIs of models and meshes that were not found, in order."""
        near = [path.parent, path.parent / "models", path.parent.parent / "models"]
        folders = ":".join(os.environ.get(name, "") for name in PATHS)
        self._folders = [*near, *map(Path, filter(None, folders.split(":")))]

    def collisions(
        self, parent: ET.Element, state: dict[str, Array], base: Array | None = None, depth: int = 0
    ) -> Iterator[tuple[str, Array, ET.Element]]:
        """(model name, pose in the world (4, 4), collision element) of all that stands in `parent`."""
        base = np.eye(4) if base is None else base
        if depth > 16:
            raise InputError(f"{self._path}: models are nested or included too deep")
        for model in parent.findall("model"):
            name = str(model.get("name"))
            pose = state[name] if name in state else self._pose(model)
            yield from self._of_model(model, base @ pose, depth)
        for include in parent.findall("include"):
            found = self._included(_uri(include))
            if found is None:
                continue
            pose = self._pose(include) if include.find("pose") is not None else self._pose(found)
            pose = state.get(include.findtext("name") or "", pose)
            yield from self._of_model(found, base @ pose, depth)

    def _of_model(
        self, model: ET.Element, transform: Array, depth: int
    ) -> Iterator[tuple[str, Array, ET.Element]]:
        for link in model.findall("link"):
            for collision in link.findall("collision"):
                placed = transform @ self._pose(link) @ self._pose(collision)
                yield str(model.get("name")), placed, collision
        yield from self.collisions(model, {}, transform, depth + 1)

    def state_poses(self, world: ET.Element | None) -> dict[str, Array]:
        """Poses that a saved `<state>` gives to the world's models."""
        models = [] if world is None else world.findall("state/model")
        return {
            str(model.get("name")): self._pose(model) for model in models if model.find("pose") is not None
        }

    def _pose(self, element: ET.Element) -> Array:
        try:
            return pose_matrix(element.findtext("pose"))
        except ValueError as error:
            raise InputError(f"{self._path}: {element.tag} {element.get('name')}: {error}") from None

    def _included(self, uri: str) -> ET.Element | None:
        """The model that a URI names; None for the floor, the sun and what is not found."""
        if _is_floor_or_light(uri):
            return None
        folder = self._find(uri) if uri else None
        if folder is None:
            self.missing[uri or "an include without a uri"] = None
            return None
        files = (
            [folder] if folder.is_file() else sorted(folder.glob("model.sdf")) or sorted(folder.glob("*.sdf"))
        )
        if not files:
            raise InputError(f"{self._path}: include {uri}: {folder} contains no .sdf file")
        root = _parse(files[-1])
        model = root if root.tag == "model" else root.find("model")
        if model is None:
            raise InputError(f"{files[-1]}: contains no model")
        return model

    def _find(self, uri: str) -> Path | None:
        fuel = FUEL.fullmatch(uri)
        relative = unquote(fuel["name"]) + fuel["rest"] if fuel else uri.split("://", 1)[-1].lstrip("/")
        # model://name/meshes/x.dae: the name may be the folder that the file itself lies in.
        parts = Path(relative).parts
        names = [Path(relative), Path(*parts[1:])] if len(parts) > 1 else [Path(relative)]
        for folder in [*self._folders, *self._path.parents[:3]]:
            for name in names:
                if (folder / name).exists():
                    return folder / name
        return None

    def solid(self, name: str, transform: Array, collision: ET.Element) -> list[Solid]:
        """The solids of one collision; none for a plane, a shape that is out of the robot's world and a mesh
        that is not found."""
        geometry = collision.find("geometry")
        shape = None if geometry is None else next(iter(geometry), None)
        if shape is None or shape.tag in ("plane", "empty", "heightmap"):
            return []
        try:
            if shape.tag == "mesh":
                return self._mesh(name, transform, shape)
            return [self._shape(name, transform, shape)]
        except (ValueError, TypeError) as error:
            raise InputError(f"{self._path}: {name}: {shape.tag}: {error}") from None

    def _shape(self, name: str, transform: Array, shape: ET.Element) -> Solid:
        position, rotation = transform[:3, 3], transform[:3, :3]
        upright = abs(abs(rotation[2, 2]) - 1.0) < UPRIGHT
        if shape.tag == "sphere":
            return ball(name, tuple(position), _number(shape, "radius"))
        if shape.tag == "cylinder":
            radius, length = _number(shape, "radius"), _number(shape, "length")
            if upright:
                z = (float(position[2]) - length / 2.0, float(position[2]) + length / 2.0)
                return cylinder(name, (float(position[0]), float(position[1])), radius, z)
            angles, up = np.arange(ROUND) * (2.0 * math.pi / ROUND), np.full(ROUND, 0.5 * length)
            rim = np.stack([radius * np.cos(angles), radius * np.sin(angles), up], axis=-1)
            return mesh(name, _hull(np.vstack([rim, rim * [1, 1, -1]])) @ rotation.T + position)
        if shape.tag == "box":
            size = np.array(decimals((shape.findtext("size") or "").split()))
            if size.shape != (3,) or not np.all(np.isfinite(size) & (size > 0.0)):
                raise ValueError("its size is not three positive numbers")
            if not upright:
                return mesh(name, _hull(BOX_CORNERS * size) @ rotation.T + position)
            flat = BOX_CORNERS[[0, 4, 6, 2]] * size
            outline = (flat @ rotation.T + position)[:, :2]
            return prism(name, outline, (float(position[2] - size[2] / 2), float(position[2] + size[2] / 2)))
        raise ValueError("unknown shape")

    def _mesh(self, name: str, transform: Array, shape: ET.Element) -> list[Solid]:
        uri = _uri(shape)
        file = self._find(uri) if uri else None
        if file is None or not file.is_file():
            self.missing[uri or "a mesh without a uri"] = None
            return []
        scale = np.array(decimals((shape.findtext("scale") or "1 1 1").split()))
        return [mesh(name, (load_mesh(file) * scale) @ transform[:3, :3].T + transform[:3, 3])]


def _uri(element: ET.Element) -> str:
    return " ".join((element.findtext("uri") or "").split())


def _is_floor_or_light(uri: str) -> bool:
    fuel = FUEL.fullmatch(uri)
    if fuel is not None and (fuel["owner"].lower() != "openrobotics" or fuel["rest"].strip("/")):
        return False
    name = unquote(fuel["name"]) if fuel else uri.removeprefix("model://").rstrip("/")
    return name.lower().replace(" ", "_") in FLOOR_AND_LIGHT


def _number(shape: ET.Element, key: str) -> float:
    value = decimal(shape.findtext(key) or "nan")
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"its {key} is not a positive number")
    return value


def _hull(corners: Array) -> Array:
    """Triangles (n, 3, 3) of the convex solid with these corners (k, 3); ValueError when it is flat."""
    try:
        return corners[scipy.spatial.ConvexHull(corners).simplices]
    except scipy.spatial.QhullError:
        raise ValueError("its size is next to nothing in one direction") from None
