"""Other systems on the command line: NAME=FILE, and how to read their files."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.number_text import decimal
from turtlebag.pipeline.cli.arguments import pose
from turtlebag.pipeline.cli.parser import Parser

if TYPE_CHECKING:
    from turtlebag.datasets.other_systems import SystemFiles


SYSTEM_OPTIONS = ("system_base", "system_times", "system_shift")


def add_system_options(parser: Parser) -> None:
    """--system-base, --system-times and --system-shift."""
    for name, value, text in (
        ("base", "X,Y,YAW", "pose on the robot of the sensor that the other system's trajectory follows"),
        ("times", "FILE", "times of the KITTI poses in seconds, one per line (default: those of the scans)"),
        ("shift", "SECONDS", "seconds to add to the stamps"),
    ):
        parser.repeated(f"--system-{name}", f"[NAME=]{value}", text)


def systems_named(words: Sequence[str], args: argparse.Namespace) -> list[SystemFiles]:
    """The systems that `words` (NAME=FILE or FILE) and the options name; a name may have a trajectory and a
    map.

    InputError for a file that is neither, for two of one kind, and for an option with an unknown name.
    """
    from turtlebag.datasets.other_systems import SystemFiles, kind_of

    found: dict[str, dict[str, Path]] = {}
    for word in words:
        name, path = _named(word)
        kind = kind_of(path)
        files = found.setdefault(name, {})
        if kind in files:
            raise InputError(f"{path}: {name} already has a {kind} ({files[kind]}); give each its own NAME=")
        files[kind] = path
    bases = _by_name(args.system_base, found, "--system-base")
    times = _by_name(args.system_times, found, "--system-times")
    shifts = _by_name(args.system_shift, found, "--system-shift")
    return [
        SystemFiles(
            name,
            files.get("trajectory"),
            files.get("map"),
            Path(times[name]) if name in times else None,
            tuple(pose(bases[name], "--system-base").xyt.tolist()) if name in bases else (0.0, 0.0, 0.0),
            _seconds(shifts[name]) if name in shifts else 0.0,
        )
        for name, files in found.items()
    ]


def existing_files(words: Sequence[str], args: argparse.Namespace) -> list[Path]:
    """Every existing file that they name."""
    paths = [_named(word)[1] for word in words]
    paths += [Path(word.partition("=")[2] or word) for word in args.system_times]
    return [path for path in paths if path.exists()]


def _named(word: str) -> tuple[str, Path]:
    """NAME=FILE, or FILE with the name of the file."""
    name, equals, file = word.partition("=")
    if not equals or Path(word).exists():
        path = Path(word)
        return re.sub(r"^[^A-Za-z0-9]+|[^A-Za-z0-9_+-]+", "-", path.stem).strip("-") or "other", path
    if not file:
        raise InputError(f"{word}: names no file; write NAME=FILE")
    return name, Path(file)


def _by_name(words: Sequence[str], names: dict[str, dict[str, Path]], option: str) -> dict[str, str]:
    """Values of an option by system; without a name, of the only one."""
    found = {}
    for word in words:
        name, equals, value = word.partition("=")
        if not equals and len(names) == 1:
            name, value = next(iter(names)), word
        elif not names:
            raise InputError(f"{option} {word}: there is no other system")
        elif not equals:
            raise InputError(f"{option} {word}: there are several systems; write {option} NAME={word}")
        if name not in names:
            raise InputError(f"{option} {word}: no system named {name}; known: {', '.join(names)}")
        found[name] = value
    return found


def _seconds(text: str) -> float:
    try:
        value = decimal(text)
    except ValueError:
        value = math.nan
    if not abs(value) < 4e9:
        raise InputError(f"--system-shift {text}: expected a number of seconds")
    return value
