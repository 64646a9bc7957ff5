"""Recordings and maps as objects, and what all outputs share: files that are read on demand.

Created from a path, they load what the commands wrote. What the steps return without `out=` is in a temporary
folder, which is deleted with the last object that uses it.
"""

from __future__ import annotations

import os
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from turtlebag.api.given import PathLike
from turtlebag.api.making import Made, TemporaryFolder
from turtlebag.api.tables import Table, Trajectory
from turtlebag.datasets import types
from turtlebag.datasets.bags.reader import bag_info
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.se2 import Array
from turtlebag.reports.stages import Stage, load_output, load_stage

Self = TypeVar("Self", bound="Output")


class Output:
    """A finished output. It is path-like, so it can be passed wherever a path can."""

    kind: ClassVar[str]
    """The name of such outputs in a report."""
    notes: tuple[str, ...] = ()
    """Warnings of the step that made it: what was repaired while reading, what is doubtful."""
    _kept: tuple[object, ...] = ()

    def __init__(self, path: PathLike) -> None:
        self.path = Path(path)
        """Its folder or file."""
        self.stage: Stage | None = self._load()
        """Its manifest, configuration and files; None unless it is an output of ours."""

    def __fspath__(self) -> str:
        return os.fspath(self.path)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({'' if self._temporary else self.path}): {self.verdict}"

    @classmethod
    def of(cls: type[Self], made: Made) -> Self:
        """The result of a step."""
        output = cls(made.path)
        output.notes, output._kept = made.notes, made.kept
        return output

    @property
    def metrics(self) -> dict[str, Any]:
        """Its metrics.json, in SI units and radians; empty if there is none."""
        return {} if self.stage is None else dict(self.stage.metrics)

    @property
    def verdict(self) -> str:
        """The outcome in one sentence."""
        return self._mood_and_verdict[1]

    def _load(self) -> Stage | None:
        stage = load_output(self.path)
        if stage.kind != self.kind:
            raise InputError(f"{self.path}: is an output of {stage.kind}, not of {self.kind}")
        return stage

    @cached_property
    def _mood_and_verdict(self) -> tuple[str, str]:
        from turtlebag.reports.kinds import stage_metrics, verdict

        if self.stage is None:
            return "neutral", str(self.path)
        return verdict(self.stage, stage_metrics(self.stage))

    @property
    def _temporary(self) -> bool:
        return any(isinstance(one, TemporaryFolder) for one in self._kept)

    def _title(self) -> str:
        return type(self).__name__

    def _facts(self) -> dict[str, str]:
        """The most important numbers, as in a report."""
        from turtlebag.reports.kinds import stage_metrics
        from turtlebag.reports.numbers import sections_of

        found = [] if self.stage is None else sections_of(self.stage, stage_metrics(self.stage), "")
        return {one.spec.label: one.text for _, numbers in found for one in numbers if one.spec.trusted}

    def _picture(self) -> str:
        from turtlebag.api.pictures import picture_of

        return "" if self.stage is None else picture_of(self.stage)

    def _repr_html_(self) -> str:
        from turtlebag.api.pictures import card

        mood, verdict = self._mood_and_verdict
        facts = self._facts()
        facts |= {f"note {number}": text for number, text in enumerate(self.notes, start=1)}
        facts |= {} if self._temporary else {"in": str(self.path)}
        return card(self._title(), verdict, facts, self._picture(), mood)


def optional(path: types.Trajectory | None, frame: str) -> Trajectory | None:
    """A trajectory as an array, if there is one."""
    return None if path is None else Trajectory.of(path, frame)


def told(stage: Stage | None, what: str) -> str | None:
    """World or robot of a recording or run, as named on the command line; None if unknown."""
    return None if stage is None else stage.option(what) or stage.fact(what)


