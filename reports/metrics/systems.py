"""The numbers of several systems on one recording, all by the same functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TypedDict

import numpy as np

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.other_systems import System, coverage, covered, gaps
from turtlebag.datasets.relations import Relations
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.se3 import lifted
from turtlebag.datasets.trajectories import stamp_text
from turtlebag.datasets.trajectories_3d import Trajectory3D
from turtlebag.datasets.types import Trajectory
from turtlebag.reports.metrics import evo
from turtlebag.reports.metrics.map import MapMetrics, map_metrics, visible_surface, walls
from turtlebag.reports.metrics.map_alignment import Placed, place
from turtlebag.reports.metrics.references import References
from turtlebag.reports.metrics.relations import MATCH_NS, RelationErrors, nearest, relations_metrics
from turtlebag.reports.metrics.trajectory import Drift, rpe

WHOLE = 0.95
"""A system that covers less of the recording is compared over its own part too."""
LAID = 0.5
"""Maps of which less than this share of the walls can be laid on each other are said to differ."""


class PathErrors(TypedDict, total=False):
    """Errors of `paired` poses; angles in degrees where evo's are."""

    paired: int
    ate_m: evo.Statistics
    ate_aligned_m: evo.Statistics
    ate_aligned_3d_m: evo.Statistics
    rpe: Drift
    rpe_frame: evo.Relative
    rpe_metre: evo.Relative


class Numbers(PathErrors, RelationErrors, total=False):
    """The numbers of one system; `ours_there` are ours over the part of the drive that it has."""

    poses: int
    coverage: float
    ours_there: PathErrors | None
    map: MapMetrics
    map_moved: list[float]


@dataclass(frozen=True, eq=False)
class Measured:
    """One system with its numbers, and moved to where it fits the reference best.

    `path` is its trajectory and `grid` its map in the reference's frame; `paired` are its poses beside the
    reference's, not moved.
    """

    system: System
    numbers: Numbers
    notes: list[str] = field(default_factory=list)
    paired: evo.Paired | None = None
    path: Trajectory | None = None
    grid: OccupancyGrid | None = None


def measure(ours: System, others: Sequence[System], known: References) -> list[Measured]:
    """Ours first, then the others, each against the truth, or where there is none against ours.

    InputError for a trajectory that cannot be paired with the reference.
    """
    reference = Trajectory3D.of(known.truth).in_time() if known.truth is not None else ours.track
    stamps = None if ours.track is None else ours.track.stamps_ns
    span = None if stamps is None else (int(stamps.min()), int(stamps.max()))
    found: list[Measured] = []
    for system in (ours, *others):
        measured = Measured(system, Numbers(), list(system.notes))
        if system.track is not None and reference is not None and span is not None:
            measured = _measure_track(system, ours, reference, span, known.relations, known.truth is not None)
        found.append(_measure_map(measured, found, known))
    return found


def _measure_track(
    system: System,
    ours: System,
    reference: Trajectory3D,
    span: tuple[int, int],
    relations: Relations | None,
    truth_known: bool,
) -> Measured:
    assert system.track is not None
    track = system.track.in_time()
    paired = evo.pair(track, reference)
    _check_paired(system.name, track, reference, paired)
    numbers = Numbers(poses=len(track), coverage=coverage(track.stamps_ns, *span))
    if truth_known or system is not ours:
        numbers.update(path_errors(paired))
    if relations is not None:
        numbers.update(relations_metrics(with_poses_at(system.track, relations), relations))
    if system is not ours and truth_known and ours.track is not None and numbers["coverage"] < WHOLE:
        whole = ours.track.in_time()
        inside = whole[covered(whole.stamps_ns, track.stamps_ns)]
        numbers["ours_there"] = path_errors(evo.pair(inside, reference)) if len(inside) > 2 else None
    path = Trajectory3D(track.stamps_ns, lifted(paired.fit_in_plane()) @ track.T).planar()
    notes = [*system.notes, *_notes(track, paired, span)] if system is not ours else []
    return Measured(system, numbers, notes, paired, path)


def path_errors(paired: evo.Paired) -> PathErrors:
    """Errors of paired poses: ATE as it is, in the plane after a rigid fit, in space after one; RPE."""
    return {
        "paired": len(paired),
        "ate_m": evo.statistics(paired.errors()),
        "ate_aligned_m": evo.statistics(paired.errors_in_plane()),
        "ate_aligned_3d_m": evo.statistics(paired.aligned().errors()),
        "rpe": rpe(paired.estimate.planar(), paired.reference.planar()),
        "rpe_frame": evo.rpe(paired, evo.by_frame(len(paired))),
        "rpe_metre": evo.rpe(paired, evo.by_metre(paired.estimate)),
    }


