"""Loop closure in space: where the robot came back to a place it knew.

Candidates come from distance, the gate growing with the way since, and beyond the gate from appearance
(scan context). Open3D registers and tests each; the surfels then measure it. A loop that only appearance
proposed needs a second one that says the same: rooms look alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from turtlebag.datasets import se3
from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.slam.factors import Constraint
from turtlebag.pipeline.slam.pose_graph import optimise
from turtlebag.pipeline.slam3d.key_clouds import Keys, around, gathered
from turtlebag.pipeline.slam3d.open3d_match import MatchConfig, Matcher
from turtlebag.pipeline.slam3d.refine import observable
from turtlebag.pipeline.slam3d.scan_context import Contexts, descriptor
from turtlebag.pipeline.slam3d.surfels import fit, make_surfels

BATCH = 24
ACCEPTED = "accepted"
ALONE = "nothing else says so"


class Loop3dConfig(BaseModel):
    """Loop closure."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    enabled: bool = True
    open3d: bool = Field(default=True, description="register and verify with Open3D")
    appearance: bool = Field(default=True, description="look for places beyond the gate by scan context")
    match: MatchConfig = MatchConfig()
    every: int = Field(default=3, gt=0, description="keys between queries")
    reach: int = Field(default=3, ge=0, description="keys on each side that make a place")
    min_path_voxels: float = Field(default=25.0, gt=0.0, description="way since, to call it a return")
    gate_voxels: float = Field(default=5.0, gt=0.0)
    drift_per_m: float = Field(default=0.02, gt=0.0, description="growth of the gate with the way since")
    max_gate_voxels: float = Field(default=30.0, gt=0.0)
    context_reach_m: float = Field(default=20.0, gt=0.0, description="radius of the scan context")
    context_most: float = Field(default=0.35, gt=0.0, description="dissimilarity of places, to be compared")
    context_count: int = Field(default=2, gt=0, description="places compared for each key")
    min_overlap: float = Field(default=0.6, gt=0.0, le=1.0, description="of the surfels, to believe a loop")
    max_tilt_rad: float = Field(default=0.1, gt=0.0, description="a loop may tilt the key by this")
    agree_m: float = Field(default=0.5, gt=0.0, description="two loops that say the same, at first")
    soft: float = Field(
        default=2.0, ge=0.0, description="Cauchy width (0: not robust), in standard deviations"
    )
    inflation: float = Field(default=50.0, gt=0.0)


@dataclass(frozen=True, eq=False)
class Loop3d:
    """One candidate: keys i (later) and j, how it was proposed, its verdict, and what was measured."""

    i: int
    j: int
    by: str
    verdict: str
    T_j_i: Array
    information: Array
    fitness: float = 0.0
    overlap: float = 0.0
    rmse: float = 0.0

    @property
    def accepted(self) -> bool:
        """Whether it entered the graph."""
        return self.verdict == ACCEPTED


def close_loops(
    keys: Keys,
    T_map_keys: Array,
    steps: Sequence[Constraint],
    voxel: float,
    config: Loop3dConfig,
) -> tuple[Array, list[Constraint], list[Loop3d]]:
    """Key poses with loops closed, the loop constraints, and the record of all candidates."""
    finder = LoopFinder(keys, T_map_keys, steps, voxel, config)
    for start in range(0, len(keys), BATCH):
        finder.process(range(start, min(start + BATCH, len(keys))))
    return finder.poses, finder.constraints(), finder.record


