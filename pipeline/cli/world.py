"""turtlebag world."""

from __future__ import annotations

import argparse

from turtlebag.datasets.errors import InputError
from turtlebag.pipeline.stages.parser import Parser, add_action

EXAMPLE = "turtlebag world show turtlebot3_world --out world.png"


def add_arguments(parser: Parser) -> None:
    """Arguments of the command."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    text = "list the built-in worlds, robots and teleop scripts"
    add_action(actions, "list", text, "turtlebag world list").set_defaults(run=_list)
    show = add_action(actions, "show", "draw a world as a PNG", EXAMPLE)
    show.option("world", "W", "world: a name, a YAML or SDF file, or a map")
    show.option("--robot", "R", "robot whose lidar height is drawn (default: the world's own)")
    show.add_output("picture to write", what="PNG")
    show.set_defaults(run=_show)


def _list(args: argparse.Namespace) -> int:
    from turtlebag.sim.generators import GENERATORS
    from turtlebag.sim.robots import robot_names
    from turtlebag.sim.teleop_scripts import script_names
    from turtlebag.sim.worlds import load_world, world_names

    for name in world_names():
        world = load_world(name)
        x, y, yaw = world.spawn.xyt.tolist()
        print(f"{name}: {len(world.shapes)} solids, spawn {x:g},{y:g},{yaw:g}, robot {world.robot}")
    print(f"generated: {', '.join(f'{name}:SEED' for name in GENERATORS)}")
    print(f"robots: {', '.join(robot_names())}")
    print(f"teleops: {', '.join(script_names())}")
    return 0


def _show(args: argparse.Namespace) -> int:
    from turtlebag.datasets.outputs import staged_file
    from turtlebag.reports.figures.maps import WorldSketch, draw_world
    from turtlebag.sim.robots import load_robot
    from turtlebag.sim.shapes import sections
    from turtlebag.sim.worlds import load_world

    if args.out.suffix.lower() != ".png":
        raise InputError(f"--out {args.out}: the picture is a PNG; use a name that ends in .png")
    world = load_world(args.world)
    robot = load_robot(args.robot or world.robot)
    z = robot.lidar_height
    low = [solid for solid in world.below(robot.height) if not solid.crosses(z)]
    moving = []
    for mover in world.movers:
        section = sections([mover.solid], z).moved(mover.path[0])
        moving.append(((section.segments, section.circles), mover.path))
    sketch = WorldSketch(
        [solid.outline(z, z) for solid in world.crossing(z)],
        [solid.outline(solid.z_min, solid.z_max) for solid in low],
        moving,
        world.keepout,
    )
    title = f"{world.name} at {z:g} m (lidar of {robot.name})"
    with staged_file(args.out, force=args.force) as file:
        draw_world(file, title, world.rasterize(z), world.spawn, sketch)
    print(args.out)
    return 0
