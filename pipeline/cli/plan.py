"""`turtlebag plan`."""

from __future__ import annotations

import argparse
from typing import get_args

from turtlebag.pipeline.cli.arguments import output, pose
from turtlebag.pipeline.cli.parser import OrOwn, Parser
from turtlebag.planners.planner_names import PlannerName

EXAMPLE = (
    "turtlebag plan --map data/maps/map_world.yaml --robot burger --start=-2,-0.5,0 --goal 1.5,1.5,0 "
    "--out data/plans/first"
)


def add_arguments(parser: Parser) -> None:
    """The command's arguments."""
    parser.add_map("plan")
    parser.option("--robot", "R", "robot: a name or a YAML file (default: burger)", default="burger")
    parser.option("--start", "X,Y,YAW", "start pose, in metres and radians", required=True)
    parser.option("--goal", "X,Y,YAW", "goal pose", required=True)
    names = get_args(PlannerName)
    text = f"OMPL planner: {', '.join(names)} (default: BITstar for a disc, else RRTConnect)"
    parser.option("--planner", "P", f"{text}, or your own class (module:Class)", choices=OrOwn(names))
    parser.flag("--compare", "run every planner and compare the paths")
    parser.add_seed(0)
    parser.add_config()
    parser.add_output()


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
