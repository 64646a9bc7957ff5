"""World files: the YAML that describes a world, checked and turned into solids and movers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field

from turtlebag.datasets.settings import Finite, Positive, Settings
from turtlebag.sim.meshes import load_mesh
from turtlebag.sim.movers import Mover
from turtlebag.sim.plans import WALL_M, load_plan
from turtlebag.sim.shapes import Solid, box, cylinder, mesh, prism

MOST_SHAPES = 20_000


def _upwards(z: tuple[float, float]) -> tuple[float, float]:
    if not z[0] < z[1]:
        raise ValueError(f"the bottom {z[0]:g} is not below the top {z[1]:g}")
    return z


Heights = Annotated[tuple[Finite, Finite], AfterValidator(_upwards)]
Unknown = Literal["solid", "free"]
Point = tuple[Finite, Finite]
Points = Annotated[list[Point], Field(max_length=1000)]


class _AnyShapeSpec(Settings):
    name: str = ""
    reflectivity: Annotated[float, Field(ge=0.0, le=1.0)] = 1.0
    when: dict[str, str] = Field({})
    """Options of the world with which it exists, e.g. `{gate: shut}`; none: always."""


class _ShapeSpec(_AnyShapeSpec):
    z: Heights


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
    polygon: Points = Field(min_length=3)

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


class MapSpec(Settings):
    """The walls of a map: its yaml, relative to the world file, and whether its unknown cells are solid."""

    kind: Literal["map"]
    name: str = "map"
    file: str
    unknown: Unknown = "solid"
    z: Heights = (0.0, WALL_M)
    when: dict[str, str] = Field({})

    def solid(self, folder: Path) -> Solid:
        """The solid it describes."""
        return load_plan(folder / self.file, self.name, solid=self.unknown == "solid", z=self.z)


ShapeSpec = Annotated[BoxSpec | CylinderSpec | PrismSpec | MeshSpec | MapSpec, Field(discriminator="kind")]


class MoverSpec(Settings):
    """A box or a cylinder that moves: its section, and a path or an area to wander in."""

    name: str = ""
    z: Heights = (0.0, 1.0)
    size: tuple[Positive, Positive] | None = None
    radius: Positive | None = None
    path: Points = Field(min_length=1)
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


class WorldSpec(Settings):
    """A world file."""

    name: str
    robot: str = "burger"
    spawn: tuple[Finite, Finite, Finite]
    options: dict[str, list[str]] = Field({})
    """Choices, the default first, made as in `name:key=value`."""
    bounds: tuple[Finite, Finite, Finite, Finite] | None = None
    shapes: list[ShapeSpec] = Field(max_length=MOST_SHAPES)
    movers: list[MoverSpec] = Field([], max_length=100)
    keepout: list[Points] = Field([], max_length=1000)
    routes: dict[str, Points] = Field({}, max_length=1000)


class GeneratorSpec(Settings):
    """A world file that names a generator."""

    generator: str
    seed: Annotated[int, Field(ge=0)]
    options: dict[str, float] = Field({})
