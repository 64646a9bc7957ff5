"""`turtlebag plan`."""

from __future__ import annotations

import argparse
from typing import get_args

from turtlebag.pipeline.cli.arguments import (
    OrOwn,
    add_config,
    add_map,
    add_output,
    add_seed,
    flag,
    option,
    output,
    pose,
)
from turtlebag.planners.planner_names import PlannerName

EXAMPLE = (
    "turtlebag plan --map data/maps/map_world.yaml --robot burger --start=-2,-0.5,0 --goal 1.5,1.5,0 "
    "--out data/plans/first"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    add_map(parser, "plan")
    option(parser, "--robot", "R", "robot: a name or a YAML file (default: burger)", default="burger")
    option(parser, "--start", "X,Y,YAW", "start pose, in metres and radians", required=True)
    option(parser, "--goal", "X,Y,YAW", "goal pose", required=True)
    names = get_args(PlannerName)
    text = f"OMPL planner: {', '.join(names)} (default: BITstar for a disc, else RRTConnect)"
    option(parser, "--planner", "P", f"{text}, or your own class (module:Class)", choices=OrOwn(names))
    flag(parser, "--compare", "run every planner and compare the paths")
    add_seed(parser, 0)
    add_config(parser)
    add_output(parser)


def run(args: argparse.Namespace) -> int:
    """Run the command; returns its exit code."""
    from turtlebag.pipeline.stages.plan import PlanStageConfig, Query, plan, planner_settings
    from turtlebag.pipeline.stages.settings import load_config
    from turtlebag.sim.robots import load_robot

    settings = [*args.settings, *planner_settings(args.planner)]
    robot = load_robot(args.robot)
    query = Query(robot, pose(args.start, "--start"), pose(args.goal, "--goal"), args.seed)
    config = load_config(PlanStageConfig, args.config, settings)
    return plan(args.map, query, output(args), config=config, compare=args.compare)
