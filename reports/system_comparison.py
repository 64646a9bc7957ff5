"""Several systems on one recording, side by side: a table, notes and pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypedDict

from turtlebag.datasets.other_systems import OURS
from turtlebag.datasets.trajectories import save_tum_3d
from turtlebag.reports.figures import systems as figures
from turtlebag.reports.figures.album import Album, Picture
from turtlebag.reports.figures.series import AXIS_TOLD
from turtlebag.reports.metric_specs import SYSTEMS, MetricSpec
from turtlebag.reports.metrics.references import References
from turtlebag.reports.metrics.systems import Measured, Numbers
from turtlebag.reports.numbers import Row, lookup, shown


@dataclass(frozen=True)
class Beside(Row):
    """One number of all systems, and how the best of them is shown, if one is."""

    best: str | None


class SystemsMetrics(TypedDict):
    """What systems were measured against, `truth` or ours, and the numbers of each."""

    reference: str
    map_reference: str
    systems: Mapping[str, Numbers]


@dataclass(frozen=True, eq=False)
class SystemComparison:
    """What a page says of several systems: `metrics` are its numbers, keyed `systems.NAME.PATH`."""

    metrics: SystemsMetrics
    notes: list[tuple[str, str]]
    pictures: list[Picture] = field(default_factory=list)

    @property
    def names(self) -> list[str]:
        """The systems, ours first."""
        return list(self.metrics["systems"])

    @property
    def judged_by_truth(self) -> bool:
        """Whether a true path is known; if not, the others are measured against ours."""
        return self.metrics["reference"] == "truth"

    @property
    def sections(self) -> list[tuple[str, str, list[Beside]]]:
        """(title, hint, rows) of what at least one system has a number for."""
        words = {
            "reference": "the truth" if self.judged_by_truth else OURS,
            "map_reference": "the true surfaces"
            if self.metrics["map_reference"] == "truth"
            else f"the map of {OURS}",
        }
        apart = f" The truth is not known: these are distances to {OURS}, not errors."
        words["apart"] = "" if self.judged_by_truth else apart
        found = []
        for section in SYSTEMS:
            rows = [self._row(spec) for spec in section.specs]
            rows = [row for row in rows if any(value is not None for value in row.values)]
            if rows:
                found.append((section.title, section.hint.format(**words), rows))
        return found

    @property
    def rows(self) -> list[Beside]:
        """Those of all sections."""
        return [row for _, _, rows in self.sections for row in rows]

    def _row(self, spec: MetricSpec) -> Beside:
        values = [lookup(numbers, spec.path) for numbers in self.metrics["systems"].values()]
        known = [(value, shown(value, spec.unit)) for value in values if value is not None]
        judged = spec.judged and self._is_error(spec.path)
        judged = judged and len({text for _, text in known}) > 1
        return Beside(spec, values, (max if spec.sense > 0 else min)(known)[1] if judged else None)

    @property
    def sentence(self) -> str:
        """The outcome in a sentence."""
        for path, unit, what in (
            ("ate_aligned_m.rmse", "cm", "Distance to the truth after a fit, RMSE"),
            ("relations.trans_m.mean", "m4", "Mean relations error"),
            ("map.occupied_error_m.within_one_cell", "percent", "Wall cells within one cell of a surface"),
        ):
            told = self._told(path, unit)
            if len(told) > 1 and self._is_error(path):
                return f"{what}: {', '.join(told)}."
        apart = self._told("ate_aligned_m.rmse", "cm")
        if apart and not self.judged_by_truth:
            return f"Distance to {OURS} after a fit, RMSE: {', '.join(apart)}; the truth is not known."
        near = self._told("map.occupied_error_m.within_one_cell", "percent")
        if near and not self._is_error("map."):
            on_ours = f"Wall cells within one cell of those of {OURS}: {', '.join(near)}"
            return f"{on_ours}; the true walls are not known."
        return "No number of another system could be computed."

    def _is_error(self, path: str) -> bool:
        """Whether a number is measured against something better than ours."""
        if path.startswith("relations"):
            return True
        if path.startswith("map."):
            return self.metrics["map_reference"] == "truth"
        return self.judged_by_truth

    def _told(self, path: str, unit: str) -> list[str]:
        values = {name: lookup(numbers, path) for name, numbers in self.metrics["systems"].items()}
        return [f"{name} {shown(value, unit)}" for name, value in values.items() if value is not None]


def compare_systems(
    measured: Sequence[Measured], known: References, album: Album, prefix: str
) -> SystemComparison:
    """The numbers, notes and pictures of measured systems, ours first."""
    metrics: SystemsMetrics = {
        "reference": OURS if known.truth is None else "truth",
        "map_reference": OURS if known.true_grid is None else "truth",
        "systems": {one.system.name: one.numbers for one in measured},
    }
    notes = [(one.system.name, note) for one in measured for note in one.notes]
    before = len(album.pictures)
    _draw(measured, known, replace(album, prefix=f"{prefix}-"))
    return SystemComparison(metrics, notes, album.pictures[before:])


def _draw(measured: Sequence[Measured], known: References, album: Album) -> None:
    paths = {one.system.name: one.path for one in measured if one.path is not None}
    reference = "the truth" if known.truth is not None else OURS
    ground = known.true_grid if known.true_grid is not None else measured[0].grid
    if len(paths) > 1:
        caption = f"All paths, each moved as a whole to lie on {reference} best."
        album.add("paths", "Paths", caption, figures.paths, ground, known.truth, paths)
    errors = {
        one.system.name: (one.paired.estimate.stamps_ns, one.paired.errors_in_plane())
        for one in measured
        if one.paired is not None and (known.truth is not None or one is not measured[0])
    }
    if len(paths) > 1 and errors:
        caption = (
            f"Distance to {reference} after the fit in the plane; a gap is where a system has no poses. "
            f"{AXIS_TOLD}"
        )
        title = "Distance over time" if known.truth is None else "Error over time"
        album.add("time", title, caption, figures.errors, errors, list(paths), f"to {reference} [cm]")
    ours = measured[0].grid
    for number, one in enumerate(measured[1:], start=1):
        if ours is not None and one.grid is not None:
            name = one.system.name
            caption = (
                f"Walls of both maps: grey where they agree to a cell, coloured where only {OURS} or only "
                f"{name} has one."
            )
            drawn = (ours, one.grid, (OURS, name), number)
            album.add(f"walls-{name.lower()}", f"Walls: {name}", caption, figures.walls, *drawn)


def write_pairs(measured: Sequence[Measured], folder: Path) -> None:
    """The paired poses of each system and of its reference as TUM files, for evo."""
    folder.mkdir()
    for one in measured:
        if one.paired is not None and "paired" in one.numbers:
            name, pairs = one.system.name, one.paired
            save_tum_3d(pairs.estimate.stamps_ns, pairs.estimate.T, folder / f"{name}.tum")
            save_tum_3d(pairs.reference.stamps_ns, pairs.reference.T, folder / f"{name}.reference.tum")
