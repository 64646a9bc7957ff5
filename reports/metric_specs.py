"""Which numbers a report shows of each stage, and what each of them is: what metric_specs.yaml says."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib.resources import files
from typing import Annotated, Any, Literal

from pydantic import Field

from turtlebag.datasets.settings import Settings
from turtlebag.datasets.yaml_files import plain_values

MORE_IS_BETTER = (
    "iou",
    "iou_one_cell",
    "coverage",
    "within_one_cell",
    "true_success",
    "goals_truly_reached",
    "min_clearance_m",
)
"""Last parts of paths."""
LESS_IS_BETTER = ("rmse", "max", "mean", "p95", "trans_m", "rot_rad", "visible", "low", "time_s")


class MetricSpec(Settings):
    """A number by its dotted path in the metrics, as metric_specs.yaml describes it."""

    path: str
    label: str
    unit: str
    meaning: str
    sources: tuple[str, ...] = ()
    topics: tuple[str, ...] = ()
    against: tuple[Literal["truth", "relations"], ...] = ()
    trusted: bool = False
    seldom: bool = False
    evo: str = ""
    judged: bool = True
    tolerance: Annotated[float, Field(ge=0.0)]
    """By how much it may differ where it is computed on another machine, in the unit it is stored in."""

    @property
    def sense(self) -> int:
        """1 where more is better, -1 where less is, 0 where neither."""
        last = self.path.rpartition(".")[2]
        return (last in MORE_IS_BETTER) - (last in LESS_IS_BETTER)


class Section(Settings):
    """Numbers under one heading; `hint` says how to read them."""

    title: str
    hint: str = ""
    specs: tuple[MetricSpec, ...]


def sections(told: Mapping[str, Any]) -> Iterator[tuple[str, tuple[Section, ...]]]:
    """The sections of each stage, of all systems and of a goal; ValueError for unknown keys."""
    known: dict[str, dict[str, Any]] = {}
    for kind, parts in told.items():
        found = []
        for part in parts:
            heading = dict(part)
            numbers = heading.pop("numbers")
            common: dict[str, Any] = {"sources": (), "topics": (), "against": ()}
            common |= {name: heading.pop(name) for name in (*common, "tolerance") if name in heading}
            specs = []
            for path, entry in numbers.items():
                whole = entry if "label" in entry else {**known[path], **entry}
                known.setdefault(path, whole)
                specs.append(MetricSpec(path=path, **{**common, **whole}))
            found.append(Section(**heading, specs=tuple(specs)))
        yield kind, tuple(found)


_told = plain_values((files("turtlebag.reports") / "metric_specs.yaml").read_text("utf-8"))
PICTURE_SOURCES: dict[str, list[str]] = _told.pop("pictures")
SECTIONS = dict(sections(_told))
SYSTEMS, (_goals,) = SECTIONS.pop("systems"), SECTIONS.pop("goals")
GOAL_NUMBERS = _goals.specs
SPECS = {kind: tuple(spec for part in parts for spec in part.specs) for kind, parts in SECTIONS.items()}

TOLERANCES = {kind: {spec.path: spec.tolerance for spec in specs} for kind, specs in SPECS.items()}
TOLERANCES["systems"] = {spec.path: spec.tolerance for part in SYSTEMS for spec in part.specs}
TOLERANCES["goals"] = {spec.path: spec.tolerance for spec in GOAL_NUMBERS}
OTHER_TOLERANCE = 0.05
"""As a share, of numbers that are not shown."""


def tolerance_of(kind: str, path: str, value: object) -> float:
    """By how much a number may differ from the same, computed on another machine."""
    parts = path.split(".")
    if parts[0] == "goals":
        kind, path = "goals", parts[-1]
    elif kind == "systems":
        path = ".".join(parts[2:])  # systems.NAME.PATH
    known = TOLERANCES.get(kind, {}).get(path)
    if known is not None:
        return known
    return OTHER_TOLERANCE * abs(value) if isinstance(value, int | float) else 0.0
