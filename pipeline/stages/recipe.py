"""How to make a report's numbers again: the commands with named outputs, the hashes, the packages."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, get_args

from turtlebag.pipeline.stages.command_line import flag, option_of
from turtlebag.pipeline.stages.requests.table import REQUESTS
from turtlebag.reports.numbers import DASH
from turtlebag.reports.stages import Group, Input, Stage


@dataclass(frozen=True)
class Step:
    """One command of the recipe, and what vouches for its result."""

    label: str
    command: str
    seed: str
    config_hash: str
    inputs: list[tuple[str, str]]
    outputs: list[tuple[str, str]]


def recipe(groups: Sequence[Group]) -> list[Step]:
    """Every stage's command with output folders renamed to `world/stage`, so that it runs anywhere."""
    stages = [(f"{group.name}/{stage.label}", stage) for group in groups for stage in group.stages]
    names: dict[str, str] = {}
    for _, reader in stages:
        for entry in reader.manifest.inputs.values():
            names |= {str(made): label for label, stage in stages if (made := folder_of(entry, stage))}
    names |= {out.rstrip("/"): label for label, stage in stages if (out := stage.option("out"))}
    return [_step(label, stage, names) for label, stage in stages]


def folder_of(entry: Input, stage: Stage) -> Path | None:
    """Where the stage's folder lay, as its reader wrote it, if what was read is of that stage by its hashes:
    so a recipe does not depend on from where, or how, the stages are named."""
    read = entry.path.parent if entry.path.name in entry.sha256 else entry.path  # of a file its folder
    for folder in (read, *read.parents):
        inside = read.relative_to(folder)
        held = {(inside / name).as_posix(): digest for name, digest in entry.sha256.items()}
        if held and held.items() <= stage.manifest.outputs.items():
            return folder
    return None


def _step(label: str, stage: Stage, names: dict[str, str]) -> Step:
    inputs = [
        (f"{name}: {path}" if path != name else name, digest)
        for name, entry in stage.manifest.inputs.items()
        for path, digest in entry.sha256.items()
    ]
    return Step(
        label,
        shlex.join(renamed(stage.command, names)),
        DASH if stage.manifest.seed is None else str(stage.manifest.seed),
        stage.manifest.outputs.get("config.yaml", ""),
        inputs,
        sorted(stage.manifest.outputs.items()),
    )


def command_of(stage: Stage, name: str) -> str:
    """The command that made a stage, its output called `name`, of absolute paths the last part only."""
    out = stage.option("out")
    words = renamed(stage.command, {} if out is None else {out.rstrip("/"): name})
    return shlex.join(re.sub(r"^(--[\w-]+=)?/.*/(?=[^/])", r"\1", word) for word in words)


def renamed(command: Sequence[str], names: Mapping[str, str]) -> list[str]:
    """A command line without `--force`, the known output folders renamed where a path stands, and nowhere
    else: a folder may well be called as a verb, a task or a number is."""
    words, others, before = list(command[:2]), _no_paths(" ".join(command[1:2])), ""
    for word in command[2:]:
        option, equals, value = word.partition("=")
        if option.startswith("-") and equals:
            word = word if option in others else f"{option}={rename(value, names)}"
        elif before not in others:
            word = rename(word, names)
        words.append(word)
        before = option if not equals else ""
    return [word for word in words if word != "--force"]


@cache
def _no_paths(verb: str) -> frozenset[str]:
    """The options of a verb that take a value which is no path."""
    fields = REQUESTS[verb].model_fields.items() if verb in REQUESTS else ()
    return frozenset(
        flag(name, option_of(field))
        for name, field in fields
        if field.annotation is not bool and not _holds_path(field.annotation)
    )


def _holds_path(annotation: Any) -> bool:
    return annotation is Path or any(map(_holds_path, get_args(annotation)))


def rename(word: str, names: Mapping[str, str]) -> str:
    """A word of a command line with a known output folder in it renamed; the longest match wins."""
    for path in sorted(names, key=len, reverse=True):
        if word == path or word.startswith(path + "/"):
            return names[path] + word[len(path) :]
    return word


def packages(groups: Sequence[Group]) -> list[tuple[str, str]]:
    """Package versions of all stages; several versions of one package are listed together."""
    found: dict[str, set[str]] = {}
    for group in groups:
        for stage in group.stages:
            for name, version in {**stage.manifest.packages, "python": stage.manifest.python}.items():
                found.setdefault(name, set()).add(version)
    return [(name, ", ".join(sorted(versions))) for name, versions in found.items()]
