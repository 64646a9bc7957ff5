"""The rivals of a report, read and measured again."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import sha256_file
from turtlebag.pipeline.stages.recompute import Check, checks
from turtlebag.pipeline.stages.rivals import inputs_of, measured_in, recalled
from turtlebag.reports.beside import Beside, beside
from turtlebag.reports.figures.album import Album
from turtlebag.reports.numbers import leaves
from turtlebag.reports.spec_systems import SYSTEMS
from turtlebag.reports.stages import Group, Manifest


def measured_again(
    report: Path, manifest: Manifest, groups: list[Group], reported: Mapping[str, Any]
) -> tuple[Beside | None, list[Check], list[str]]:
    """What the report should say of its rivals, a check of every number, and problems, one line each."""
    if not manifest.rivals:
        return None, [], []
    group = groups[0]
    name = f"{group.name}/rivals"
    try:
        files = recalled(manifest, report)
        problems = _changed(manifest, inputs_of(files))
        known, systems = measured_in(groups, files)
    except (InputError, KeyError) as error:
        return None, [], [f"{name}: {error}"]
    found = beside(systems, known, Album(None), f"{group.name}-rivals")
    told = reported.get(group.name, {}).get("rivals", {})
    done = list(checks(name, told, found.metrics))
    if missing := {path for path, _ in leaves(found.metrics)} - {path for path, _ in leaves(told)}:
        problems.append(f"{name}: not in the report's metrics.json: {', '.join(sorted(missing)[:3])}")
    return found, done, problems


def _changed(manifest: Manifest, inputs: Mapping[str, Path]) -> list[str]:
    """Files of rivals that are not what they were."""
    return [
        f"{name}: {path} changed since the report was made"
        for name, path in inputs.items()
        if not path.is_file() or sha256_file(path) not in manifest.inputs[name].sha256.values()
    ]


def unit_of(path: str) -> str | None:
    """Unit in which a page shows the number at `systems.NAME.PATH`."""
    rest = path.split(".", 2)[2]
    return next((spec.unit for section in SYSTEMS for spec in section.specs if spec.path == rest), None)
