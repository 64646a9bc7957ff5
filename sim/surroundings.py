"""The robot's surroundings, static and moving: contacts, lidar outlines, and where the robot can stand."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.seeds import stream
from turtlebag.sim.movers import MovingSolid, outlines
from turtlebag.sim.nearby import Nearby
from turtlebag.sim.raycast import distance_to_outlines, distance_to_point
from turtlebag.sim.robots import PERIOD_S, RobotSpec
from turtlebag.sim.shapes import Sections, Solid, contains, sections
from turtlebag.sim.world import World

OUTSIDE_M = 5.0
"""How far outside the world's bounds a robot may be put down."""
NEAR_M = 3.0
"""What lies farther from the robot is not asked for its distance while something is nearer."""
DROP_ROOM_M = 0.02
"""What is dropped must lie this far from the robot."""


class Surroundings:
    """The solids of a world, what was dropped since, and what moves, for one robot."""

    moving: Sections
    """The moving solids that the robot can touch, at their current places; replaced when one has moved."""

    def __init__(self, world: World, robot: RobotSpec, seed: int) -> None:
        self._world, self._robot = world, robot
        self._dropped: list[Solid] = []
        radius = robot.model.circumscribed_radius
        self._reach = max([NEAR_M, 4.0 * radius, *(2.0 * mover.radius + 1.0 for mover in world.movers)])
        self._standing = Nearby(world.touchable(robot.height), self._reach)
        self.movers = [
            MovingSolid(mover, self._standing, radius, stream(seed, f"mover {number}"))
            for number, mover in enumerate(world.movers)
        ]
        everything = [*world.shapes, *(mover.solid for mover in world.movers)]
        self._visible = [solid.crosses(robot.lidar_height) for solid in everything]
        self._note()

    @property
    def solids(self) -> list[Solid]:
        """The static solids."""
        return [*self._world.shapes, *self._dropped]

    @property
    def visible_movers(self) -> Sections:
        """Outlines where they stand now of the movers that the planar lidar sees."""
        height = self._robot.lidar_height
        return outlines(one for one in self.movers if one.mover.solid.crosses(height))

    def step(self, robot_xy: Array) -> None:
        """Movers move on for one control step."""
        if self.movers:
            for one in self.movers:
                one.step(PERIOD_S, robot_xy)
            self._note()

    def drop(self, solid: Solid, T_world_base: SE2) -> None:
        """One more solid on the floor; InputError when it would touch the robot."""
        segments, circles = solid.outline(0.0, self._robot.height)
        footprint = T_world_base @ self._robot.model.footprint
        inside = solid.inside(solid.z_min, T_world_base.xy[None])[0]
        if inside or distance_to_outlines(footprint, segments, circles) < DROP_ROOM_M:
            x, y = solid.center
            raise InputError(f"{solid.name} {x:g}, {y:g}: would touch the robot; drop it farther away")
        self._dropped.append(solid)
        self._visible.append(solid.crosses(self._robot.lidar_height))
        more = sections([solid], 0.0, self._robot.height)
        self._standing = Nearby(self._standing.everything + more, self._reach)
        for one in self.movers:
            one.standing = self._standing

    def contacts(self, touched: Iterable[int]) -> tuple[bool, bool]:
        """Whether any of the solids of these numbers crosses the lidar's plane, and whether any does not."""
        visible = [self._visible[number] for number in touched]
        return any(visible), not all(visible)

    def clearance(self, T_world_base: SE2) -> float:
        """Distance from the footprint polygon to the nearest surface up to the robot's height [m]."""
        footprint, moving = T_world_base @ self._robot.model.footprint, self.moving
        standing = self._standing.clearance(footprint)
        if not self.movers:
            return standing
        return min(standing, float(distance_to_outlines(footprint, moving.segments, moving.circles)))

    def within(self, reach_m: float, T_world_base: SE2) -> bool:
        """Whether anything that can be touched is so near the robot's centre."""
        x, y, _ = T_world_base.xyt.tolist()
        if self._standing.room(x, y) <= reach_m:
            return True
        moving = self.moving
        return bool(self.movers) and distance_to_point(x, y, moving.segments, moving.circles) <= reach_m

    def require_free(self, T_world_base: SE2, what: str) -> None:
        """InputError when the robot cannot stand there."""
        x, y = float(T_world_base.x), float(T_world_base.y)
        x_min, x_max, y_min, y_max = self._world.bounds
        beyond = max(x_min - x, x - x_max, y_min - y, y - y_max)
        if not beyond <= OUTSIDE_M:  # also when it is not a number
            raise InputError(f"{what} {x:g}, {y:g}: outside of world {self._world.name}")
        footprint, standing = T_world_base @ self._robot.model.footprint, self._standing
        solids = [*self._world.below(self._robot.height), *self._dropped]
        if (
            not np.isfinite(T_world_base.yaw)
            or standing.clearance(footprint) == 0.0
            or contains(solids, self._robot.lidar_height, T_world_base.xy[None])[0]
        ):
            raise InputError(
                f"{what} {x:g}, {y:g}: the robot would stand in an obstacle of {self._world.name}"
            )

    def _note(self) -> None:
        """Where the movers stand now."""
        height = self._robot.height
        self.moving = outlines(one for one in self.movers if one.mover.solid.z_min < height)
