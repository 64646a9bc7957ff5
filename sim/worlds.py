"""Worlds: YAML files of upright solids with a spawn pose, and the true map of each."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from datasets.errors import InputError
from datasets.grid import OccupancyGrid
from datasets.se2 import SE2, Array
from datasets.yaml_files import checked, find_named, known_names, read_mapping
from sim.generators import GENERATORS, LIMITS
from sim.meshes import load_mesh
from sim.movers import Mover
from sim.rasterize import true_map
from sim.raycast import distance_to_point
from sim.sdf import load_sdf
from sim.shapes import Sections, Solid, box, contains, cylinder, mesh, prism, sections

FOLDER = Path(__file__).parent / "worlds"
MARGIN_M = 0.5
"""Free border around the outermost solid in a true map."""

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Point = tuple[Finite, Finite]


class _Spec(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _AnyShapeSpec(_Spec):
    name: str = ""
    reflectivity: Annotated[float, Field(ge=0.0, le=1.0)] = 1.0
    when: dict[str, str] = {}
    """Options of the world under which it is there, e.g. `{gate: shut}`; none: always."""


class _ShapeSpec(_AnyShapeSpec):
    z: tuple[Finite, Finite]


class BoxSpec(_ShapeSpec):
    """A box: centre, size along its own axes, yaw."""

    kind: Literal["box"]
    center: Point
    size: tuple[Positive, Positive]
    yaw: Finite = 0.0

    def solid(self, folder: Path) -> Solid:
        """The solid it describes."""
        return box(self.name, self.center, self.size, self.yaw, self.z, self.reflectivity)


class CylinderSpec(_ShapeSpec):
    """An upright cylinder."""

    kind: Literal["cylinder"]
    center: Point
    radius: Positive

    def solid(self, folder: Path) -> Solid:
        """The solid it describes."""
        return cylinder(self.name, self.center, self.radius, self.z, self.reflectivity)


class PrismSpec(_ShapeSpec):
    """An upright prism over a convex outline."""

    kind: Literal["prism"]
    polygon: list[Point] = Field(min_length=3)

    def solid(self, folder: Path) -> Solid:
        """The solid it describes."""
        return prism(self.name, np.array(self.polygon), self.z, self.reflectivity)


class MeshSpec(_AnyShapeSpec):
    """A closed mesh from an STL, OBJ or COLLADA file; `file` is relative to the world file."""

    kind: Literal["mesh"]
    file: str
    position: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    yaw: Finite = 0.0
    scale: tuple[Positive, Positive, Positive] = (1.0, 1.0, 1.0)

    def solid(self, folder: Path) -> Solid:
        """The solid it describes."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        triangles = load_mesh(folder / self.file) * np.array(self.scale) @ turn.T + np.array(self.position)
        return mesh(self.name, triangles, self.reflectivity)


ShapeSpec = Annotated[BoxSpec | CylinderSpec | PrismSpec | MeshSpec, Field(discriminator="kind")]


class MoverSpec(_Spec):
    """A box or a cylinder that moves: its section, and a path or an area to wander in."""

    name: str = ""
    z: tuple[Finite, Finite] = (0.0, 1.0)
    size: tuple[Positive, Positive] | None = None
    radius: Positive | None = None
    path: list[Point] = Field(min_length=1)
    speed: Positive
    loop: bool = False
    wander: tuple[Finite, Finite, Finite, Finite] | None = None
    yields: bool = False

    def mover(self) -> Mover:
        """The mover it describes; ValueError when its section is not given once."""
        if (self.size is None) == (self.radius is None):
            raise ValueError(f"mover {self.name}: give either size or radius")
        origin = (0.0, 0.0)
        if self.radius is not None:
            solid = cylinder(self.name, origin, self.radius, self.z)
        else:
            solid = box(self.name, origin, self.size or (1.0, 1.0), 0.0, self.z)
        path = np.array(self.path, dtype=np.float64)
        everywhere = (-np.inf, np.inf, -np.inf, np.inf)
        area = self.wander or everywhere
        return Mover(solid, path, self.speed, self.loop, self.wander is not None, area, self.yields)


