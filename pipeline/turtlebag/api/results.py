"""Runs, localisations, plans and reports as objects."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TypeVar, cast

import numpy as np

from turtlebag.api.outputs import Bag, Map, Output, optional
from turtlebag.api.tables import Table, Trajectory
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.runlog import RunLog
from turtlebag.datasets.se2 import Array
from turtlebag.reports.kinds import stage_metrics, verdict
from turtlebag.reports.numbers import leaves
from turtlebag.reports.stages import Stage, load_stage, read_json, read_path
from turtlebag.reports.system_comparison import SystemComparison, SystemsMetrics
from turtlebag.reports.verdicts import overall_mood

GOAL_COLUMNS = ("x", "y", "yaw", "status", "time_s", "error_m", "error_rad")


Part = TypeVar("Part", bound=Output)


class Run(Output):
    """A run of `navigate`."""

    kind = "navigate"
    stage: Stage

    @property
    def success(self) -> bool:
        """Whether the task succeeded by ground truth: all goals truly reached, and no collision."""
        return bool(self.metrics.get("true_success"))

    @property
    def goals(self) -> Table:
        """One row per goal: x, y, yaw, status, time_s, error_m, error_rad (by ground truth; NaN: unknown)."""
        goals = self.metrics.get("goals") or []
        return Table({name: [goal.get(name) for goal in goals] for name in GOAL_COLUMNS})

    @property
    def trajectory(self) -> Trajectory | None:
        """The robot's estimate at the scans; without a map its odometry. None before the first scan."""
        return optional(self.stage.trajectory, "map")

    @property
    def truth(self) -> Trajectory | None:
        """True poses at the scans, in the world. None before the first scan."""
        return optional(self.stage.truth, "world")

    @cached_property
    def log(self) -> Table:
        """One row per 1/30 s: true, estimated, odometry pose, command, clearance, contacts, goal, state."""
        return Table(RunLog.load(self.path / "runlog.csv").columns())

    @property
    def bag(self) -> Bag:
        """The bag of the run."""
        return self._with(Bag(self.path / "bag"))

    @property
    def map(self) -> Map:
        """The map of an exploration; InputError if the run made none."""
        if not (self.path / "map.yaml").is_file():
            raise InputError(f"{self.path}: made no map; only the task explore does")
        return self._with(Map(self.path / "map.yaml"))

    def _with(self, part: Part) -> Part:
        """A part of this output, which keeps it alive."""
        part._kept = (self, *self._kept)
        return part

    def _title(self) -> str:
        return f"{str(self.stage.fact('task')).capitalize()} of {self.stage.fact('robot')}"


class Localisation(Output):
    """The result of `localise`: the poses of a recorded robot on a map."""

    kind = "localise"
    stage: Stage

    @property
    def success(self) -> bool:
        """Whether the filter had the right place at the end, by ground truth if given."""
        return bool(self.metrics.get("true_success", self.metrics.get("success")))

    @property
    def trajectory(self) -> Trajectory:
        """Poses of the base as estimated at each scan, (n, 3) in the map's frame; odometry if rejected."""
        assert self.stage.trajectory is not None
        return Trajectory.of(self.stage.trajectory)


class Plan(Output):
    """The result of `plan`: a path, or the reason why there is none."""

    kind = "plan"
    stage: Stage

    @property
    def success(self) -> bool:
        """Whether there is a path."""
        return bool(self.metrics.get("success"))

    @cached_property
    def poses(self) -> Array:
        """x, y [m] and yaw [rad] from start to goal in the map's frame, (n, 3); (0, 3) without a path."""
        return read_path(self.path / "path.csv").xyt

    @property
    def length_m(self) -> float:
        """Length of the path [m]; NaN without one."""
        return float(self.metrics.get("length_m", np.nan))


class _Page(Output):
    """An output that is a page; its card shows `shown`, a table, and where the `files` are."""

    shown = ""
    files: tuple[str, ...] = ("page",)
    stage: Stage

    @property
    def page(self) -> Path:
        """The page, for a browser."""
        return self.path / "index.html"

    def _facts(self) -> dict[str, str]:
        return {name: str(getattr(self, name)) for name in self.files}

    def _picture(self) -> str:
        return str(getattr(self, self.shown)._repr_html_()) if self.shown else ""


