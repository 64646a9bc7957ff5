"""`turtlebag completion`: a script for shell completion of verbs, options, names and files."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from turtlebag.pipeline.stages.parser import Parser

EXAMPLE = "turtlebag completion bash > turtlebag.bash && source turtlebag.bash"
SHELLS = ("bash", "zsh", "fish", "tcsh")


def add_arguments(parser: Parser) -> None:
    """Arguments of the command."""
    parser.add_argument("shell", choices=SHELLS, metavar="|".join(SHELLS), help="shell to complete in")


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    import shtab

    from turtlebag.datasets.registry import DATASETS
    from turtlebag.pipeline.cli.main import VERBS, build_parser

    parser = build_parser(*VERBS)
    named = _built_in()
    for action in _arguments(parser):
        if action.dest in named:
            action.complete = _name_or_file(action.dest, named[action.dest])  # type: ignore[attr-defined]
        elif action.dest == "names":
            action.choices = list(DATASETS)
        elif action.type is Path or str(action.metavar).endswith("FILE"):
            folder = action.metavar == "DIR"
            action.complete = shtab.DIRECTORY if folder else shtab.FILE  # type: ignore[attr-defined]
    print(shtab.complete(parser, args.shell))
    return 0


def _built_in() -> dict[str, Sequence[str]]:
    """The built-in names, by the argument that takes one of them or a file."""
    from turtlebag.datasets.yaml_files import known_names
    from turtlebag.pipeline.campaign.campaign_file import FOLDER as STUDIES
    from turtlebag.sim.robots import robot_names
    from turtlebag.sim.teleop_scripts import script_names
    from turtlebag.sim.worlds import world_names

    return {
        "world": world_names(),
        "robot": robot_names(),
        "teleop": script_names(),
        "campaign": known_names(STUDIES),
    }


def _arguments(parser: Parser) -> Iterator[argparse.Action]:
    """Every option and argument of the verbs and of their actions."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for sub in action.choices.values():
                yield from _arguments(sub.ready())
        else:
            yield action


def _name_or_file(dest: str, names: Sequence[str]) -> dict[str, Any]:
    """The completion of an argument that takes a name or a file; in tcsh, only of names."""
    words, function = " ".join(names), f"_turtlebag_{dest}_or_file"
    return {
        "bash": function,
        "zsh": function,
        "fish": f"{words} (__fish_complete_path (commandline -ct))",
        "tcsh": f"({words})",
        "preamble": {
            "bash": f'{function}() {{ compgen -W "{words}" -- "$1"; compgen -f -- "$1"; }}',
            "zsh": f"{function}() {{ compadd {words}; _files }}",
        },
    }
