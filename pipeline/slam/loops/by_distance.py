"""Loop search by distance: revisits of a known place, offline and online.

Candidates lie within the drift along the graph (`drift`); each is searched
exhaustively (a few key scans together against the older place's field), aligned by a `LoopMatch`, and
accepted only after the checks of `acceptance`.
A loop has no information along unobservable directions, and enters the graph with a heavy-tailed kernel.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from turtlebag.datasets.parts import chosen, part_of
from turtlebag.datasets.se2 import SE2, Array, between
from turtlebag.datasets.settings import Settings
from turtlebag.pipeline.slam.graph.back_end import BackEnd
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind, Loop
from turtlebag.pipeline.slam.graph.drift import drift_of, reach, read_at
from turtlebag.pipeline.slam.graph.edits import KeyEdits
from turtlebag.pipeline.slam.graph.partners import compared_with, earlier_in_place
from turtlebag.pipeline.slam.graph.pose_graph import Gtsam
from turtlebag.pipeline.slam.loops.acceptance import loop_verdict
from turtlebag.pipeline.slam.loops.matcher import LoopMatch, Stretch
from turtlebag.pipeline.slam.loops.matchers import MATCHERS
from turtlebag.pipeline.slam.progress import Progress, no_progress
from turtlebag.pipeline.slam.scans.clouds import KeyScans
from turtlebag.pipeline.slam.scans.correlative import TURN_RAD, best_pose, make_field
from turtlebag.pipeline.slam.scans.correspondences import Limits


class LoopConfig(Settings):
    """Loop closure."""

    RENAMED: ClassVar = {"inflation": "covariance_scale"}

    enabled: bool = Field(
        default=True, description="close loops with key scans that are near by the estimate"
    )
    match: Annotated[str, part_of(*MATCHERS)] = Field(
        default="lines",
        description="aligns loops: our point-to-line alignment, Open3D's ICP, or your own class",
    )
    every: int = Field(default=3, gt=0, description="key scans between queries")
    group: int = Field(default=6, gt=0, le=100, description="key scans before and after it that form a place")
    min_path_m: float = Field(default=6.0, gt=0.0, description="distance driven since the first visit")
    reach_m: float = Field(default=4.0, gt=0.0, le=50.0, description="largest search distance")
    held_m: float = Field(
        default=0.2,
        ge=0.0,
        description="search radius below which places are left to the refinement",
    )
    min_overlap: float = Field(default=0.7, gt=0.0, le=1.0, description="least share of points that match")
    min_score: float = Field(default=0.55, gt=0.0, le=1.0, description="minimum score of the search")
    covariance_scale: float = Field(
        default=50.0, gt=0.0, description="information of a match divided by that of its loop"
    )

    def matcher(self) -> LoopMatch:
        """A new matcher; InputError if it is a user's class that cannot be loaded."""
        made: LoopMatch = chosen(self.match, MATCHERS, LoopMatch)()
        return made

    def constraint(self, place: Loop) -> Constraint:
        """The constraint of a revisited place in the graph."""
        information = place.information / self.covariance_scale
        return Constraint(place.j, place.i, place.T_j_i, information, Kind.LOOP, Constraint.CAUCHY)


@dataclass(frozen=True, eq=False)
class LoopClosing:
    """The configuration of loop closure: settings, the user's edits, and the back end."""

    config: LoopConfig
    edits: KeyEdits = field(default_factory=KeyEdits)
    back_end: BackEnd = field(default_factory=Gtsam)


def close_loops(
    scans: KeyScans,
    T_map_keys: SE2,
    steps: Sequence[Constraint],
    closing: LoopClosing,
    part: NDArray[np.int64],
    known: Sequence[Constraint] = (),
    progress: Progress = no_progress,
) -> LoopFinder:
    """Search along the log, batch by batch.

    Loops are searched within parts of the log only (`part`, (keys,)): across a break of the track, distance
    says nothing. `known` are loops found otherwise. The returned finder holds the poses with loops closed,
    the loop constraints, and the record of all candidates.
    """
    finder = LoopFinder(scans, T_map_keys, steps, closing, part, known)
    parts = batches(len(scans.keys))
    for k in progress(range(len(parts)), "closing loops", len(parts)):
        finder.process(parts[k])
    return finder


