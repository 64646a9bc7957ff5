"""A stage run again from what it read: for the numbers its files alone do not hold.

The report knows data files only; running a stage is the pipeline's. The recorded command is used with its
inputs where they lie now and with the very settings of its `config.yaml`.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from turtlebag.pipeline.terminal.messages import log
from turtlebag.reports.provenance import renamed
from turtlebag.reports.stages import Group, Manifest, Stage, changed_files, read_json, read_manifest

Run = Callable[[list[str]], int]
"""Runs a command line, without its `turtlebag`, saying nothing; gives the exit code."""
AGAIN = ("map", "localise", "plan")
"""Stages that are functions of files alone; a drive is judged by its bag."""


@dataclass(frozen=True)
class Remade:
    """A stage's metrics when run again, and which of its data files came out with other bytes."""

    metrics: dict[str, Any]
    other_bytes: list[str]


def places_of(groups: Sequence[Group]) -> dict[str, str]:
    """Where the outputs named in the recorded commands lie now."""
    stages = [stage for group in groups for stage in group.stages]
    return {out.rstrip("/"): str(stage.folder) for stage in stages if (out := stage.option("out"))}


def remade(stage: Stage, places: Mapping[str, str], run: Run) -> Remade | None:
    """Run a stage again; None when it cannot be: another kind, or what it read is gone or not the same."""
    if stage.kind not in AGAIN or len(stage.command) < 2 or not stage.has("config.yaml"):
        return None
    log.debug("running %s again", stage.folder)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "again"
        run(command_again(stage, places, out))
        if not (out / "manifest.json").is_file():
            return None
        if _read(read_manifest(out / "manifest.json")) != _read(stage.manifest):
            return None
        return Remade(read_json(out / "metrics.json"), changed_files(out, stage.manifest.outputs))


def command_again(stage: Stage, places: Mapping[str, str], out: Path) -> list[str]:
    """The recorded command with its settings from the stage's own config.yaml, writing to `out`."""
    words = []
    following = iter(renamed(stage.command, places)[1:])
    for word in following:
        option, equals, _ = word.partition("=")
        if option in ("--out", "--config", "--set"):
            if not equals:
                next(following, None)
        elif word not in ("--quiet", "--verbose", "-q", "-v"):
            words.append(word)
    return [*words, "--config", str(stage.folder / "config.yaml"), "--out", str(out)]


def _read(manifest: Manifest) -> list[str]:
    """Hashes of everything a stage read, sorted."""
    return sorted(digest for entry in manifest.inputs.values() for digest in entry.sha256.values())