class WorldSpec(_Spec):
    """A world file."""

    name: str
    robot: str = "burger"
    spawn: tuple[Finite, Finite, Finite]
    options: dict[str, list[str]] = {}
    """Choices, the default first, made as in `name:key=value`."""
    bounds: tuple[Finite, Finite, Finite, Finite] | None = None
    shapes: list[ShapeSpec]
    movers: list[MoverSpec] = []
    keepout: list[list[Point]] = []
    routes: dict[str, list[Point]] = {}


class GeneratorSpec(_Spec):
    """A world file that asks for a generated world."""

    generator: str
    seed: Annotated[int, Field(ge=0)]
    options: dict[str, float] = {}


@dataclass(frozen=True, eq=False)
class World:
    """Solids on an endless floor at z = 0, and where a robot starts.

    `keepout` are outlines (n, 2) that planners may be told to avoid because a planar lidar cannot
    see what stands there; `routes` are named way points (n, 2) for scripted driving.
    """

    name: str
    robot: str
    spawn: SE2
    shapes: tuple[Solid, ...]
    bounds: tuple[float, float, float, float]
    keepout: tuple[Array, ...]
    routes: dict[str, Array]
    movers: tuple[Mover, ...] = ()

    def crossing(self, z: float) -> list[Solid]:
        """Solids that a horizontal plane at z cuts: what a lidar at that height can see."""
        return [solid for solid in self.shapes if solid.crosses(z)]

    def below(self, z: float) -> list[Solid]:
        """Solids that reach into the space over the floor and below z: what a robot that high can touch."""
        return [solid for solid in self.shapes if solid.z_min < z and solid.z_max > 0.0]

    def touchable(self, height: float) -> Sections:
        """Outlines of everything that a robot of that height can touch."""
        return sections(self.below(height), 0.0, height)

    def rasterize(self, z: float, resolution: float = 0.05) -> OccupancyGrid:
        """The true map at height z, as a perfect lidar there would draw it (see sim.rasterize)."""
        return true_map(self.crossing(z), z, self.bounds, self.spawn.xy, resolution)


def load_world(name_or_path: str) -> World:
    """A built-in world by name or a YAML file by path; InputError for unknown names lists the known.

    Options of a world follow its name: `turtlebot3_house:gate=open`. Generated worlds are named by
    generator and seed: `maze:7`, `office:3`, `forest:5,density=0.5`. A .world or .sdf file is imported.
    """
    name, _, settings = name_or_path.partition(":")
    if name.endswith((".world", ".sdf")):
        return _from_sdf(Path(name), settings)
    if name in GENERATORS:
        return _generated(name_or_path, name, settings)
    if name not in world_names() and not name.endswith((".yaml", ".yml")) and "/" not in name:
        raise InputError(
            f"unknown world '{name_or_path}': known are {', '.join(world_names())}, "
            f"{', '.join(f'{generator}:SEED' for generator in GENERATORS)}, or a .yaml, .world or .sdf file"
        )
    path = find_named(name, FOLDER, "world")
    data = read_mapping(path)
    if "generator" in data:
        given = checked(GeneratorSpec, data, where=str(path))
        settings = ",".join([str(given.seed), *(f"{key}={value}" for key, value in given.options.items())])
        return _generated(str(path), given.generator, settings)
    spec = checked(WorldSpec, data, where=str(path))
    options = _chosen(spec, settings)
    shapes = [shape for shape in spec.shapes if all(options.get(k) == v for k, v in shape.when.items())]
    try:
        solids = tuple(shape.solid(path.parent) for shape in shapes)
        movers = tuple(mover.mover() for mover in spec.movers)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    return World(
        name=spec.name,
        robot=spec.robot,
        spawn=SE2.from_xyt(*spec.spawn),
        shapes=solids,
        bounds=spec.bounds or bounds_of(solids, MARGIN_M),
        keepout=tuple(np.array(outline, dtype=np.float64) for outline in spec.keepout),
        routes={name: np.array(points, dtype=np.float64) for name, points in spec.routes.items()},
        movers=movers,
    )