def _check_paired(name: str, track: Trajectory3D, reference: Trajectory3D, paired: evo.Paired) -> None:
    if len(paired) > 2:
        return
    theirs, ours = (
        f"{stamp_text(int(stamps[0]))} to {stamp_text(int(stamps[-1]))} s"
        for stamps in (track.stamps_ns, reference.stamps_ns)
    )
    begin = seconds(int(reference.stamps_ns[0] - track.stamps_ns[0]))
    raise InputError(
        f"{name}: its poses ({theirs}) and the recording ({ours}) share {len(paired)} instants; if its clock "
        f"has another origin, shift it: --system-shift {name}={begin:.6f} makes both start together"
    )


def _notes(track: Trajectory3D, paired: evo.Paired, span: tuple[int, int]) -> list[str]:
    """What a reader must know of the stamps of another system."""
    notes = []
    begin, end = span
    outside = int(np.sum((track.stamps_ns < begin - MATCH_NS) | (track.stamps_ns > end + MATCH_NS)))
    if outside:
        lie = "lies" if outside == 1 else "lie"
        notes.append(f"{outside} of its {len(track)} poses {lie} outside of the recording's time.")
    late, early = seconds(int(track.stamps_ns[0]) - begin), seconds(end - int(track.stamps_ns[-1]))
    missing = [f"{late:.1f} s at the start"] * (late > 1.0) + [f"{early:.1f} s at the end"] * (early > 1.0)
    holes = gaps(track.stamps_ns)
    if holes:
        longest = max(seconds(b - a) for a, b in holes)
        missing.append(f"{len(holes)} stretch{'es' * (len(holes) > 1)} in between (up to {longest:.1f} s)")
    if missing:
        notes.append(f"It has no poses for {', '.join(missing)}, and is judged only where it has some.")
    if paired.interpolated:
        notes.append("Its stamps are not those of the scans, so the reference was interpolated.")
    return notes


def with_poses_at(track: Trajectory3D, relations: Relations) -> Trajectory:
    """The trajectory, with interpolated poses at stamps of relations where it has none, but for gaps."""
    wanted = np.unique(np.concatenate([relations.stamps_a_ns, relations.stamps_b_ns]))
    _, met = nearest(track.stamps_ns, wanted)
    ordered = track.in_time()
    added = evo.at(ordered, wanted[~met & covered(wanted, ordered.stamps_ns)])
    both = Trajectory3D(
        np.concatenate([track.stamps_ns, added.stamps_ns]), np.concatenate([track.T, added.T])
    )
    return both.planar()


def _measure_map(measured: Measured, before: Sequence[Measured], known: References) -> Measured:
    """Lay the map on the true surfaces, or on our walls, and measure it there."""
    grid, ours = measured.system.grid, before[0] if before else measured
    reference = known.true_grid if known.true_grid is not None else ours.system.grid
    if grid is None or reference is None:
        return measured
    if known.true_grid is None and measured is ours:
        return replace(measured, grid=grid)
    surface = walls(reference)
    if known.true_grid is not None and ours.system.grid is not None:
        surface = reference.center_of(np.argwhere(visible_surface(reference, ours.system.grid)))
    placed = place(grid, surface, reference.resolution, _guesses(measured, ours, known))
    # Between grids of one lattice the closest points are no match to the cell: no move may be the better one.
    scored = [
        (at, map_metrics(at.moved(grid), reference))
        for at in (replace(placed, T_ref_map=SE2.identity()), placed)
    ]
    placed, found = max(scored, key=lambda one: one[1]["iou_one_cell"])
    numbers: Numbers = {**measured.numbers, "map": found, "map_moved": placed.T_ref_map.xyt.tolist()}
    notes = measured.notes + (_map_notes(placed, grid) if measured is not ours else [])
    return replace(measured, numbers=numbers, notes=notes, grid=placed.moved(grid))


def _guesses(measured: Measured, ours: Measured, known: References) -> list[SE2]:
    """Where a map may lie: as its own trajectory, in the same frame, with its origin where we began."""
    guesses = []
    if measured.paired is not None and measured is not ours:
        guesses.append(measured.paired.fit_in_plane())
    guesses.append(SE2.identity())
    track = ours.system.track
    if track is not None and measured is not ours:
        guesses.append(track.planar().poses[0])
    return guesses


def _map_notes(placed: Placed, grid: OccupancyGrid) -> list[str]:
    """Where the middle of a map was moved to, and how badly it fits there."""
    middle = grid.center_of(np.array(grid.shape) // 2)
    x, y = (float(value) for value in placed.T_ref_map @ middle - middle)
    yaw = float(placed.T_ref_map.yaw)
    notes = []
    if np.hypot(x, y) > grid.resolution or abs(yaw) > 0.01:
        told = f"by {x:.2f}, {y:.2f} m and turned by {np.rad2deg(yaw):.1f}°".replace("-", "\u2212")
        notes.append(f"Its map was moved {told} to align it with the other walls.")
    if not len(walls(grid)):
        notes.append("Its map has no walls.")
    elif placed.share < LAID:
        notes.append(
            f"Only {100.0 * placed.share:.0f} % of its walls could be aligned to within two cells of "
            "the others: it shows another place, or is badly bent."
        )
    return notes
