"""What a report says, before it is laid out: the parts of each world with their pictures and numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from turtlebag.datasets.plurals import counted
from turtlebag.reports.drawing import draw_localise, draw_map, draw_plan, draw_record, draw_run
from turtlebag.reports.figures.album import Album, Picture
from turtlebag.reports.interactive_map import InteractiveMap, interactive_map
from turtlebag.reports.metric_specs import GOAL_NUMBERS, PICTURE_SOURCES, Section
from turtlebag.reports.metrics.navigation import goal_counts, outcome, truly_reached
from turtlebag.reports.metrics.trajectory import recording_metrics
from turtlebag.reports.numbers import DASH, Number, files_of, lookup, other_values, sections_of, shown
from turtlebag.reports.stage_titles import slug
from turtlebag.reports.stages import Group, Stage
from turtlebag.reports.system_comparison import SystemComparison

DRAW = {
    "record": draw_record,
    "map": draw_map,
    "localise": draw_localise,
    "plan": draw_plan,
    "navigate": draw_run,
}
GOOD, BAD, NEUTRAL = "good", "bad", "neutral"
GOOD_WALLS = 0.99
"""A map is good when this share of its wall cells lies within one cell of a true surface."""


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
        return sorted(files_of(self.stage, PICTURE_SOURCES.get(ending, ())).items())

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
                draw(stage, group, album),
                goal_rows(metrics),
                metrics.get("planners") or [],
                stage.metrics.get("findings") or [],
            )
        )
    return chapter


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


def draw(stage: Stage, group: Group, album: Album) -> list[Picture]:
    """The pictures of one stage, named by world and stage."""
    before = len(album.pictures)
    prefix = f"{slug(group.name)}-{slug(stage.label)}-"
    DRAW[stage.kind](stage, group, replace(album, prefix=prefix))
    return album.pictures[before:]


def stage_metrics(stage: Stage) -> Mapping[str, Any]:
    """A stage's metrics.json, or for a recording what is computed from its bag."""
    if stage.kind == "record" and stage.truth is not None:
        return {**stage.metrics, **recording_metrics(stage.driven, stage.odometry, stage.truth)}
    goals = stage.metrics.get("goals")
    return {**stage.metrics, **goal_counts(goals)} if goals else stage.metrics


def verdict(stage: Stage, metrics: Mapping[str, Any], odometry_m: float | None = None) -> tuple[str, str]:
    """(good, bad or neutral; one sentence); `odometry_m` is the error that a map had to put right."""
    if stage.kind == "map":
        return _map_verdict(metrics, odometry_m)
    others = {"navigate": _run_verdict, "localise": _localise_verdict, "plan": _plan_verdict}
    if stage.kind in others:
        return others[stage.kind](metrics)
    drift = lookup(metrics, "odometry_ate_m.max")
    length, duration = metrics.get("distance_m"), metrics.get("duration_s")
    sentence = f"{metrics.get('scans', 'No')} scans over {shown(duration, 's')} and {shown(length, 'm')}"
    return NEUTRAL, f"{sentence}; the wheel odometry drifted by up to {shown(drift, 'cm')}."


def _run_verdict(metrics: Mapping[str, Any]) -> tuple[str, str]:
    """By the truth where it is known; what the robot took to be so stands beside it where it differs."""
    goals = metrics.get("goals") or []
    hits = collision_count(metrics)
    what = [_goals_sentence(goals)] if goals else []
    what.append("no collision" if hits == 0 else counted(hits, "collision"))
    believed = bool(metrics.get("success", hits == 0))
    good = believed and bool(metrics.get("true_success", True)) and not _elsewhere(goals)
    sentence = ("; " if _elsewhere(goals) else ", ").join(what)
    return GOOD if good else BAD, f"{sentence[0].upper()}{sentence[1:]}."


def _elsewhere(goals: Sequence[Mapping[str, Any]]) -> list[float]:
    """How far the robot truly was [m] from each goal that it took to be reached and was not at."""
    return [float(goal["error_m"]) for goal in goals if outcome(goal) == "elsewhere"]


