"""Finished stage outputs as a report sees them: folders with a manifest."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from turtlebag.datasets.bags.source import LOGS, PACKED, SUFFIXES
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.number_text import decimals
from turtlebag.datasets.other_systems import SystemFiles
from turtlebag.datasets.outputs import sha256_file, sha256_tree
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.runlog import RunLog
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.trajectories import load_tum, stamp_text
from turtlebag.datasets.true_maps import TrueMap, load_true_map
from turtlebag.datasets.types import Recording, Trajectory
from turtlebag.datasets.yaml_files import checked, read_mapping
from turtlebag.reports.metric_specs import SPECS

# Files that tie stages together when their hashes agree; a shared config proves nothing.
LINKING = (".pgm", ".tum", *SUFFIXES, *LOGS, *PACKED)
# Files that no two recordings share, of one world either.
DRIVEN = (".mcap", ".tum")


class Input(BaseModel):
    """Something that a stage read: where it lay, and the sha256 of its files."""

    path: Path
    sha256: dict[str, str]


class Manifest(BaseModel):
    """What reports read of a manifest; whatever else it holds is not looked at."""

    stage: str
    command: list[str] = []
    started_in: str | None = None
    """The folder, seen from the output, where the relative paths of its inputs begin."""
    request: dict[str, Any] | None = None
    interrupted: bool = False
    seed: int | None = None
    inputs: dict[str, Input] = {}
    outputs: dict[str, str] = {}
    folders: dict[str, str] = {}
    systems: list[SystemFiles] = []
    packages: dict[str, str] = {}
    python: str = "?"
    platform: str = "?"
    cpu: str = "?"
    world: str | None = None
    robot: str | None = None
    task: str | None = None


@dataclass(frozen=True, eq=False)
class Stage:
    """One output: `kind` is its manifest's `stage`; `label` names it within its group, `title` for people."""

    folder: Path
    kind: str
    label: str
    manifest: Manifest
    title: str = ""

    @property
    def command(self) -> list[str]:
        """The command line that made it."""
        return self.manifest.command

    def option(self, name: str) -> str | None:
        """Value of `--name` in its command line."""
        return next(iter(self.options(name)), None)

    def options(self, name: str) -> list[str]:
        """Every value of `--name` in its command line."""
        words = self.command
        return [
            following if word == f"--{name}" else word.partition("=")[2]
            for word, following in zip(words, [*words, ""][1:], strict=True)
            if word == f"--{name}" or word.startswith(f"--{name}=")
        ]

    @cached_property
    def config(self) -> Mapping[str, Any]:
        """Its resolved configuration, empty when it left none; InputError when it cannot be read."""
        path = self.folder / "config.yaml"
        return read_mapping(path) if path.is_file() else {}

    @cached_property
    def metrics(self) -> Mapping[str, Any]:
        """Its metrics.json, empty for stages that write none."""
        path = self.folder / "metrics.json"
        if not path.is_file():
            return {}
        data = read_json(path)
        checked(_Metrics, data, where=str(path))
        return data

    def fact(self, name: str) -> str | None:
        """World, robot, task or teleop: from the manifest, the config or the command line."""
        for source in (self.manifest.model_dump(include={name}), self.metrics, self.config):
            if isinstance(source.get(name), str):
                return str(source[name])
        return self.option(name)

    def has(self, relative: str) -> bool:
        """Whether the folder holds that file or folder."""
        return (self.folder / relative).exists()

    @cached_property
    def trajectory(self) -> Trajectory | None:
        """Its estimate: trajectory.tum; None also when it ended before the first scan."""
        return self._poses("trajectory.tum")

    @cached_property
    def truth(self) -> Trajectory | None:
        """True poses at the scans: truth/trajectory.tum; None also when there was no scan."""
        return self._poses("truth/trajectory.tum")

    @cached_property
    def recording(self) -> Recording:
        """What its bag holds, as mapping reads it; InputError where there is none."""
        return load_recording(self.folder)

    @property
    def odometry(self) -> Trajectory:
        """Where the wheels take it to be: its bag's /odom; InputError where there is none."""
        if (path := self.recording.path) is None:
            raise InputError(f"{self.folder / 'bag'}: no odometry in it")
        return path

    def _poses(self, name: str) -> Trajectory | None:
        path = self.folder / name
        return load_tum(path) if path.is_file() and path.stat().st_size > 0 else None

    @property
    def localised(self) -> bool:
        """Whether a run went by a map: without one its trajectory.tum is the odometry."""
        return bool(self.metrics.get("localisation_error_m"))

    @cached_property
    def true_map(self) -> TrueMap | None:
        """The world at the lidar's height: truth/map.yaml, truth/circles.yaml."""
        return load_true_map(self.folder / "truth") if self.has("truth/map.yaml") else None

    @cached_property
    def map(self) -> OccupancyGrid | None:
        """The grid it built: map.yaml."""
        return load_map(self.folder / "map.yaml") if self.has("map.yaml") else None

    @cached_property
    def runlog(self) -> RunLog | None:
        """Its rows per control tick: runlog.csv."""
        return RunLog.load(self.folder / "runlog.csv") if self.has("runlog.csv") else None

    @cached_property
    def plan(self) -> Trajectory | None:
        """The path that it planned: path.csv; None also where it found none."""
        poses = read_path(self.folder / "path.csv") if self.has("path.csv") else SE2.identity(0)
        return Trajectory.untimed(poses) if len(poses) else None

    @property
    def span(self) -> str:
        """First and last stamp of its scans, as text."""
        trajectory = self.trajectory if self.trajectory is not None else self.truth
        if trajectory is None or len(trajectory) == 0:
            return ""
        first, last = int(trajectory.stamps_ns.min()), int(trajectory.stamps_ns.max())
        return f"{stamp_text(first)} to {stamp_text(last)} s"

    def input_paths(self) -> dict[str, Path]:
        """Its inputs by the names the manifest gives them."""
        return {name: entry.path for name, entry in self.manifest.inputs.items()}

    def hashes(self, name: str) -> dict[str, str]:
        """sha256 of the files of one input by their paths in it; none where there is no such input."""
        entry = self.manifest.inputs.get(name)
        return {} if entry is None else entry.sha256

    def linking_hashes(self) -> set[str]:
        """Hashes of the data files it read or wrote."""
        files = dict(self.manifest.outputs)
        for name, entry in self.manifest.inputs.items():
            files |= {f"{name}/{path}": digest for path, digest in entry.sha256.items()}
        return {
            digest
            for path, digest in files.items()
            if path.endswith(LINKING) or (path.endswith("map.yaml") and "truth/" not in path)
        }


