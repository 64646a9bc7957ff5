"""What a map or a path is measured against: a recording's truth, a benchmark's relations."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypedDict

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.ground_truth import TruePose
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.output_rules import is_output
from turtlebag.datasets.relations import Relations, load_relations
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.trajectories import load_tum
from turtlebag.datasets.types import Trajectory
from turtlebag.reports.metrics.map import MapMetrics, map_metrics
from turtlebag.reports.metrics.relations import RelationErrors, relations_metrics
from turtlebag.reports.metrics.trajectory import (
    Drift,
    TrajectoryErrors,
    associate,
    fit_rigid,
    rpe,
    trajectory_metrics,
)

APART_M, APART_RAD = 0.1, 0.1
"""Farther from its true pose no estimate begins: the frames differ. No drift is like this in one scan."""


class FrontEndErrors(TypedDict):
    """What a truth says of poses before any loop is closed."""

    rpe: Drift


class MapErrors(TrajectoryErrors, RelationErrors, total=False):
    """The contract's keys for what a map was measured against; `fitted` says why its walls were laid on the
    true ones by the fit of the trajectory."""

    map: MapMetrics
    fitted: str
    front_end: FrontEndErrors


@dataclass(frozen=True, eq=False)
class References:
    """Any of them may be missing; `inputs` are the files they were read from."""

    truth: Trajectory | None = None
    true_grid: OccupancyGrid | None = None
    relations: Relations | None = None
    inputs: dict[str, Path] = field(default_factory=dict)

    @staticmethod
    def load(truth: Path | None, relations: Path | None = None) -> References:
        """A record's `truth` folder (or the record), and a benchmark's file; InputError for what is none."""
        folder = None if truth is None else truth_folder(truth)
        true_map = None if folder is None else folder / "map.yaml"
        named = {"truth": folder, "relations": relations}
        return References(
            None if folder is None else load_tum(folder / "trajectory.tum"),
            load_map(true_map) if true_map is not None and true_map.exists() else None,
            None if relations is None else load_relations(relations),
            {name: path for name, path in named.items() if path is not None},
        )

    @property
    def true_pose(self) -> TruePose | None:
        """The true pose of each scan, where there is one for each."""
        truth, file = self.truth, self.inputs.get("truth", "truth")

        def pose(scan: int) -> SE2:
            if truth is None or scan >= len(truth):
                raise InputError(f"{file}: does not have one pose for each scan")
            return truth.poses[scan]

        return None if truth is None else pose

    def errors(
        self,
        trajectory: Trajectory,
        grid: OccupancyGrid | None,
        *,
        odometry: bool = True,
        before_loops: Trajectory | None = None,
    ) -> MapErrors:
        """How far a map is off, `odometry`: made with some, and how its poses drifted `before_loops`;
        InputError for truth or relations of another recording."""
        found: MapErrors = {}
        if self.truth is not None:
            try:
                found.update(trajectory_metrics(trajectory, self.truth))
                if before_loops is not None:
                    found["front_end"] = {"rpe": rpe(before_loops, self.truth)}
            except ValueError as error:
                raise InputError(f"{self.inputs.get('truth', 'truth')}: {error}") from None
            T_world_map = _frame(trajectory, self.truth)
            if T_world_map is not None:
                found["fitted"] = OWN_FRAME if odometry else NO_ODOMETRY
            if self.true_grid is not None and grid is not None:
                found["map"] = map_metrics(_moved(grid, T_world_map), self.true_grid)
        if self.relations is not None:
            found.update(relations_metrics(trajectory, self.relations))
            if found["relations"]["n"] == 0:
                file = self.inputs.get("relations", "relations")
                raise InputError(f"{file}: no relation in it is between two scans of this recording")
        return found


OWN_FRAME = "the map does not begin where the truth does"
NO_ODOMETRY = "the recording has no odometry, so the map has a frame of its own"


def _frame(trajectory: Trajectory, truth: Trajectory) -> SE2 | None:
    """The map's frame in that of the truth, by a rigid fit; None where they are the same."""
    pairs = associate(trajectory, truth)
    if pairs.position_errors()[0] <= APART_M and pairs.yaw_errors()[0] <= APART_RAD:
        return None
    return fit_rigid(pairs.T_map_base.xy, pairs.T_world_base.xy)


def _moved(grid: OccupancyGrid, T_world_map: SE2 | None) -> OccupancyGrid:
    return grid if T_world_map is None else replace(grid, T_map_grid=T_world_map @ grid.T_map_grid)


NO_REFERENCES = References()


def truth_folder(path: Path) -> Path:
    """The truth folder of a record, given itself or the record; InputError when there is none.

    A trajectory beside a manifest of ours is an estimate: what would be measured against itself is perfect.
    """
    found = [folder for folder in (path, path / "truth") if (folder / "trajectory.tum").is_file()]
    for folder in found:
        if not is_output(folder):
            return folder
    if found:
        raise InputError(
            f"{path}: holds an estimate, not the truth (expected the truth/ folder of a recording)"
        )
    raise InputError(f"{path}: no truth found (expected trajectory.tum in it or in its truth/)")
