"""The values of arguments that several commands share."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from turtlebag.datasets.errors import InputError

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
            raise InputError(f"--{name.replace('_', '-')}: {why}")


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
    return [path for path in found if os.path.exists(path)]