class _RobotPage(_Page):
    """A page about the robot of a recording."""

    @property
    def robot(self) -> Path:
        """The robot's file, for `robot` of any step."""
        return self.path / "robot.yaml"


class Identification(_RobotPage):
    """The result of `identify`: a robot for the simulator, and the page about its parameters."""

    kind = "identify"
    shown = "parameters"
    files = ("robot", "page")

    @cached_property
    def parameters(self) -> Table:
        """A row for each: name, value, low and high (the ends of the 95 % interval), unit, observable."""
        entries = read_json(self.path / "identify.json")["parameters"]
        ends = [entry.get("interval_95", (np.nan, np.nan)) for entry in entries.values()]
        columns = {"value": [entry["value"] for entry in entries.values()]}
        columns |= {"low": [low for low, _ in ends], "high": [high for _, high in ends]}
        told = {name: [entry[name] for entry in entries.values()] for name in ("unit", "observable")}
        return Table({"name": [*entries], **columns, **told})


class Twin(_RobotPage):
    """The result of `twin`: world, robot and map of a recording, and the page real beside simulated."""

    kind = "twin"
    shown = "quantities"
    files = ("world", "robot", "page")

    @property
    def world(self) -> Path:
        """The world's file, for `world` of any step."""
        return self.path / "world.yaml"

    @property
    def map(self) -> Path:
        """The map's YAML file."""
        return self.path / "map" / "map.yaml"

    @cached_property
    def quantities(self) -> Table:
        """A row for each: name, medians of both, D, Cliff's delta, p after Holm, told_apart."""
        entries = self.metrics["quantities"]
        columns = {
            side: [entry[side]["median"] for entry in entries.values()] for side in ("real", "simulated")
        }
        for name in ("ks", "cliffs_delta", "p_holm", "told_apart"):
            columns[name] = [entry[name] for entry in entries.values()]
        return Table({"name": [*entries], **columns})


class Comparison(_Page):
    """The result of `compare`, of two outputs, or of ours and other systems."""

    kind = "compare"
    shown = "numbers"

    @cached_property
    def numbers(self) -> Table:
        """One row per number: its name in metrics.json, then a column for A and B, or for each system; of
        several runs their median."""
        sides = self.metrics.get("sides")
        if sides is not None:
            columns = {"number": [*sides["A"]["numbers"]]}
            columns |= {
                name: [one["median"] for one in side["numbers"].values()] for name, side in sides.items()
            }
            return Table(columns)
        told = {name: dict(leaves(numbers)) for name, numbers in self.metrics["systems"].items()}
        rows = [*dict.fromkeys(row for numbers in told.values() for row in numbers)]
        columns = {name: [one.get(row) for row in rows] for name, one in told.items()}
        return Table({"number": rows, **columns})

    @cached_property
    def _mood_and_verdict(self) -> tuple[str, str]:
        if "systems" in self.metrics:
            return "neutral", SystemComparison(cast(SystemsMetrics, self.metrics), []).sentence
        return "neutral", str(self.metrics["sentence"])


class Report(_Page):
    """The page that `report` made."""

    kind = "report"

    @cached_property
    def _mood_and_verdict(self) -> tuple[str, str]:
        mood = overall_mood(mood for mood, _ in self._verdicts.values())
        return mood, f"{len(self.stage.manifest.folders)} outputs"

    @cached_property
    def _verdicts(self) -> dict[str, tuple[str, str]]:
        """The outputs that it shows, if they still exist."""
        places = {name: self.path / place for name, place in self.stage.manifest.folders.items()}
        found = {name: place for name, place in places.items() if (place / "manifest.json").is_file()}
        stages = {name: load_stage(place) for name, place in found.items()}
        return {name: verdict(stage, stage_metrics(stage)) for name, stage in stages.items()}

    def _facts(self) -> dict[str, str]:
        return {**{name: text for name, (_, text) in self._verdicts.items()}, **super()._facts()}
