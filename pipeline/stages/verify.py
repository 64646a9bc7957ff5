"""Verify a report: hashes of all it rests on, and it and every stage of it made once more and compared."""

from __future__ import annotations

import platform
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import cpu_name, package_versions, plain
from turtlebag.pipeline.stages.again import NotRun, command_differs, made_again, report_again
from turtlebag.pipeline.stages.other_systems import MARK
from turtlebag.pipeline.terminal.messages import track
from turtlebag.reports.grouping import group_stages
from turtlebag.reports.kinds import stage_metrics
from turtlebag.reports.metric_specs import tolerance_of
from turtlebag.reports.numbers import leaves
from turtlebag.reports.stages import (
    Group,
    Manifest,
    Stage,
    changed_files,
    load_stage,
    read_json,
    read_manifest,
)

FACTS = ("stage", "seed", "world", "robot", "task", "parts")
"""What a manifest says of a stage besides its request, its hashes and its times."""
DIGITS = re.compile(r"[-+.\d]+")


@dataclass(frozen=True)
class Check:
    """One value: as reported and as computed again, on the same machine or on another one."""

    key: str
    reported: Any
    found: Any
    tolerance: float | None = None
    """By how much the two may differ; None: not at all."""

    @property
    def agrees(self) -> bool:
        """Whether the two are the same, as far as they can be."""
        one, other = self.reported, self.found
        if self.tolerance is None or type(one) is bool or type(other) is bool:
            return type(one) is type(other) and bool(one == other)
        if isinstance(one, str) and isinstance(other, str):
            return DIGITS.sub("", one) == DIGITS.sub("", other)
        if isinstance(one, int | float) and isinstance(other, int | float):
            return abs(one - other) <= self.tolerance
        return bool(one == other)


@dataclass
class Verification:
    """What was found: every check; every problem, and why a stage was not run again, in one line each; the
    numbers that were not computed again; how many files were hashed; and what is other here than where the
    outputs were made."""

    checks: list[Check] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    not_run: list[str] = field(default_factory=list)
    unchecked: list[str] = field(default_factory=list)
    files: int = 0
    elsewhere: list[str] = field(default_factory=list)

    def compare(self, name: str, reported: object, found: object, *, exact: bool, kind: str) -> None:
        """Check each value of nested metrics, and add a problem for each that is other."""
        told, computed = dict(leaves(reported)), dict(leaves(found))
        for path in dict.fromkeys([*told, *computed]):
            value, tolerance = told.get(path), None if exact else tolerance_of(kind, path, computed.get(path))
            missing = path not in told or path not in computed
            check = Check(f"{name}:{path}", value, computed.get(path), tolerance)
            self.checks.append(check)
            if missing or not check.agrees:
                which = "not made again" if path not in computed else f"computed {check.found}"
                self.problems.append(f"{check.key}: reported {value}, {which}")


def verify(report: Path, *, quick: bool = False, allow_commands: bool = False) -> Verification:
    """Check a report's folder; InputError when it or its inputs cannot be read at all.

    `quick`: no stage is run again. `allow_commands`: also those of which the request names code from outside
    the package.
    """
    found = Verification()
    manifest = read_manifest(_file(report, "manifest.json"))
    folders = stage_folders(report, manifest)
    groups = group_stages([load_stage(folder) for folder in folders])
    reported = read_json(_file(report, "metrics.json"))
    stages = [stage for group in groups for stage in group.stages]
    found.elsewhere = list(dict.fromkeys(line for one in stages if (line := _elsewhere(one.manifest))))
    _check_hashes(report, manifest, groups, found)
    named = [(group, stage) for group in groups for stage in group.stages]
    for group, stage in named if quick else track(named, "running stages again", len(named)):
        name = f"{group.name}/{stage.label}"
        chapter = reported.get(group.name)
        metrics = chapter.get(stage.label) if isinstance(chapter, dict) else None
        if not isinstance(metrics, dict):
            found.problems.append(f"{name}: not in the report's metrics.json")
            continue
        found.problems += [
            f"{name}:{path}: the report and the stage's own metrics differ"
            for path, value in leaves(plain(stage_metrics(stage)))
            if dict(leaves(metrics)).get(path) != value
        ]
        if quick:
            found.unchecked += _numbers(name, metrics)
        else:
            _check_stage(name, stage, stages, metrics, found, allow_commands=allow_commands)
    _check_report(report, manifest, folders, found)
    return found


def stage_folders(report: Path, manifest: Manifest) -> list[Path]:
    """Where the report's stages are: where the manifest says, or beside a report that was moved with them."""
    if manifest.stage != "report":
        raise InputError(f"{report}: is a {manifest.stage} output, not a report")
    folders = []
    for label, entry in manifest.inputs.items():
        if label.startswith("rival:"):
            raise InputError(f"{report}: is a report of an earlier version; make it again")
        if label.startswith(MARK):
            continue
        for candidate in (report / manifest.folders.get(label, ""), entry.path):
            if (candidate / "manifest.json").is_file():
                folders.append(candidate)
                break
        else:
            raise InputError(f"{report}: its input {label} is neither at {entry.path} nor next to the report")
    return folders


def _file(folder: Path, name: str) -> Path:
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder (expected a report)")
    if not (folder / name).is_file():
        raise InputError(f"{folder}: has no {name}, so it is not a report")
    return folder / name


