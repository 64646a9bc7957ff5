"""The registry of numbers, metric_specs.yaml: its keys, and whether the metrics have what it names."""

import re
from dataclasses import fields
from pathlib import Path
from typing import get_args, get_origin, get_type_hints, is_typeddict

import pytest

from turtlebag.pipeline.slam.check.size import Size
from turtlebag.pipeline.slam.check.verdict import SelfCheck
from turtlebag.pipeline.slam.sensors.range_calibration import RangeCalibration
from turtlebag.pipeline.stages.map_summary import loop_counts
from turtlebag.pipeline.stages.plan import PlanMetrics
from turtlebag.reports import drawing
from turtlebag.reports.metric_specs import GOAL_NUMBERS, PICTURE_SOURCES, SECTIONS, SPECS, SYSTEMS, sections
from turtlebag.reports.metrics.map import MapMetrics
from turtlebag.reports.metrics.navigation import GoalMetrics, LocalisationErrors, RunMetrics, goal_counts
from turtlebag.reports.metrics.references import MapErrors
from turtlebag.reports.metrics.systems import Numbers, PathErrors
from turtlebag.reports.metrics.trajectory import RecordingMetrics
from turtlebag.reports.numbers import UNITS, leaves


def paths(kind, at=""):
    """Dotted paths of the leaves of a TypedDict; a list is one."""
    for name, hint in get_type_hints(kind).items():
        options = (hint,) if get_origin(hint) is list else (hint, *get_args(hint))
        inner = [one for one in options if is_typeddict(one)]
        yield from paths(inner[0], f"{at}{name}.") if inner else [f"{at}{name}"]


IN_METRICS = {
    "record": {*paths(RecordingMetrics)},
    "map": {
        *("scans", "keyframes", "log_s", "odometry_late_s"),
        *(f"self_check.{field.name}" for field in fields(SelfCheck)),
        *(path for path, _ in leaves(Size().as_metrics(), "self_check")),
        *(f"loops.{name}" for name in loop_counts([])),
        *(path for path, _ in leaves(RangeCalibration(1.0, 1.0).as_metrics())),
        *paths(MapErrors),
    },
    "localise": {*paths(LocalisationErrors), "success", "scans", "updates", "converged.share"},
    "identify": {"scans", "log_s", "observable"},
    "twin": {"scans", "log_s", "drives", "compared", "differ"},
    "plan": {*paths(PlanMetrics)},
    "navigate": {*paths(RunMetrics), *goal_counts([])},
    "systems": {*paths(Numbers), *paths(PathErrors, "ours_there."), *paths(MapMetrics, "map.")},
    "goals": {*paths(GoalMetrics)},
}


def specs():
    known = {**SPECS, "systems": [spec for part in SYSTEMS for spec in part.specs], "goals": GOAL_NUMBERS}
    return [(kind, spec) for kind, found in known.items() for spec in found]


def test_every_number_is_in_the_metrics_of_its_stage_and_has_a_known_unit():
    assert {*SECTIONS} == {*IN_METRICS} - {"systems", "goals"}
    assert [f"{kind}: {spec.path}" for kind, spec in specs() if spec.path not in IN_METRICS[kind]] == []
    assert [spec.path for _, spec in specs() if spec.unit not in UNITS] == []


def test_every_picture_of_the_registry_is_drawn():
    drawn = re.findall(r'album\.add\w*\(\s*"(\w+)"', Path(drawing.__file__).read_text())
    assert {*PICTURE_SOURCES} - {*SECTIONS} <= {f"{kind}-{name}" for kind in SECTIONS for name in drawn}


NUMBER = {"label": "n", "unit": "m", "meaning": "N."}
PART = {"title": "A", "sources": ["a"], "tolerance": 0.1, "numbers": {"n": NUMBER}}


@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({"hnit": "How to read it."}, "hnit"),
        ({"source": ["a"]}, "source"),
        ({"against": ["thruth"]}, "against"),
        ({"numbers": {"n": {**PART["numbers"]["n"], "seldum": True}}}, "seldum"),
        ({"numbers": {"n": {"label": "n", "unit": "m"}}}, "meaning"),
        ({"tolerance": -1.0}, "tolerance"),
    ],
)
def test_a_misspelt_key_is_an_error(changes, where):
    assert len(dict(sections({"map": [PART]}))["map"]) == 1
    with pytest.raises(ValueError, match=where):
        dict(sections({"map": [{**PART, **changes}]}))