def _generated(where: str, name: str, settings: str) -> World:
    """World of a generator: settings are `SEED` and then `key=number` for its own parameters."""
    if name not in GENERATORS:
        raise InputError(f"{where}: unknown generator '{name}': known are {', '.join(GENERATORS)}")
    generator = GENERATORS[name]
    known = [key for key in inspect.signature(generator).parameters if key != "seed"]
    seed, *pairs = settings.split(",")
    options: dict[str, float] = {}
    for pair in pairs:
        key, _, value = pair.partition("=")
        if key not in known:
            raise InputError(f"{where}: {name} has no option '{key}' (it has: {', '.join(known)})")
        try:
            options[key] = int(float(value)) if key == "cells" else float(value)
        except ValueError:
            raise InputError(f"{where}: {key}={value}: not a number") from None
        low, high = LIMITS[key]
        if not low <= options[key] <= high:
            raise InputError(f"{where}: {key}={value}: must be {low:g} to {high:g}")
    if not seed.isdecimal():
        raise InputError(f"{where}: a generated world needs a seed, as in {name}:7")
    solids, spawn = generator(int(seed), **options)
    bounds = bounds_of(tuple(solids), MARGIN_M)
    label = f"{name}:{settings}"
    return World(label, "burger", SE2.from_xyt(*spawn), tuple(solids), bounds, (), {})


def _from_sdf(path: Path, settings: str) -> World:
    """A Gazebo world; `path:spawn=x/y/yaw` says where to start (default: the roomiest place near 0, 0)."""
    if not path.is_file():
        raise InputError(f"{path}: no such world file")
    key, _, value = settings.partition("=")
    if key not in ("", "spawn"):
        raise InputError(f"{path}: an SDF world has no option '{key}' (it has: spawn)")
    name, solids = load_sdf(path)
    if not solids:
        raise InputError(f"{path}: holds no static boxes, cylinders, spheres or meshes")
    bounds = bounds_of(tuple(solids), 2.0)
    try:
        spawn = SE2.from_xyt(*(float(part) for part in value.split("/"))) if value else None
    except (TypeError, ValueError):
        raise InputError(f"{path}: spawn={value}: expected x/y/yaw") from None
    spawn = spawn if spawn is not None else _roomy_place(solids, bounds)
    return World(path.stem if name == "default" else name, "burger", spawn, tuple(solids), bounds, (), {})


def _roomy_place(solids: list[Solid], bounds: tuple[float, float, float, float]) -> SE2:
    """The place nearest to the origin with half a metre of room, else the one with the most."""
    outlines = sections(solids, 0.0, 0.5)
    x, y = np.meshgrid(np.arange(bounds[0], bounds[1], 0.1), np.arange(bounds[2], bounds[3], 0.1))
    points = np.vstack([np.zeros(2), np.stack([x.ravel(), y.ravel()], axis=-1)])
    points = points[np.argsort(np.hypot(*points.T), kind="stable")]
    points = points[~contains(solids, 0.2, points)]
    rooms = np.array([distance_to_point(px, py, outlines.segments, outlines.circles) for px, py in points])
    best = int(np.argmax(rooms > 0.5)) if np.any(rooms > 0.5) else int(np.argmax(rooms))
    return SE2.from_xyt(points[best, 0], points[best, 1], 0.0)


def _chosen(spec: WorldSpec, settings: str) -> dict[str, str]:
    """The world's options with `key=value,...` applied."""
    options = {key: values[0] for key, values in spec.options.items()}
    for setting in filter(None, settings.split(",")):
        key, _, value = setting.partition("=")
        values = spec.options.get(key)
        if values is None:
            known = ", ".join(options) or "none"
            raise InputError(f"world {spec.name} has no option '{key}' (it has: {known})")
        if value not in values:
            raise InputError(f"world {spec.name}: {key}={value}: choose one of {', '.join(values)}")
        options[key] = value
    return options


def world_names() -> list[str]:
    """Names of the built-in worlds."""
    return known_names(FOLDER)


def bounds_of(solids: tuple[Solid, ...], margin: float) -> tuple[float, float, float, float]:
    """(x_min, x_max, y_min, y_max) around solids; 10 m about the origin when there are none."""
    if not solids:
        return -10.0, 10.0, -10.0, 10.0
    each = np.array([solid.bounds() for solid in solids])
    return (
        float(each[:, 0].min() - margin),
        float(each[:, 1].max() + margin),
        float(each[:, 2].min() - margin),
        float(each[:, 3].max() + margin),
    )
