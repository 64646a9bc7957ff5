"""`turtlebag navigate`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from turtlebag.pipeline.cli.arguments import count, initial_pose, output, pose, positive, refuse, start_of
from turtlebag.pipeline.cli.parser import OrOwn, Parser

if TYPE_CHECKING:
    from turtlebag.planners.costmap import Area

EXAMPLE = (
    "turtlebag navigate --world turtlebot3_world --map data/maps/map_world.yaml --task patrol "
    "--initial-pose start --seed 1 --out data/runs/patrol"
)


# Not imported from turtlebag.pipeline.navigation.driver_setup, because --help need not load a simulator.
TASKS = ("goal", "patrol", "avoid", "explore")
# Options of some tasks only; all others apply to every task.
TAKEN_BY = {
    "map": ("goal", "patrol"),
    "initial_pose": ("goal", "patrol"),
    "wiggle": ("goal", "patrol"),
    "keepout": ("goal", "patrol"),
    "timeout": ("goal", "patrol"),
    "goal": ("goal",),
    "waypoints": ("patrol",),
    "laps": ("patrol",),
    "duration": ("avoid", "explore"),
    "mode": ("avoid",),
}
ON_A_MAP = ("initial_pose", "wiggle", "keepout")
"""Those among them that a goal without --map cannot use."""


def add_arguments(parser: Parser) -> None:
    """The command's arguments."""
    parser.add_world(0)
    parser.add_argument(
        "--task", required=True, choices=OrOwn(TASKS), help="task to run, or your own class (module:Class)"
    )
    parser.add_map("navigate", required=False)
    text = "initial pose given to the robot: a pose, its true start, or global localisation"
    parser.option("--initial-pose", "X,Y,YAW|start|global", text)
    parser.option("--goal", "X,Y,YAW", "goal of --task goal, in metres and radians")
    text = "YAML file with the patrol's waypoints (default: the tutorial's)"
    parser.option("--waypoints", "FILE", text, Path)
    parser.option("--laps", "N", "laps of the patrol (default: 1)", count)
    text = "simulated seconds for each goal (default: 60 in a patrol, 600 for --task goal)"
    parser.option("--timeout", "S", text, positive)
    text = "simulated seconds: the length of avoid (default: 60), or the limit for explore (default: 1800)"
    parser.option("--duration", "S", text, positive)
    text = "for --task avoid: guarded (default) uses the robot's shape; tutorial is the tutorial's rule"
    parser.add_argument("--mode", choices=("guarded", "tutorial"), help=text)
    parser.flag("--wiggle", "first turn back and forth until the particles converge")
    text = "override cmd_vel by keyboard, or by a YAML list of intervals with begin, end, v and w"
    parser.option("--teleop-override", "keyboard|FILE", text)
    text = "YAML file with keep-out polygons, or a map yaml as a mask (default: the world's own)"
    parser.option("--keepout", "FILE|none", text)
    parser.add_config()
    parser.add_output()


def run(args: argparse.Namespace) -> int:
    """Run the command; returns its exit code."""
    from turtlebag.pipeline.navigation.config import NavigateConfig
    from turtlebag.pipeline.navigation.driver_setup import Request
    from turtlebag.pipeline.stages.navigate import navigate
    from turtlebag.pipeline.stages.settings import load_config
    from turtlebag.pipeline.terminal.messages import say
    from turtlebag.sim.robots import load_robot
    from turtlebag.sim.worlds import load_world, own_files

    _refuse_unused(args)
    settings = [*args.settings, *([f"avoid.mode={args.mode}"] if args.mode else [])]
    override = args.teleop_override
    request = Request(
        task=args.task,
        seed=args.seed,
        map_path=args.map,
        start=start_of(args),
        initial_pose=initial_pose(args.initial_pose, "start", "global"),
        goal=None if args.goal is None else pose(args.goal, "--goal"),
        waypoints_path=args.waypoints,
        laps=args.laps,
        timeout_s=args.timeout,
        duration_s=args.duration,
        wiggle=args.wiggle,
        teleop_override=override if override in (None, "keyboard") else Path(override),
        keepout=_keepout(args.keepout),
        keepout_path=None if args.keepout in (None, "none") else Path(args.keepout),
    )
    world = load_world(args.world)
    return navigate(
        world,
        load_robot(args.robot or world.robot),
        request,
        output(args),
        config=load_config(NavigateConfig, args.config, settings),
        say=(lambda line: None) if args.verbosity < 0 else say,
        files=own_files(args.world, args.robot) | ({} if args.config is None else {"config": args.config}),
    )


def _refuse_unused(args: argparse.Namespace) -> None:
    """InputError for the first given option that the task does not use; a user's own task may use any."""
    if args.task not in TASKS:
        return
    for name, tasks in TAKEN_BY.items():
        if args.task not in tasks:
            refuse(args, [name], f"not for --task {args.task}, only for {' and '.join(tasks)}; remove it")
        if args.task == "goal" and args.map is None and name in ON_A_MAP:
            refuse(args, [name], "needs a map; give --map or remove it")


def _keepout(text: str | None) -> tuple[Area, ...] | None:
    """The areas of a file, or none; None: the world's own."""
    if text is None:
        return None
    if text == "none":
        return ()
    from turtlebag.planners.tasks.waypoints import load_keepout

    return load_keepout(Path(text))
