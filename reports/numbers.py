"""Every number a report shows: what it means, how it is displayed, and where it comes from."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from turtlebag.reports.metric_specs import SECTIONS, SPECS, MetricSpec, Section
from turtlebag.reports.stages import Stage

DASH = "\u2013"
LARGEST = 1e60
"""Its fourth power, as in the spread of a difference, is still a number."""
IN_TABLES = ("goals.", "planners.", "findings.", "sensors.", "parameters.")
"""Metrics that have a table of their own."""


class Unit(NamedTuple):
    """How a value is shown: factor from what is stored, symbol, decimals; and the unit it is stored in."""

    factor: float
    symbol: str
    digits: int
    stored: str


UNITS = {
    "mm": Unit(1000.0, "mm", 1, "m"),
    "cm": Unit(100.0, "cm", 2, "m"),
    "m": Unit(1.0, "m", 2, "m"),
    "m2": Unit(1.0, "m²", 1, "m2"),
    "m4": Unit(1.0, "m", 4, "m"),
    "cm/m": Unit(100.0, "cm/m", 2, "m/m"),
    "deg": Unit(180.0 / math.pi, "°", 2, "rad"),
    "deg/m": Unit(180.0 / math.pi, "°/m", 2, "rad/m"),
    "deg/s": Unit(180.0 / math.pi, "°/s", 2, "rad/s"),
    "deg1": Unit(1.0, "°", 3, "deg"),
    "s": Unit(1.0, "s", 1, "s"),
    "percent": Unit(100.0, "%", 1, "1"),
    "count": Unit(1.0, "", 1, "1"),
    "plain": Unit(1.0, "", 4, "1"),
    "yes": Unit(1.0, "", 0, "1"),
}


@dataclass(frozen=True, eq=False)
class Number:
    """A value of one stage with its meaning; `key` is `world/stage:path`, unique in a report."""

    key: str
    spec: MetricSpec
    value: Any
    stage: Stage

    @property
    def text(self) -> str:
        """As shown."""
        return shown(self.value, self.spec.unit)

    @property
    def stored_unit(self) -> str:
        """The unit of `value`, empty where it has none."""
        return UNITS[self.spec.unit].stored.removeprefix("1")

    @property
    def files(self) -> list[tuple[str, str]]:
        """Files that it is computed from, with their sha256."""
        found = files_of(self.stage, self.spec.sources)
        for name in self.spec.against:
            found |= {f"{name}: {path}": digest for path, digest in self.stage.hashes(name).items()}
        return sorted(found.items())


@dataclass(frozen=True)
class Row:
    """One number of several outputs, in their order; None where one has none."""

    spec: MetricSpec
    values: Sequence[float | None]

    @property
    def texts(self) -> list[str]:
        """The numbers as they are shown."""
        return [shown(value, self.spec.unit) for value in self.values]


def files_of(stage: Stage, sources: Sequence[str]) -> dict[str, str]:
    """sha256 of the stage's files that `sources` name: one, or all in a folder (`name/`) or `begin*`."""
    return {
        path: digest
        for path, digest in stage.manifest.outputs.items()
        if any(path == source or (source[-1] in "/*" and path.startswith(source[:-1])) for source in sources)
    }


def shown(value: Any, unit: str) -> str:
    """A value in the unit's display form; a dash for what is not known."""
    if not isinstance(value, (int, float)) or not math.isfinite(value):
        return DASH
    if isinstance(value, bool) or unit == "yes":
        return "yes" if value else "no"
    factor, symbol, digits, _ = UNITS["m" if unit == "cm" and abs(value) >= 1.0 else unit]
    gap = "" if symbol in ("", "°") else "\u202f"
    size = factor * value
    if symbol == "cm" and abs(size) >= 10.0:
        digits = 1
    text = f"{size:.{digits}f}"
    if not symbol and "." in text:  # a count, or the median of some
        text = text.rstrip("0").rstrip(".")
    return f"{text}{gap}{symbol}".replace("-", "\u2212")


def lookup(metrics: Mapping[str, object], path: str) -> Any:
    """The value at a dotted path; None when a step is missing."""
    node: Any = metrics
    for part in path.split("."):
        if not isinstance(node, Mapping) or part not in node:
            return None
        node = node[part]
    return node


def finite(value: Any) -> float | None:
    """A value of metrics as a number; None for what is none, or larger than anything measured."""
    return float(value) if isinstance(value, (int, float)) and abs(value) < LARGEST else None


def sections_of(stage: Stage, metrics: Mapping[str, Any], prefix: str) -> list[tuple[Section, list[Number]]]:
    """The known numbers of a stage that its metrics hold, in reading order under their headings."""
    found = []
    for section in SECTIONS[stage.kind]:
        told = [(spec, lookup(metrics, spec.path)) for spec in section.specs]
        numbers = [
            Number(f"{prefix}/{stage.label}:{spec.path}", spec, value, stage)
            for spec, value in told
            if value is not None and not isinstance(value, Mapping) and not (spec.seldom and not value)
        ]
        if numbers:
            found.append((section, numbers))
    return found


def other_values(stage: Stage, metrics: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Leaves of the metrics that are not among the numbers: (dotted path, text)."""
    named = {spec.path for spec in SPECS[stage.kind] if not (spec.seldom and not lookup(metrics, spec.path))}
    return [
        (path, DASH if value is None else f"{value:.6g}" if isinstance(value, float) else str(value))
        for path, value in leaves(metrics)
        if path not in named and not path.startswith(IN_TABLES)
    ]


def leaves(node: object, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every leaf of nested mappings and lists as (dotted path, value)."""
    if isinstance(node, Mapping):
        for key, item in node.items():
            yield from leaves(item, f"{path}.{key}" if path else str(key))
    elif isinstance(node, (list, tuple)):
        for index, item in enumerate(node):
            yield from leaves(item, f"{path}.{index}")
    else:
        yield path, node