class LoopFinder:
    """The growing graph while loops are searched along the log."""

    def __init__(
        self,
        keys: Keys,
        T_map_keys: Array,
        steps: Sequence[Constraint],
        voxel: float,
        config: Loop3dConfig,
    ) -> None:
        self.keys, self.steps, self.voxel, self.config = keys, list(steps), voxel, config
        self.poses = T_map_keys.copy()
        self.record: list[Loop3d] = []
        self._track = T_map_keys
        way = np.linalg.norm(np.diff(T_map_keys[:, :3, 3], axis=0), axis=1) + 0.1 * voxel
        self._way = np.concatenate([[0.0], np.cumsum(way)])
        self._matcher = Matcher(config.match, voxel) if config.open3d else None
        self._contexts = None
        if config.appearance:
            n = len(keys)
            gathering = (gathered(keys, T_map_keys, k, around(k, 1, n))[0] for k in range(n))
            self._contexts = Contexts([descriptor(points, config.context_reach_m) for points in gathering])

    def constraints(self) -> list[Constraint]:
        """The accepted loops."""
        return [
            Constraint(loop.j, loop.i, loop.T_j_i, loop.information, "loop", self.config.soft)
            for loop in self.record
            if loop.accepted
        ]

    def process(self, batch: range) -> None:
        """Search loops for the keys of a batch, then optimise again when any was found."""
        before = len(self.constraints())
        for i in batch:
            if i % self.config.every == 0:
                self._query(i)
                self._confirm()
        if len(self.constraints()) > before:
            self.poses = optimise(self.poses, [*self.steps, *self.constraints()])

    def _query(self, i: int) -> None:
        config, voxel = self.config, self.voxel
        since = self._way_between(i)[:i]
        old = np.flatnonzero(since > config.min_path_voxels * voxel)
        if len(old) == 0:
            return
        distance = np.linalg.norm(self.poses[old, :3, 3] - self.poses[i, :3, 3], axis=1)
        gate = config.gate_voxels * voxel + config.drift_per_m * since[old]
        gate = np.minimum(gate, config.max_gate_voxels * voxel)
        inside = distance < gate
        if inside.any():
            j = int(old[inside][np.argmin(distance[inside])])
            loop = self._judged(i, j, se3.inverse(self.poses[j]) @ self.poses[i], "distance")
            self.record.append(loop)
            if loop.accepted:
                return
        if self._contexts is None or self._tied_lately(i):
            return
        for j, yaw in self._contexts.like(i, old[~inside], config.context_count, config.context_most):
            loop = self._judged(i, j, se3.exp(np.array([0.0, 0.0, yaw, 0.0, 0.0, 0.0])), "appearance")
            self.record.append(replace(loop, verdict=ALONE) if loop.accepted else loop)

    def _tied_lately(self, i: int) -> bool:
        """Whether a loop was closed so little way ago that distance alone will find the next."""
        ties = [loop.i for loop in self.record if loop.accepted]
        half = 0.5 * self.config.min_path_voxels * self.voxel
        return bool(ties) and bool(self._way[i] - self._way[max(ties)] < half)

    def _way_between(self, i: int) -> Array:
        """Shortest way along the log and through accepted loops from key i to each key up to it [m]."""
        n = i + 1
        links = [(loop.j, loop.i) for loop in self.record if loop.accepted and loop.i <= i]
        rows = [*range(n - 1), *(a for a, _ in links)]
        columns = [*range(1, n), *(b for _, b in links)]
        lengths = [*np.diff(self._way[:n]).tolist(), *([0.1 * self.voxel] * len(links))]
        graph = coo_matrix((lengths, (rows, columns)), shape=(n, n)).tocsr()
        return np.asarray(dijkstra(graph, directed=False, indices=i))

    def _judged(self, i: int, j: int, T_guess: Array, by: str) -> Loop3d:
        """Register key i's place in key j's, test the result, and measure it."""
        config, voxel, n = self.config, self.voxel, len(self.keys)
        source, _ = gathered(self.keys, self.poses, i, range(max(0, i - config.reach), i + 1))
        target, views = gathered(self.keys, self.poses, j, _older(j, 2 * config.reach, i, n))
        loop = Loop3d(i, j, by, ACCEPTED, T_guess, np.zeros((6, 6)))
        T, gate = T_guess, 2.0 * voxel
        if self._matcher is not None:
            seed = 1 + i * 100_003 + j
            found = self._matcher.match(
                source, target, T_guess, anywhere=by == "appearance", seed=seed % 2**31
            )
            loop = replace(loop, T_j_i=found.T, fitness=found.fitness, overlap=found.overlap)
            if found.problem:
                return replace(loop, verdict=found.problem)
            T, gate = found.T, 0.7 * voxel
        result = fit(
            make_surfels(target, views, voxel),
            self.keys.clouds[i].astype(np.float64),
            T,
            origin=self.keys.origin,
            gate=gate,
            kernel=0.03,
            iterations=20,
        )
        information = observable(result.information) / config.inflation
        loop = replace(
            loop, T_j_i=result.T, information=information, overlap=result.overlap, rmse=result.rmse
        )
        if result.overlap < config.min_overlap:
            return replace(loop, verdict="surfels: low overlap")
        if self._matcher is not None and np.abs(se3.log(se3.inverse(T) @ result.T)).max() > 0.5 * voxel:
            return replace(loop, verdict="surfels and open3d disagree")
        if _tilt(self.poses[j] @ result.T, self.poses[i]) > config.max_tilt_rad:
            return replace(loop, verdict="tilted")
        return loop

    def _confirm(self) -> None:
        """Accept loops of appearance that another loop, from elsewhere, agrees with."""
        for k, loop in enumerate(self.record):
            if loop.verdict == ALONE and any(
                self._agree(loop, other)
                for other in self.record
                if other is not loop and other.verdict in (ALONE, ACCEPTED)
            ):
                self.record[k] = replace(loop, verdict=ACCEPTED)

    def _agree(self, a: Loop3d, b: Loop3d) -> bool:
        """Whether two loops close a circle: over both and the two stretches of the track between them."""
        if a.i == b.i or abs(self._way[a.i] - self._way[b.i]) > 60.0 * self.voxel:
            return False
        T_i = se3.inverse(self._track[a.i]) @ self._track[b.i]
        T_j = se3.inverse(self._track[a.j]) @ self._track[b.j]
        left = se3.log(se3.inverse(a.T_j_i @ T_i) @ (T_j @ b.T_j_i))
        way = abs(self._way[a.i] - self._way[b.i]) + abs(self._way[a.j] - self._way[b.j])
        allowed = self.config.agree_m + self.config.drift_per_m * way
        return bool(np.linalg.norm(left[3:]) < allowed and np.linalg.norm(left[:3]) < 0.3 * allowed)


def _older(j: int, reach: int, i: int, count: int) -> list[int]:
    """Keys around j that do not reach those around i."""
    return [k for k in around(j, reach, count) if k < i - reach // 2] or [j]


def _tilt(T_a: Array, T_b: Array) -> float:
    """Angle between the two poses' upward axes [rad]."""
    return float(np.arccos(np.clip(T_a[:3, 2] @ T_b[:3, 2], -1.0, 1.0)))
