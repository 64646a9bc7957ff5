"""The values of arguments that several commands share."""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.number_text import decimal, decimals, whole
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.terminal.messages import note_degrees

if TYPE_CHECKING:
    from turtlebag.datasets.outputs import Output


def output(args: argparse.Namespace) -> Output:
    """The values of --out and --force; InputError if it exists and may not be replaced."""
    from turtlebag.datasets.outputs import Output  # which `bag info` does without

    return Output(args.out, args.force, args.command_line)


def refuse(args: argparse.Namespace, names: Iterable[str], why: str) -> None:
    """InputError for the first of these options that is given."""
    for name in names:
        value = getattr(args, name)
        if value is not None and value is not False and value != []:
            raise InputError(f"--{'set' if name == 'settings' else name.replace('_', '-')}: {why}")


def start_of(args: argparse.Namespace) -> SE2 | None:
    """The pose of --start, if given."""
    return None if args.start is None else pose(args.start, "--start")


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
    return _whole(text, 0)


def positive(text: str) -> float:
    """A number of more than 0, and neither endless nor so small that what is divided by it is."""
    value = _number(text)
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"must be a positive number, not {text}")
    if not 0.001 <= value <= 1e6:
        raise argparse.ArgumentTypeError(f"must be 0.001 to 1000000, not {text}")
    return value


def seconds(text: str) -> float:
    """A finite number, 0 or more."""
    value = _number(text)
    if not 0.0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"must be a number of seconds, 0 or more, not {text}")
    return value


def _number(text: str) -> float:
    try:
        return decimal(text)
    except ValueError:
        return math.nan


def count(text: str) -> int:
    """A number of things, 1 or more."""
    return _whole(text, 1)


def _whole(text: str, least: int) -> int:
    try:
        value = whole(text)
    except ValueError:
        value = -1
    if value < least:
        raise argparse.ArgumentTypeError(f"must be a whole number, {least} or more, not {text}")
    return value


def pose(text: str, option: str) -> SE2:
    """`X,Y,YAW`, finite and of plausible size; InputError names the option."""
    parts = text.split(",")
    try:
        values = decimals(parts)
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


def laser(text: str | None) -> tuple[SE2 | None, bool]:
    """The laser's pose by --laser, and whether it is upside down; InputError if it is not a pose."""
    if text is None:
        return None, False
    upright = text.removesuffix(",upside-down")
    return pose(upright, "--laser"), upright != text
