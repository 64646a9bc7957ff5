"""What a report says, before it is laid out: the parts of each world with their pictures and numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from turtlebag.datasets.plurals import counted
from turtlebag.reports.figures.album import Album, Picture
from turtlebag.reports.interactive_map import InteractiveMap, interactive_map
from turtlebag.reports.kinds import KINDS, stage_metrics, verdict
from turtlebag.reports.metric_specs import GOAL_NUMBERS, PICTURE_SOURCES, Section
from turtlebag.reports.metrics.navigation import outcome
from turtlebag.reports.numbers import DASH, Number, files_of, lookup, other_values, sections_of, shown
from turtlebag.reports.parameters import parameter_rows
from turtlebag.reports.stage_titles import slug
from turtlebag.reports.stages import Group, Stage
from turtlebag.reports.system_comparison import SystemComparison
from turtlebag.reports.verdicts import GOOD

SENSOR_UNITS = {"m": "mm", "rad": "deg", "rad/m": "deg/m", "rad/s": "deg/s", "s": "s"}
"""The unit that a number of the sensor set-up is shown in."""


@dataclass(frozen=True, eq=False)
class Part:
    """One stage on the page."""

    stage: Stage
    about: str
    verdict: tuple[str, str]
    metrics: Mapping[str, Any]
    sections: list[tuple[Section, list[Number]]]
    others: list[tuple[str, str]]
    pictures: list[Picture]
    goals: list[Mapping[str, Any]]
    planners: list[Mapping[str, Any]]
    findings: list[Mapping[str, Any]]
    """What is wrong with the recording that the stage read."""
    sensors: list[list[str]]
    """The estimated set-up: name, value, 95 % interval, and what the recording says."""

    @property
    def believed(self) -> bool:
        """Whether the stage itself took itself for a success."""
        return bool(self.metrics.get("success", self.verdict[0] == GOOD))

    @property
    def contents(self) -> str:
        """What the stage unfolds to."""
        more = len(self.pictures) - 1
        counts = {"goal": len(self.goals), "planner": len(self.planners), "number": len(self.numbers)}
        told = [counted(more, "more picture")] if more > 0 else []
        told += [counted(count, noun) for noun, count in counts.items() if count]
        return ", ".join(told) or "details"

    @property
    def numbers(self) -> list[Number]:
        """The numbers of all sections."""
        return [number for _, numbers in self.sections for number in numbers]

    def picture_files(self, picture: Picture) -> list[tuple[str, str]]:
        """Files a picture was drawn from, with their sha256."""
        ending = f"{self.stage.kind}-{picture.name.rpartition('-')[2]}"
        sources = PICTURE_SOURCES.get(ending) or PICTURE_SOURCES.get(self.stage.kind, [])
        return sorted(files_of(self.stage, sources).items())

    @property
    def goal_files(self) -> list[tuple[str, str]]:
        """Files the table of goals is computed from, with their sha256."""
        return sorted(files_of(self.stage, GOAL_NUMBERS[0].sources).items())


@dataclass(frozen=True, eq=False)
class Chapter:
    """One world (or log) on the page; `systems` is what other systems made of it."""

    name: str
    interactive_map: InteractiveMap | None
    parts: list[Part] = field(default_factory=list)
    systems: SystemComparison | None = None

    @property
    def anchor(self) -> str:
        """Fragment of the page's address."""
        return slug(self.name)

    @property
    def metrics(self) -> Mapping[str, Mapping[str, Any]]:
        """Its numbers by stage, those of other systems under `systems`."""
        numbers = {part.stage.label: part.metrics for part in self.parts}
        return numbers if self.systems is None else {**numbers, "systems": self.systems.metrics}


