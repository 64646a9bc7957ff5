"""Other systems beside a stage of ours: what is known of the recording, and what a manifest says of them."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.other_systems import OURS, System, SystemFiles, kind_of, load_system
from turtlebag.datasets.trajectories_3d import Trajectory3D
from turtlebag.pipeline.stages.requests.options import flag_of
from turtlebag.pipeline.stages.requests.pages import SYSTEM_OPTIONS, SystemsRequest
from turtlebag.reports.metrics.references import References
from turtlebag.reports.metrics.systems import Measured, measure
from turtlebag.reports.stages import Group, Manifest, Stage

KINDS = ("map", "localise", "navigate")
"""What has a trajectory of its own, in the order in which a report takes one for ours."""
MARK = "system:"
"""Begins the names of those inputs of a report that are files of other systems."""


def systems_of(request: SystemsRequest, files: Sequence[tuple[str, Path]]) -> list[SystemFiles]:
    """The systems that files belong to, by their names, and how they are read; one without a name is called
    as its file is, and a system may have a trajectory and a map.

    InputError for a file that is neither, for two of one kind, and for an option with an unknown name.
    """
    found: dict[str, dict[str, Path]] = {}
    for name, path in files:
        name = name or re.sub(r"^[^A-Za-z0-9]+|[^A-Za-z0-9_+-]+", "-", path.stem).strip("-") or "other"
        kind = kind_of(path)
        held = found.setdefault(name, {})
        if kind in held:
            raise InputError(f"{path}: {name} already has a {kind} ({held[kind]}); give each its own NAME=")
        held[kind] = path
    bases, times, shifts = (_by_name(request, option, found) for option in SYSTEM_OPTIONS)
    return [
        SystemFiles(
            name,
            held.get("trajectory"),
            held.get("map"),
            times.get(name),
            bases.get(name, (0.0, 0.0, 0.0)),
            shifts.get(name, 0.0),
        )
        for name, held in found.items()
    ]


def _by_name(request: SystemsRequest, option: str, names: Mapping[str, object]) -> dict[str, Any]:
    """Values of an option by system; without a name, of the only one."""
    flag, found = flag_of(option), {}
    for name, value in getattr(request, option):
        if not names:
            raise InputError(f"{flag}: there is no other system")
        if not name and len(names) > 1:
            raise InputError(f"{flag}: there are several systems; write {flag} NAME=VALUE")
        if name and name not in names:
            raise InputError(f"{flag} {name}: no system named {name}; known: {', '.join(names)}")
        found[name or next(iter(names))] = value
    return found


def ours_of(stages: Sequence[Stage]) -> Stage:
    """The stage that other systems are compared with; InputError where there is none."""
    for kind in KINDS:
        for stage in stages:
            if stage.kind == kind and (stage.trajectory is not None or stage.map is not None):
                return stage
    raise InputError(f"{stages[0].folder}: other systems are compared with an output of {', '.join(KINDS)}")


def measured(
    stage: Stage, files: Sequence[SystemFiles], group: Group | None = None
) -> tuple[References, list[Measured]]:
    """Ours and the other systems, measured; InputError for what cannot be read or compared."""
    track = None if stage.trajectory is None else Trajectory3D.of(stage.trajectory)
    scans = np.zeros(0, dtype=np.int64) if track is None else track.stamps_ns
    ours = System(OURS, track, stage.map)
    others = [load_system(entry, scans) for entry in files]
    for other in others:
        if (other.track is None or track is None) and (other.grid is None or stage.map is None):
            has = "no map" if other.track is None else "no trajectory"
            raise InputError(f"{other.name}: {stage.folder} has {has} to compare its own with")
    known = known_of(stage, group)
    return known, measure(ours, others, known)


def measured_in(groups: Sequence[Group], files: Sequence[SystemFiles]) -> tuple[References, list[Measured]]:
    """The other systems of a report, measured; InputError when it is about more than one world or log."""
    if len(groups) > 1:
        names = ", ".join(group.name for group in groups)
        raise InputError(f"--system: belongs to one recording, but these outputs are of {names}")
    return measured(ours_of(groups[0].stages), files, groups[0])


def known_of(stage: Stage, group: Group | None = None) -> References:
    """The truth and the relations of a stage's recording, where they are still to be found."""
    record = group.record_of(stage) if group is not None else None
    places = [record.folder / "truth"] if record is not None else []
    places += [stage.folder / "truth"] if stage.kind == "navigate" else []
    for name in ("truth", "bag", "source"):
        path = stage.input_paths().get(name)
        if path is not None:
            places += [path] if name == "truth" else [path / "truth"]
            places += [path.parent / "truth"] if path.name == "bag" else []
    truth = next((place for place in places if (place / "trajectory.tum").is_file()), None)
    relations = stage.input_paths().get("relations")
    return References.load(truth, relations if relations is not None and relations.is_file() else None)


def inputs_of(files: Sequence[SystemFiles]) -> dict[str, Path]:
    """Every file of the other systems by the name a manifest gives it."""
    return {f"{MARK}{one.name}/{what}": path for one in files for what, path in one.inputs().items()}


def for_manifest(files: Sequence[SystemFiles], out: Path) -> list[dict[str, Any]]:
    """What a manifest says of the other systems, their files as seen from `out`."""
    return [
        asdict(one) | {what: path and os.path.relpath(path, out) for what, path in one.paths.items()}
        for one in files
    ]


def from_manifest(manifest: Manifest, out: Path) -> list[SystemFiles]:
    """The other systems of a report in `out`, wherever report and files were moved together."""

    def found(one: SystemFiles) -> dict[str, Any]:
        given = {what: path for what, path in one.paths.items() if path is not None}
        return {
            what: out / path if (out / path).is_file() else manifest.inputs[f"{MARK}{one.name}/{what}"].path
            for what, path in given.items()
        }

    return [replace(one, **found(one)) for one in manifest.systems]
