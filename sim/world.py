"""A world: solids on a floor, a spawn pose, and moving obstacles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.sim.movers import Mover
from turtlebag.sim.rasterize import true_map
from turtlebag.sim.shapes import Sections, Solid, sections


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
        """The true map at height z, as a perfect lidar there would draw it (see turtlebag.sim.rasterize)."""
        return true_map(self.crossing(z), z, self.bounds, self.spawn.xy, resolution)


class WorldMaker(Protocol):
    """Makes a world for `--world module:Class` or, with `options`, `--world module:Class:options`."""

    def __init__(self, options: str) -> None:
        """With what follows its name, empty where nothing does; InputError for options that it has not."""
        ...

    def world(self) -> World:
        """The world, the same for the same options: at least one thing to see, and room to start at `spawn`.

        `name` is what logs and reports call it; `bounds` (x_min, x_max, y_min, y_max) hold all shapes: those
        of its true map.
        """
        ...