def build_chapter(
    group: Group, album: Album, measured: Mapping[str, Mapping[str, Any]] | None = None
) -> Chapter:
    """Draw and describe every stage of a group; `measured` by label takes the place of its metrics."""
    chapter = Chapter(group.name, interactive_map_of(group))
    known: dict[Stage | None, float | None] = {}  # what the wheels alone came to in each recording
    for stage in group.stages:
        metrics = stage_metrics(stage) if measured is None else measured[stage.label]
        known[stage] = lookup(metrics, "odometry_ate_m.rmse")
        chapter.parts.append(
            Part(
                stage,
                _about(stage, group),
                verdict(stage, metrics, known.get(group.record_of(stage))),
                metrics,
                sections_of(stage, metrics, group.name),
                other_values(stage, metrics),
                _drawn(stage, group, album),
                goal_rows(metrics),
                metrics.get("planners") or [],
                stage.metrics.get("findings") or [],
                parameter_rows(metrics["parameters"]) if "parameters" in metrics else sensor_rows(metrics),
            )
        )
    return chapter


def sensor_rows(metrics: Mapping[str, Any]) -> list[list[str]]:
    """The table of the sensor set-up, a row a number."""
    rows = []
    for name, of in (metrics.get("sensors") or {}).items():
        unit = SENSOR_UNITS.get(of["unit"], "plain")
        value, low, high, said = (
            shown(number, unit) for number in (of["value"], *of["interval_95"], of.get("declared"))
        )
        estimate = [value, f"{low} to {high}"] if of["observable"] else ["not observable", DASH]
        rows.append([name.replace("_", " "), *estimate, said])
    return rows


def _drawn(stage: Stage, group: Group, album: Album) -> list[Picture]:
    """The pictures of one stage, named by world and stage."""
    before = len(album.pictures)
    prefix = f"{slug(group.name)}-{slug(stage.label)}-"
    KINDS[stage.kind].draw(stage, group, replace(album, prefix=prefix))
    return album.pictures[before:]


def _about(stage: Stage, group: Group) -> str:
    """Robot and world: `burger in turtlebot3_world`."""
    record = group.record_of(stage)
    robot = stage.fact("robot") or (record.fact("robot") if record is not None else None)
    return f"{robot} in {group.name}" if robot else group.name


def interactive_map_of(group: Group) -> InteractiveMap | None:
    """The map of a group for the mouse: what a run with goals was given, else the built one, else the true
    one; with what was driven on it.
    """
    built, record, runs = group.first("map"), group.first("record"), group.of_kind("navigate")
    with_goals = next((run for run in runs if run.metrics.get("goals")), None)
    given = group.given_map(with_goals) if with_goals else None
    grids = [given, built.map if built else None]
    grids += [stage.true_map for stage in (record, *runs) if stage]
    grid = next((grid for grid in grids if grid is not None), None)
    if grid is None:
        return None
    if with_goals is None:
        return interactive_map(grid, {"SLAM path": ("slam", built.trajectory if built else None)}, [])
    believed = "estimate" if with_goals.localised else "odometry"
    paths = {
        f"true path ({with_goals.title})": ("truth", with_goals.truth),
        believed: ("estimate", with_goals.trajectory),
    }
    return interactive_map(grid, paths, with_goals.metrics["goals"])


def goal_rows(metrics: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The goals of a run as table rows: texts as shown."""
    rows: list[Mapping[str, Any]] = []
    for number, goal in enumerate(metrics.get("goals") or [], start=1):
        x, y, yaw = (goal.get(name) for name in ("x", "y", "yaw"))
        rows.append(
            {
                "number": number,
                "pose": f"{shown(x, 'm')}, {shown(y, 'm')}, {shown(yaw, 'deg')}",
                "status": str(goal.get("status")),
                "outcome": outcome(goal),
                "truth": {"reached": "there", "elsewhere": "elsewhere"}.get(outcome(goal), DASH),
                "reason": goal.get("reason") or "",
                "numbers": [
                    (spec, goal.get(spec.path), shown(goal.get(spec.path), spec.unit))
                    for spec in GOAL_NUMBERS
                ],
            }
        )
    return rows
