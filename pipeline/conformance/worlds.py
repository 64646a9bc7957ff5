"""The check of a world."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from turtlebag.pipeline.conformance.answers import broken, require_answer, require_value
from turtlebag.pipeline.conformance.trial_room import HEIGHT_M, bytes_of, made, told
from turtlebag.sim.raycast import distance_to_point
from turtlebag.sim.robots import load_robot
from turtlebag.sim.shapes import Solid, contains, sections
from turtlebag.sim.world import World, WorldMaker


def check_world(maker: Callable[[str], WorldMaker], options: str = "") -> None:
    """The world of some options, made twice: the same, finite, with room to start.

    AssertionError in one line says what the contract, `turtlebag.sim.world.WorldMaker`, asks.
    """
    worlds = []
    for _ in range(2):
        one: WorldMaker = made(maker, WorldMaker, options)
        world = one.world()
        _require_world(one, world)
        with told():
            radius = load_robot(world.robot).model.circumscribed_radius
        worlds.append(world)
    first, again = (_drawn(world) for world in worlds)
    if first != again or worlds[0].name != worlds[1].name:
        raise broken(maker, "world: the same options must give the same world")
    outlines = sections(world.shapes, 0.0, 0.5)
    x, y = world.spawn.xy.tolist()
    near = distance_to_point(x, y, outlines.segments, outlines.circles) < radius
    if near or contains(world.shapes, HEIGHT_M, world.spawn.xy[None]).any():
        raise broken(maker, "world: there must be room for the robot where it starts (spawn)")
    low, high = world.bounds[::2], world.bounds[1::2]
    for solid in world.shapes:
        x0, x1, y0, y1 = solid.bounds()
        if x0 < low[0] or y0 < low[1] or x1 > high[0] or y1 > high[1]:
            raise broken(maker, f"world: bounds must hold all shapes, and {solid.name} reaches beyond")


def _require_world(maker: WorldMaker, world: World) -> None:
    require_answer(maker, "world", world, World, name=str, robot=str)
    require_value(maker, "world: spawn", world.spawn.xyt, (3,))
    require_value(maker, "world: bounds", np.array(world.bounds, dtype=np.float64), (4,))
    if not world.shapes:
        raise broken(maker, "world: needs at least one shape")
    for solid in world.shapes:
        require_value(maker, "world: shape", solid, Solid)
    for outline in (*world.keepout, *world.routes.values()):
        require_value(maker, "world: keepout or route", outline, (len(outline), 2))


def _drawn(world: World) -> bytes:
    return bytes_of(world.rasterize(HEIGHT_M).cells, world.spawn.xyt, *world.keepout, *world.routes.values())
