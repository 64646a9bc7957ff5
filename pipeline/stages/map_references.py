"""What a map is measured against: a recording's truth, a benchmark's relations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.relations import load_relations
from turtlebag.datasets.trajectories import load_tum
from turtlebag.datasets.types import Trajectory
from turtlebag.reports.metrics.map import map_metrics
from turtlebag.reports.metrics.relations import relations_metrics
from turtlebag.reports.metrics.trajectory import trajectory_metrics


class References:
    """What the result is measured against, read and checked before the work starts."""

    def __init__(self, truth: Path | None, relations: Path | None) -> None:
        self._truth_folder = _truth_folder(truth) if truth is not None else None
        self._relations_file = relations
        self._relations = load_relations(relations) if relations is not None else None
        if self._truth_folder is not None:
            self._true_poses = load_tum(self._truth_folder / "trajectory.tum")
            true_map = self._truth_folder / "map.yaml"
            self._true_grid = load_map(true_map) if true_map.exists() else None

    def inputs(self) -> dict[str, Path]:
        """Paths for the manifest."""
        named = {"truth": self._truth_folder, "relations": self._relations_file}
        return {name: path for name, path in named.items() if path is not None}

    def metrics(self, trajectory: Trajectory, grid: OccupancyGrid) -> dict[str, Any]:
        """The contract's keys for what was given."""
        found: dict[str, Any] = {}
        if self._truth_folder is not None:
            try:
                found |= trajectory_metrics(trajectory, self._true_poses)
            except ValueError as error:
                raise InputError(f"{self._truth_folder}: {error}") from None
            if self._true_grid is not None:
                found["map"] = map_metrics(grid, self._true_grid)
        if self._relations is not None:
            found |= relations_metrics(trajectory, self._relations)
        return found


def _truth_folder(path: Path) -> Path:
    for folder in (path, path / "truth"):
        if (folder / "trajectory.tum").is_file():
            return folder
    raise InputError(f"{path}: no truth found (expected trajectory.tum in it or in its truth/)")