# The graph is optimised after this many keys, or after this share of those before them, if they closed loops.
# With half as many, twice as many or all at once the maps are the same; fewer cost optimisations, more cost
# wider searches.
BATCH, SHARE = 48, 8


def batches(n: int) -> list[range]:
    """n keys in batches that grow with their number: an optimisation of all of them at a time is as long as
    they are many."""
    ends = [0]
    while ends[-1] < n:
        ends.append(min(ends[-1] + max(BATCH, ends[-1] // SHARE), n))
    return [range(*both) for both in pairwise(ends)]


# A key is searched at this many of the places within its gate, nearest first.
PLACES = 3
# Cells of the coarse search [m] and its widest turn [rad]; resolutions of the fine one [m], [rad].
CELL_M, MOST_TURN_RAD = 0.2, 0.8
FINE_M, FINE_RAD = 0.05, 0.01
# Distance driven between keys in addition to their distance: the robot may have turned on the spot.
TURNING_M = 0.05


def step_lengths(poses: Array) -> Array:
    """The distance driven from each pose (n, 3) to the next [m], (n - 1,)."""
    return np.asarray(np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1) + TURNING_M)


class LoopSearch(ABC):
    """The growing graph during the search along the log, in the plane or in space. `poses` (n, 3) are those
    of the keys, in space seen from above: drift moves a robot along the floor."""

    def __init__(
        self,
        T_map_keys: SE2,
        steps: Sequence[Constraint],
        config: LoopConfig,
        part: NDArray[np.int64],
        known: Sequence[Constraint] = (),
        edits: KeyEdits = KeyEdits(),  # noqa: B008 (frozen)
    ) -> None:
        self.config, self.part, self.edits = config, part, edits
        self.poses = T_map_keys.xyt.copy()
        self.steps = list(steps)
        self.loops = list(known)
        self.record: list[Loop] = []
        self.path = np.concatenate([[0.0], np.cumsum(step_lengths(self.poses))])

    @abstractmethod
    def _match(self, i: int, j: int, gate: float, turn_gate: float) -> Loop:
        """Align key i with the place around key j, within [m] and [rad] of its current pose, and judge it."""

    @abstractmethod
    def _optimise(self, n: int, graph: list[Constraint]) -> None:
        """Move the first n keys to their poses in the graph; the later keys follow the last one rigidly."""

    def process(self, batch: range) -> None:
        """Search loops for the keys of a batch, then re-optimise when any was found."""
        found = []
        self._judge_drift()
        for i in batch:
            if i % self.config.every == 0 or i == len(self.poses) - 1:
                loop = self._query(i)
                if loop is not None:
                    found.append(loop)
        self.record.extend(found)
        accepted = [loop for loop in found if loop.accepted]
        if not accepted:
            return
        self.loops += map(self.config.constraint, accepted)
        n = batch.stop
        self._optimise(n, [c for c in [*self.steps, *self.loops] if max(c.i, c.j) < n])

    def _judge_drift(self) -> None:
        """The uncertainty of the keys' poses by the current graph, and the places that they are in."""
        self.ways = drift_of(self.poses, self.steps).ways(self.loops)
        self._earlier = earlier_in_place(self.poses)

    def _query(self, i: int) -> Loop | None:
        """The best older place for key i, or None if none is near enough."""
        return self._best_of(i, self.candidates(i))

    def _best_of(self, i: int, places: Sequence[tuple[int, float, float]]) -> Loop | None:
        """Key i at the first place where it is accepted, otherwise where it fits best."""
        tried: list[Loop] = []
        for j, gate, turn_gate in places:
            tried.append(self._match(i, j, gate, turn_gate))
            if tried[-1].accepted:
                break
        return max(tried, key=lambda loop: (loop.accepted, loop.score), default=None)

    def candidates(self, i: int) -> list[tuple[int, float, float]]:
        """PLACES older keys near key i, nearest first, with their search radius [m] and angle [rad]."""
        config = self.config
        returned = self.path[i] - self.path[:i] > config.min_path_m
        old = np.flatnonzero(returned & (self.part[:i] == self.part[i]) & compared_with(self._earlier, i))
        old = old[~self.edits.rejects(i, old)]
        distance = np.linalg.norm(self.poses[old, :2] - self.poses[i, :2], axis=1)
        within = distance < config.reach_m + 1.0
        old, distance = old[within], distance[within]
        if len(old) == 0:
            return []
        gates, turns = reach(read_at(self.ways(i, old), self.poses[i]))
        gates, turns = np.minimum(gates + CELL_M, config.reach_m), np.minimum(turns + TURN_RAD, MOST_TURN_RAD)
        found: list[tuple[int, float, float]] = []
        near = np.flatnonzero(distance < gates + 1.0)
        for pick in near[np.argsort((distance + gates)[near], kind="stable")].tolist():
            j = int(old[pick])
            if any(abs(j - k) <= 2 * config.group for k, _, _ in found):
                continue
            found.append((j, float(gates[pick]), float(turns[pick])))
            if len(found) == PLACES:
                break
        return found


class LoopFinder(LoopSearch):
    """Loops of planar scans."""

    def __init__(
        self,
        scans: KeyScans,
        T_map_keys: SE2,
        steps: Sequence[Constraint],
        closing: LoopClosing,
        part: NDArray[np.int64],
        known: Sequence[Constraint] = (),
    ) -> None:
        super().__init__(T_map_keys, steps, closing.config, part, known, closing.edits)
        self.scans = scans
        self._closed = {c.j for c in known}
        self.matcher, self.back_end = closing.config.matcher(), closing.back_end

    def _query(self, i: int) -> Loop | None:
        """None also for a key that has its loop already, or whose nearest place is certain enough."""
        places = [] if i in self._closed else self.candidates(i)
        held = bool(places) and places[0][1] <= self.config.held_m + CELL_M
        return None if held else self._best_of(i, places)

    def _optimise(self, n: int, graph: list[Constraint]) -> None:
        before = self.poses[n - 1].copy()
        self.poses[:n] = self.back_end.optimise(SE2(self.poses[:n]), graph).xyt
        if n < len(self.poses):
            move = SE2(self.poses[n - 1]) @ SE2(before).inverse()
            self.poses[n:] = (move @ SE2(self.poses[n:])).xyt

    def _match(self, i: int, j: int, gate: float, turn_gate: float) -> Loop:
        return self.match_from(i, j, between(self.poses[j], self.poses[i]), gate, turn_gate)

    def match_from(self, i: int, j: int, guess: Array, gate: float, turn_gate: float) -> Loop:
        """Search, align and judge key i (with its predecessors) against the place around key j, within [m]
        and [rad] of a pose (3,) seen from there."""
        config, clouds = self.config, self.scans.clouds
        lo, hi = max(0, j - config.group), min(j + config.group + 1, i - 1)
        place = self._stretch(j, np.arange(lo, hi))
        query = self._stretch(i, np.arange(max(0, i - config.group), i + 1))
        points = query.points(clouds)
        points = points[:: max(1, len(points) // 300)]
        coarse_field = make_field(clouds, place.scans, place.T_about_scans, CELL_M)
        coarse, _ = best_pose(coarse_field, points, guess, gate, turn_gate, TURN_RAD)
        fine_field = make_field(clouds, place.scans, place.T_about_scans, FINE_M)
        fine, score = best_pose(fine_field, points, coarse, CELL_M, TURN_RAD, FINE_RAD)
        if score < config.min_score:
            return Loop(i, j, fine, score, 0.0, 0.0, np.eye(3), "low score", gate)
        found = self.matcher.match(clouds, query, place, fine, Limits.rough())
        verdict = loop_verdict(found, fine, clouds, (query, place), config.min_overlap)
        T_j_i, fit = found.T_map_base.xyt, (found.overlap, found.rmse, found.information)
        return Loop(i, j, T_j_i, score, *fit, verdict, gate)

    def _stretch(self, about: int, members: NDArray[np.int64]) -> Stretch:
        """Some keys seen from one of them."""
        T = (SE2(self.poses[about]).inverse() @ SE2(self.poses[members])).xyt
        return Stretch(int(self.scans.keys[about]), self.scans.keys[members], T)
