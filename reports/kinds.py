"""The kinds of output that a report shows, and what it says and draws of each: the one table of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from turtlebag.datasets.types import Trajectory
from turtlebag.reports.drawing import (
    draw_identify,
    draw_localise,
    draw_map,
    draw_plan,
    draw_record,
    draw_run,
    draw_twin,
)
from turtlebag.reports.figures.album import Album
from turtlebag.reports.metrics.navigation import goal_counts
from turtlebag.reports.metrics.trajectory import recording_metrics
from turtlebag.reports.stages import Group, Stage
from turtlebag.reports.verdicts import (
    Metrics,
    Verdict,
    identify_verdict,
    localise_verdict,
    map_verdict,
    plan_verdict,
    record_verdict,
    run_verdict,
    twin_verdict,
)


@dataclass(frozen=True)
class Kind:
    """`title` heads its part of the page, `noun` counts it; `paths` are what `path` gives of several."""

    title: str
    noun: str
    verdict: Callable[[Metrics, float | None], Verdict]
    draw: Callable[[Stage, Group, Album], None]
    paths: str
    path: Callable[[Stage], Trajectory | None]


_TRUTH, _ESTIMATE, _PLAN = attrgetter("truth"), attrgetter("trajectory"), attrgetter("plan")
KINDS = {
    "record": Kind("Recording", "recording", record_verdict, draw_record, "True paths", _TRUTH),
    "map": Kind("Mapping", "map", map_verdict, draw_map, "SLAM's paths", _ESTIMATE),
    "localise": Kind(
        "Localisation", "localisation", localise_verdict, draw_localise, "AMCL's estimates", _ESTIMATE
    ),
    "identify": Kind("Robot", "robot", identify_verdict, draw_identify, "", lambda stage: None),
    "twin": Kind("Twin", "twin", twin_verdict, draw_twin, "", lambda stage: None),
    "plan": Kind("Planning", "plan", plan_verdict, draw_plan, "The plans", _PLAN),
    "navigate": Kind("Navigation", "task", run_verdict, draw_run, "True paths", _TRUTH),
}
"""In the order of a page."""


def verdict(stage: Stage, metrics: Metrics, odometry_m: float | None = None) -> Verdict:
    """What there is to say of a stage; `odometry_m` is the error that a map had to put right."""
    return KINDS[stage.kind].verdict(metrics, odometry_m)


def stage_metrics(stage: Stage) -> Mapping[str, Any]:
    """A stage's metrics.json, or for a recording what is computed from its bag and its truth."""
    if stage.kind == "record" and stage.truth is not None:
        return {**stage.metrics, **recording_metrics(stage.odometry, stage.truth)}
    goals = stage.metrics.get("goals")
    return {**stage.metrics, **goal_counts(goals)} if goals else stage.metrics