@dataclass(frozen=True, eq=False)
class Group:
    """Stages that belong together: one world (or one log), in the order record, map, runs."""

    name: str
    stages: tuple[Stage, ...]

    def first(self, kind: str) -> Stage | None:
        """The first stage of a kind."""
        return next((stage for stage in self.stages if stage.kind == kind), None)

    def of_kind(self, kind: str) -> list[Stage]:
        """All stages of a kind."""
        return [stage for stage in self.stages if stage.kind == kind]

    def record_of(self, stage: Stage) -> Stage | None:
        """The recording whose truth a stage was measured against, else whose bag it read: by their hashes.

        A group may hold several recordings of its world, and times alone fit all of them.
        """
        for inputs in ("truth",), tuple(stage.manifest.inputs):
            read = {digest for name in inputs for digest in _driven(stage.hashes(name))}
            for record in self.of_kind("record"):
                if read & _driven(record.manifest.outputs):
                    return record
            if read and inputs == ("truth",):
                return None
        return None

    def given_map(self, stage: Stage) -> OccupancyGrid | None:
        """The very map a stage was given: its files while they have their hashes, else the same map among the
        group's, for a report that was moved; None when it is nowhere to be found.
        """
        given = {name: entry for name, entry in stage.manifest.inputs.items() if name in ("map", "map_image")}
        if "map" not in given:
            return None
        if all(entry.path.is_file() and sha256_tree(entry.path) == entry.sha256 for entry in given.values()):
            with suppress(InputError):
                return load_map(given["map"].path)
        wanted = {digest for entry in given.values() for digest in entry.sha256.values()}
        for other in self.stages:
            for folder, grid in (("", other.map), ("truth/", other.true_map)):
                if wanted <= {other.manifest.outputs.get(f"{folder}map.{kind}") for kind in ("yaml", "pgm")}:
                    return grid
        return None