def _goals_sentence(goals: Sequence[Mapping[str, Any]]) -> str:
    """`7 of 8 goals reached (1 timeout)`; what the robot believed and the truth denies is said too."""
    reached = sum(truly_reached(goal) for goal in goals)
    away = _elsewhere(goals)
    ends = Counter(
        f"{goal.get('status')}{f': {reason}' if (reason := goal.get('reason')) else ''}"
        for goal in goals
        if goal.get("status") != "reached"
    )
    asides = [f"{count} {end}" for end, count in ends.items()]
    if len(goals) == 1:
        if away:
            return f"goal not reached: the robot reported it as reached, but was {shown(away[0], 'm')} away"
        return "goal reached" if reached else f"goal not reached ({', '.join(asides).removeprefix('1 ')})"
    if away:
        asides.insert(
            0, f"the robot reported {reached + len(away)}, but was up to {shown(max(away), 'm')} away"
        )
    return f"{reached} of {len(goals)} goals reached" + (f" ({'; '.join(asides)})" if asides else "")


def _map_verdict(metrics: Mapping[str, Any], odometry_m: float | None) -> tuple[str, str]:
    scans = metrics.get("scans", "?")
    near = lookup(metrics, "map.occupied_error_m.within_one_cell")
    fitted = metrics.get("fitted")
    ate = lookup(metrics, "ate_m.rmse" if fitted is None else "ate_aligned_m.rmse")
    relations = lookup(metrics, "relations.trans_m.mean")
    if near is not None and ate is not None:
        after = "" if fitted is None else f" after a fit: {fitted}"
        alone = f" (odometry alone: {shown(odometry_m, 'cm')})" if odometry_m is not None else ""
        sentence = (
            f"{shown(near, 'percent')} of the wall cells lie within one cell of a true surface; "
            f"trajectory error {shown(ate, 'cm')} RMSE{alone}{after}."
        )
        return (GOOD if near >= GOOD_WALLS else BAD), sentence
    if relations is not None:
        return NEUTRAL, f"{scans} scans; mean relations error {shown(relations, 'm4')}."
    sentence = f"{scans} scans; no ground truth was given, so the error is unknown"
    check = lookup(metrics, "self_check.verdict")
    return NEUTRAL, sentence + (f"; self-check: {check}." if check else ".")


def _plan_verdict(metrics: Mapping[str, Any]) -> tuple[str, str]:
    compared = metrics.get("planners") or []
    if compared:
        found = sum(bool(entry.get("success")) for entry in compared)
        good = bool(metrics.get("success", found))
        sentence = f"{found} of {len(compared)} planners found a path; the chosen one "
        return GOOD if good else BAD, sentence + ("did." if good else "did not.")
    if not metrics.get("success", True):
        return BAD, f"No path was found: {metrics.get('reason') or 'no reason is given'}."
    length = metrics.get("length_m")
    return GOOD, f"A path of {shown(length, 'm')} was found." if length is not None else "A path was found."


def _localise_verdict(metrics: Mapping[str, Any]) -> tuple[str, str]:
    error = lookup(metrics, "localisation_error_m.rmse")
    known = f", {shown(error, 'cm')} RMSE from the truth" if error is not None else ""
    believed = bool(metrics.get("success", True))
    good = believed and bool(metrics.get("true_success", True))
    status = str(metrics.get("status", "localised"))
    if believed and not good:
        off = shown(metrics.get("last_error_m"), "m")
        status = f"not localised: the filter reported success, but was {off} off at the end"
    reason = f": {metrics['reason']}" if metrics.get("reason") else ""
    return (GOOD if good else BAD), f"{status[0].upper()}{status[1:]}{reason}{known}."


def overall_mood(moods: Iterable[str]) -> str:
    """Bad where one is, else good where one is."""
    found = set(moods)
    return next((mood for mood in (BAD, GOOD) if mood in found), NEUTRAL)


def collision_count(metrics: Mapping[str, Any]) -> int:
    """All contact episodes of a run."""
    collisions = metrics.get("collisions", 0)
    if isinstance(collisions, Mapping):
        return int(collisions.get("visible", 0)) + int(collisions.get("low", 0))
    return int(collisions or 0)


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
