"""A world: solids on a floor, a spawn pose, and moving obstacles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.sim.movers import Mover
from turtlebag.sim.plans import Plan
from turtlebag.sim.rasterize import true_map
from turtlebag.sim.shapes import Sections, Solid, sections


@dataclass(frozen=True, eq=False)
class World:
    """Solids on an endless floor at z = 0, and the robot's spawn pose.

    `keepout` are outlines (n, 2) of keep-out areas, for obstacles that a planar lidar cannot
    see; `routes` are named waypoints (n, 2) for scripted driving.
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
        """Solids that cross the horizontal plane at z: those visible to a lidar at that height."""
        return [solid for solid in self.shapes if solid.crosses(z)]

    def below(self, z: float) -> list[Solid]:
        """Solids between the floor and z: those that a robot of that height can touch."""
        return [solid for solid in self.shapes if solid.z_min < z and solid.z_max > 0.0]

    def touchable(self, height: float) -> Sections:
        """Outlines of everything that a robot of that height can touch."""
        return sections(self.below(height), 0.0, height)

    def circles(self, z: float) -> Array:
        """Round solids at height z, (m, 3) x, y, radius [m]."""
        return sections(self.crossing(z), z).circles

    def rasterize(self, z: float, resolution: float | None = None) -> OccupancyGrid:
        """The true map at height z, that of a perfect lidar there (see turtlebag.sim.rasterize).

        `resolution` [m]; None: that of the map that the world was made from, else 0.05.
        """
        crossing = self.crossing(z)
        plan = next((solid for solid in crossing if isinstance(solid, Plan)), None)
        if resolution is None:
            resolution = 0.05 if plan is None else plan.grid.resolution
        T_world_grid = None if plan is None else plan.grid.T_map_grid
        return true_map(crossing, z, self.bounds, self.spawn.xy, resolution, T_world_grid)


class WorldMaker(Protocol):
    """Makes a world for `--world module:Class` or, with `options`, `--world module:Class:options`."""

    def __init__(self, options: str) -> None:
        """`options` is the text after the class name, maybe empty; InputError for unknown options."""
        ...

    def world(self) -> World:
        """The world, the same for the same options, with at least one visible shape and room at `spawn`.

        `name` is its name in logs and reports; `bounds` (x_min, x_max, y_min, y_max) contain all shapes and
        are those of its true map.
        """
        ...