def _driven(files: Mapping[str, str]) -> set[str]:
    """Hashes of the bags and trajectories among files."""
    return {digest for path, digest in files.items() if path.endswith(DRIVEN)}


def read_json(path: Path) -> dict[str, Any]:
    """A JSON file that holds an object; InputError says what else it is. Whole numbers larger than any float
    are infinite, as larger fractions are."""
    try:
        data = json.loads(
            path.read_text(), parse_int=lambda digits: int(digits) if len(digits) < 300 else float(digits)
        )
    except (OSError, ValueError, RecursionError):
        raise InputError(f"{path}: not readable JSON") from None
    if not isinstance(data, dict):
        raise InputError(f"{path}: expected a JSON object")
    return data


def read_path(path: Path) -> SE2:
    """Poses (n,) of a `path.csv` with columns x, y, yaw, none where no path was found; InputError when it is
    not one.
    """
    with path.open(newline="") as file:
        reader = csv.DictReader(file)
        try:
            if not {"x", "y", "yaw"} <= set(reader.fieldnames or []):
                raise KeyError
            rows = [decimals([row[name] for name in ("x", "y", "yaw")]) for row in reader]
        except (KeyError, TypeError, ValueError):
            raise InputError(f"{path}: not a path (expected columns x,y,yaw)") from None
    return SE2.from_array(np.array(rows).reshape(-1, 3))


def load_stage(folder: Path) -> Stage:
    """The output in `folder` of a stage that a report shows; InputError for anything else."""
    stage = load_output(folder)
    if stage.kind not in SPECS:
        raise InputError(f"{folder}: is a {stage.kind} output; a report shows {', '.join(SPECS)}")
    return stage


def load_output(folder: Path) -> Stage:
    """The finished output in `folder`; InputError for anything else."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder (expected the output of a stage)")
    path = folder / "manifest.json"
    if not path.is_file():
        raise InputError(f"{folder}: has no manifest.json, so it is not a finished output")
    manifest = read_manifest(path)
    return Stage(folder, manifest.stage, manifest.stage, manifest)


class _Parameter(BaseModel):
    value: float
    unit: str
    observable: bool
    interval_95: tuple[float, float] = (0.0, 0.0)
    why: str = ""


class _Quantity(BaseModel):
    label: str
    told_apart: bool
    cliffs_delta: float


class _Metrics(BaseModel):
    """The part of a metrics.json that is more than numbers by name."""

    goals: list[dict[str, Any]] | None = None
    planners: list[dict[str, Any]] | None = None
    parameters: dict[str, _Parameter] | None = None
    quantities: dict[str, _Quantity] | None = None


def read_manifest(path: Path) -> Manifest:
    """A manifest.json; InputError names the first part that is not of its kind."""
    return checked(Manifest, read_json(path), where=str(path))


def changed_files(folder: Path, outputs: Mapping[str, str]) -> list[str]:
    """Outputs that are missing in the folder or no longer have the sha256 they had."""
    return [
        path
        for path, digest in outputs.items()
        if not (folder / path).is_file() or sha256_file(folder / path) != digest
    ]