class Bag(Output):
    """A recording: what `record` wrote, or any bag or log that `map` reads (.mcap, .db3, .bag, CARMEN)."""

    kind = "record"

    def _load(self) -> Stage | None:
        if (self.path / "manifest.json").is_file():
            return super()._load()
        if not self.path.exists():
            raise InputError(f"{self.path}: no such file or folder")
        return None

    @property
    def world(self) -> str | None:
        """The world it was recorded in, if known."""
        return told(self.stage, "world")

    @property
    def robot(self) -> str | None:
        """The robot that recorded it, if known."""
        return told(self.stage, "robot")

    @cached_property
    def recording(self) -> types.Recording:
        """Everything that mapping uses: stamps, ranges, lidar, odometry; never the truth."""
        return load_recording(self.path)

    @property
    def ranges(self) -> NDArray[np.float32]:
        """The scans, (n_scans, n_beams) [m]; inf without a return, NaN for invalid beams."""
        return self.recording.ranges

    @property
    def odometry(self) -> Trajectory | None:
        """Poses of the base by odometry, at its own rate; None without odometry."""
        return optional(self.recording.path, "odom")

    @property
    def truth(self) -> Trajectory | None:
        """True poses of the base at the scans, in the world; None if unknown."""
        return None if self.stage is None else optional(self.stage.truth, "world")

    @property
    def topics(self) -> Table:
        """Name, type, message count and mean rate of each topic; InputError for a log, which has none."""
        topics = bag_info(self.path).topics
        return Table(
            {
                "topic": [topic.name for topic in topics],
                "type": [topic.msgtype for topic in topics],
                "messages": [topic.count for topic in topics],
                "rate_hz": [topic.rate_hz() for topic in topics],
            }
        )

    def _title(self) -> str:
        return "Recording" if self.world is None else f"Recording of {self.robot} in {self.world}"

    def _picture(self) -> str:
        from turtlebag.api.pictures import path_picture

        if self.stage is not None or self.odometry is None:
            return super()._picture()
        return path_picture(self.odometry)


class Map(Output):
    """An occupancy grid and the path of the robot: what `map` wrote, or any map_server YAML."""

    kind = "map"

    def _load(self) -> Stage | None:
        self.yaml = self.path / "map.yaml" if self.path.is_dir() else self.path
        """The map's YAML file."""
        if not self.yaml.is_file():
            raise InputError(
                f"{self.path}: no map in it (expected a map's YAML file, or a folder with map.yaml)"
            )
        stage = load_stage(self.path) if (self.path / "manifest.json").is_file() else None
        return stage if stage is not None and stage.kind == self.kind else None

    @cached_property
    def occupancy(self) -> OccupancyGrid:
        """The cells with resolution and origin."""
        return load_map(self.yaml) if self.stage is None or self.stage.map is None else self.stage.map

    @property
    def grid(self) -> NDArray[np.int8]:
        """Cells (rows, columns), row 0 at the lowest y: -1 unknown, 0 free .. 100 occupied."""
        return self.occupancy.cells

    @property
    def resolution(self) -> float:
        """Edge of a cell [m]."""
        return self.occupancy.resolution

    @property
    def origin(self) -> Array:
        """x, y [m] and yaw [rad] of the outer corner of cell (0, 0) in the map's frame, (3,)."""
        return self.occupancy.T_map_grid.xyt

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """x_min, x_max, y_min, y_max [m], as `pyplot.imshow(m.grid, origin="lower", extent=...)` takes it."""
        return self.occupancy.extent()

    @property
    def trajectory(self) -> Trajectory:
        """Poses of the base at the scans, (n, 3) in the map's frame; InputError if the map has none."""
        path = None if self.stage is None else optional(self.stage.trajectory, "map")
        if path is None:
            raise InputError(f"{self.path}: has no trajectory; only maps made by turtlebag have one")
        return path

    @property
    def world(self) -> str | None:
        """The world that was mapped, if known."""
        return told(self._source, "world")

    @property
    def robot(self) -> str | None:
        """The robot that mapped it, if known."""
        return told(self._source, "robot")

    @cached_property
    def _source(self) -> Stage | None:
        """The recording or run that it was made from, if that still exists."""
        source = None if self.stage is None else self.stage.input_paths().get("source")
        if source is None:
            return None
        record = next((at for at in (source, source.parent) if (at / "manifest.json").is_file()), None)
        return None if record is None else load_stage(record)

    def _title(self) -> str:
        return "Map" if self.world is None else f"Map of {self.world}"

    def _picture(self) -> str:
        from turtlebag.api.pictures import svg_of
        from turtlebag.reports.figures.maps import plain_map

        return super()._picture() if self.stage is not None else svg_of(plain_map, self.occupancy, {})


def robot_for(map: Map, robot: PathLike | None) -> str:
    """The robot to plan for: the one that made the map, and the burger where that is not known."""
    return os.fspath(map.robot or "burger" if robot is None else robot)


def as_map(map: PathLike) -> Map:
    """A map from whatever was passed as one."""
    return map if isinstance(map, Map) else Map(map)