def _elsewhere(manifest: Manifest) -> str:
    """What is other here than where an output was made, so that its bytes may be; empty where nothing is, and
    of an output that cannot be made again, which says less of where it was made."""
    if manifest.request is None:
        return ""
    machine = platform.machine()
    here = {**package_versions(), "python": platform.python_version(), "processor": cpu_name()}
    there = {**manifest.packages, "python": manifest.python, "processor": manifest.cpu}
    # Of the system what may compute otherwise: not the kernel.
    here["system"], there["system"] = (
        text[max(text.find(machine), 0) :] for text in (platform.platform(), manifest.platform)
    )
    other = [name for name in here if here[name] != there.get(name)]
    return ", ".join(f"{name} {there.get(name, 'none')} (here {here[name]})" for name in other)


def _check_hashes(report: Path, manifest: Manifest, groups: Sequence[Group], found: Verification) -> None:
    """The files of the report and of its stages against the manifests, and these against each other."""
    found.files += len(manifest.outputs)
    for path in changed_files(report, manifest.outputs):
        found.problems.append(f"{report.name}/{path}: changed since the report was made")
    for group in groups:
        for stage in group.stages:
            name, made = f"{group.name}/{stage.label}", stage.manifest.outputs
            found.files += len(made)
            changed = changed_files(stage.folder, made)
            found.problems += [f"{name}/{path}: does not match its manifest" for path in changed]
            if name not in manifest.inputs:
                continue
            then = manifest.inputs[name].sha256
            # In the folder of a stage there may be files that it did not make.
            others = {path: digest for path, digest in then.items() if path not in made}
            again = [path for path, digest in then.items() if made.get(path, digest) != digest]
            for path in [*again, *changed_files(stage.folder, others)]:
                found.problems.append(f"{name}/{path}: changed since the report was made")


def _check_stage(
    name: str,
    stage: Stage,
    stages: Sequence[Stage],
    metrics: Mapping[str, Any],
    found: Verification,
    *,
    allow_commands: bool,
) -> None:
    """Run a stage again and compare all that it leaves, and what the report and its manifest say of it."""
    exact = not _elsewhere(stage.manifest)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "again"
        try:
            made_again(stage, stages, out, allow_commands=allow_commands)
            if said := command_differs(stage.manifest):
                found.problems.append(f"{name}: {said}")
        except NotRun as reason:
            found.not_run.append(f"{name}: {reason}")
            found.unchecked += _numbers(name, metrics)
            return
        again = Stage(out, stage.kind, stage.label, read_manifest(out / "manifest.json"), stage.title)
        before = len(found.problems)
        found.compare(name, metrics, plain(stage_metrics(again)), exact=exact, kind=stage.kind)
        named = ("metrics.json",) if len(found.problems) > before else ()
        if exact:
            _compare_files(name, stage.manifest, again.manifest, found, but=named)
        facts, is_so = (read_json(one / "manifest.json") for one in (stage.folder, out))
        found.problems += [
            f"{name}: its manifest says {key} {facts.get(key)}; run again, it is {is_so.get(key)}"
            for key in FACTS
            if facts.get(key) != is_so.get(key)
        ]
        found.problems += _other_inputs(name, stage.manifest, again.manifest)


def _other_inputs(name: str, made: Manifest, again: Manifest) -> Iterator[str]:
    """What a stage read when it was run again, and is not what its manifest says it read."""
    for label in dict.fromkeys([*made.inputs, *again.inputs]):
        if label not in again.inputs:
            yield f"{name}: its manifest has an input {label}; run again, it reads none"
        elif label not in made.inputs:
            if label != "teleop_override":  # at the keyboard then, now from the file that it left
                path = again.inputs[label].path
                yield f"{name}: run again, it reads {path}, which its manifest does not list"
        # There may be more files in a folder by now.
        elif not made.inputs[label].sha256.items() <= again.inputs[label].sha256.items():
            yield f"{name}: run again, its input {label} is another one: {again.inputs[label].path}"


def _check_report(report: Path, manifest: Manifest, folders: Sequence[Path], found: Verification) -> None:
    """Make the report again from its stages as they are, and compare its page, figures and tables."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / report.resolve().name
        try:
            report_again(report, manifest, folders, out)
            if said := command_differs(manifest):
                found.problems.append(f"{report.name}: {said}")
        except NotRun as reason:
            found.not_run.append(f"{report.name}: {reason}")
            return
        again = read_manifest(out / "manifest.json")
        exact = not _elsewhere(manifest)
        if exact:
            _compare_files(report.name, manifest, again, found)
        metrics, numbers = read_json(report / "metrics.json"), read_json(out / "metrics.json")
        for name in numbers:
            systems = [one.get(name, {}).get("systems") or {} for one in (metrics, numbers)]
            if any(systems):
                found.compare(f"{name}/systems", *systems, exact=exact, kind="systems")


def _compare_files(
    name: str, made: Manifest, again: Manifest, found: Verification, but: Sequence[str] = ()
) -> None:
    for path in dict.fromkeys([*made.outputs, *again.outputs]):
        if path in but or made.outputs.get(path) == again.outputs.get(path):
            continue
        what = "has other content"
        if path not in again.outputs:
            what = "is not made"
        elif path not in made.outputs:
            what = "is made too"
        found.problems.append(f"{name}/{path}: made again, it {what}")


def _numbers(name: str, metrics: Mapping[str, Any]) -> Iterator[str]:
    """Keys of the numbers in a stage's metrics."""
    return (
        f"{name}:{path}"
        for path, value in leaves(metrics)
        if isinstance(value, int | float) and not isinstance(value, bool)
    )
