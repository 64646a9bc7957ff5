"""Arguments that several commands share, and the parsing of their values."""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.terminal.messages import note_degrees

if TYPE_CHECKING:
    from turtlebag.datasets.outputs import Output


class OrOwn(tuple[str, ...]):
    """Choices of an option that also accepts a user's class, module:Class."""

    def __contains__(self, name: object) -> bool:
        """Whether it is one of the choices, or could be such a class."""
        from turtlebag.datasets.parts import is_own  # NumPy, which --help does without

        return super().__contains__(name) or (isinstance(name, str) and is_own(name))


def add_action(actions: Any, name: str, text: str, example: str) -> argparse.ArgumentParser:
    """A verb, or an action of one; its help ends with an example of one line, for copying."""
    parser: argparse.ArgumentParser = actions.add_parser(
        name,
        help=text,
        description=f"{text[0].upper()}{text[1:]}.",
        epilog=f"example:\n  {example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    return parser


REPEATED: dict[str, Any] = {"action": "append", "default": []}
"""For an option that may be repeated: its values make a list."""


def option(
    parser: argparse.ArgumentParser,
    name: str,
    metavar: str,
    text: str,
    kind: Callable[[str], Any] = str,
    **more: Any,
) -> None:
    """An option with a value, or an argument if the name has no dashes."""
    parser.add_argument(name, metavar=metavar, help=text, type=kind, **more)


def flag(parser: argparse.ArgumentParser, name: str, text: str) -> None:
    """An option without a value."""
    parser.add_argument(name, action="store_true", help=text)


def add_output(
    parser: argparse.ArgumentParser,
    text: str = "folder to write the results to",
    *,
    what: str = "DIR",
    required: bool = True,
) -> None:
    """--out and --force."""
    option(parser, "--out", what, text, Path, required=required)
    flag(parser, "--force", "replace --out if it exists")


def output(args: argparse.Namespace) -> Output:
    """The values of --out and --force; InputError if it exists and may not be replaced."""
    from turtlebag.datasets.outputs import Output  # which `bag info` does without

    return Output(args.out, args.force, args.command_line)


def add_config(parser: argparse.ArgumentParser) -> None:
    """--config and --set."""
    option(parser, "--config", "FILE", "YAML file with settings", Path)
    text = "override one setting; may be repeated"
    option(parser, "--set", "KEY=VALUE", text, dest="settings", **REPEATED)


def add_world(parser: argparse.ArgumentParser, seed_value: int) -> None:
    """What is simulated: --world, --robot, --seed and --start."""
    text = "world: a name, a YAML or SDF file, or your own class (module:Class)"
    option(parser, "--world", "W", text, required=True)
    option(parser, "--robot", "R", "robot: a name or a YAML file (default: the world's own)")
    add_seed(parser, seed_value)
    option(parser, "--start", "X,Y,YAW", "true start pose (default: the world's spawn)")


def start_of(args: argparse.Namespace) -> SE2 | None:
    """The pose of --start, if given."""
    return None if args.start is None else pose(args.start, "--start")


def add_seed(parser: argparse.ArgumentParser, value: int) -> None:
    """--seed."""
    option(parser, "--seed", "N", f"random seed (default: {value})", seed, default=value)


def add_map(parser: argparse.ArgumentParser, purpose: str, *, required: bool = True) -> None:
    """--map."""
    text = f"map to {purpose} on: its YAML file, or a folder that map wrote"
    option(parser, "--map", "MAP", text, map_file, required=required)


def named_inputs(args: argparse.Namespace) -> list[Path]:
    """Every existing file and folder that the arguments name: what the command may read."""
    given = {
        key: value
        for key, value in vars(args).items()
        if key not in ("out", "verb", "action", "command_line")
    }
    found = []
    for value in given.values():
        for one in value if isinstance(value, list) else [value]:
            # A word may be the name of something built in; only a file of that name is meant as a file.
            if isinstance(one, Path) or (isinstance(one, str) and not os.path.isdir(one)):
                found.append(Path(one))
    if isinstance(given.get("map"), Path):
        from turtlebag.datasets.maps import map_files  # heavy, and needed anyway where there is a map

        with suppress(InputError):
            found += map_files(given["map"]).values()
    return [path for path in found if os.path.exists(path)]


def map_file(text: str) -> Path:
    """A map's YAML file; for a folder that `map` wrote, the one in it."""
    path = Path(text)
    return path / "map.yaml" if path.is_dir() else path


def seed(text: str) -> int:
    """A seed: a non-negative integer."""
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"a seed must be 0 or more, not {value}")
    return value


def pose(text: str, option: str) -> SE2:
    """`X,Y,YAW`, finite and of plausible size; InputError names the option."""
    parts = text.split(",")
    try:
        values = [float(part) for part in parts]
    except ValueError:
        raise InputError(f"{option} {text}: expected X,Y,YAW (metres and radians)") from None
    if len(values) != 3:
        raise InputError(f"{option} {text}: expected three numbers X,Y,YAW, got {len(values)}")
    for name, value in zip(("x", "y", "yaw"), values, strict=True):
        if not math.isfinite(value):
            raise InputError(f"{option} {text}: {name} is not a finite number")
        if abs(value) > 1e9:
            raise InputError(f"{option} {text}: {name} is larger than any map")
    note_degrees(f"{option} {text}", values[2])
    return SE2.from_xyt(*values)


def initial_pose(text: str | None, *words: str) -> Any:
    """The pose of --initial-pose, or one of the words allowed instead; None if it was not given."""
    if text is None or text in words:
        return text
    try:
        return pose(text, "--initial-pose")
    except InputError as error:
        raise InputError(f"{error}; or {' or '.join(words)}") from None


def add_laser(parser: argparse.ArgumentParser, source: str) -> None:
    """--laser, which overrides the laser's pose in the argument `source`."""
    text = f"pose of the laser on the robot, YAW being the direction of beam angle 0; overrides {source}"
    option(parser, "--laser", "X,Y,YAW[,upside-down]", text)


def laser(text: str | None) -> tuple[SE2 | None, bool]:
    """The laser's pose by --laser, and whether it is upside down; InputError if it is not a pose."""
    if text is None:
        return None, False
    upright = text.removesuffix(",upside-down")
    return pose(upright, "--laser"), upright != text
