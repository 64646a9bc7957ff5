"""Loop closure in 3D: revisits of a known place.

Candidates by distance come from the planar search (`slam.loops`), with the log seen from above; beyond
its reach from appearance (scan context; Open3D finds the pose). Surfels align and verify both. A candidate by
appearance alone needs a second, consistent one: rooms look alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from pydantic import Field

from turtlebag.datasets import se3
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.se3 import SE3
from turtlebag.datasets.settings import Settings
from turtlebag.pipeline.slam.graph.constraints import Constraint, Loop, firm
from turtlebag.pipeline.slam.graph.drift import Drift, drift_of, reach, read_at
from turtlebag.pipeline.slam.graph.pose_graph import optimise
from turtlebag.pipeline.slam.loops.by_distance import LoopConfig, LoopSearch, batches
from turtlebag.pipeline.slam.loops.consistency import agreeing_sets, competing, consistency, support
from turtlebag.pipeline.slam3d.key_clouds import Keys, Places
from turtlebag.pipeline.slam3d.open3d_match import featured, pose_by_features
from turtlebag.pipeline.slam3d.scan_context import Contexts, descriptor
from turtlebag.pipeline.slam3d.sensor_setup import MAX_SLOPE_RAD
from turtlebag.pipeline.slam3d.surfels import COVARIANCE_SCALE, GATE_VOXELS, observable

REACH_VOXELS, RETURN_VOXELS = 5.0, 25.0
"""How far off a key may lie to be aligned from where it is, and the way since that makes a return."""
CONTEXT_M, UNLIKE, LIKEST = 20.0, 0.35, 2
"""Radius of the scan context; places less similar than this are not compared, nor more than this many for
each key."""
LOOKS = 64
"""Places whose features are kept: neighbours look like the same ones."""
SUPPORT = 2
"""Keys that must be recognised at a place."""
MIN_OVERLAP = 0.6


class Loop3dConfig(Settings):
    """Loop closure."""

    enabled: bool = True
    """Close loops."""
    appearance: bool = Field(default=True, description="look for places beyond the gate by scan context")
    every: int = Field(default=3, gt=0, description="keys between queries")


class CloudLoops(LoopSearch):
    """Loops of key clouds; `T` (n, 4, 4) are the keys' poses."""

    def __init__(
        self,
        keys: Keys,
        T_map_keys: Array,
        steps: Sequence[Constraint],
        voxel: float,
        every: int,
        known: Sequence[Constraint] = (),
    ) -> None:
        config = LoopConfig(
            every=every,
            min_path_m=RETURN_VOXELS * voxel,
            reach_m=REACH_VOXELS * voxel,
            covariance_scale=COVARIANCE_SCALE,
        )
        part = np.zeros(len(keys), dtype=np.int64)
        super().__init__(se3.planar(T_map_keys), steps, config, part, known)
        self.keys, self.T, self.voxel = keys, T_map_keys.copy(), voxel
        self.places = Places(keys, T_map_keys, voxel)
        for batch in batches(len(keys)):
            self.process(batch)

    def _optimise(self, n: int, graph: list[Constraint]) -> None:
        before = self.T[n - 1].copy()
        self.T[:n] = optimise(SE3(self.T[:n]), graph).matrix
        self.T[n:] = self.T[n - 1] @ se3.inverse(before) @ self.T[n:]
        self.poses = se3.planar(self.T).xyt.copy()

    def _match(self, i: int, j: int, gate: float, turn_gate: float) -> Loop:
        del turn_gate
        return self._judged(i, j, se3.inverse(self.T[j]) @ self.T[i], gate)

    def _judged(self, i: int, j: int, T_guess: Array, gate: float) -> Loop:
        """Key i aligned with key j's place, started at a guess."""
        points = self.keys.clouds[i].astype(np.float64)
        rough = self.places.fit(j, points, T_guess, 2.0 * self.voxel)
        found = self.places.fit(j, points, rough.T, GATE_VOXELS * self.voxel)
        tilt = np.arccos(np.clip((self.T[j] @ found.T)[:3, 2] @ self.T[i][:3, 2], -1.0, 1.0))
        verdict = "accepted" if found.overlap >= MIN_OVERLAP else "low overlap"
        verdict = "tilted" if tilt > MAX_SLOPE_RAD else verdict
        fit = rough.overlap, found.overlap, found.rmse, observable(found.information)
        return Loop(i, j, found.T, *fit, verdict, gate)

    def recognised(self) -> list[Loop]:
        """Loops by appearance where the drift is too large for distance; those that agree are accepted."""
        drift = drift_of(self.poses, self.steps)
        found = self._alike(drift)
        good = [k for k, loop in enumerate(found) if loop.accepted]
        planar = [replace(found[k], T_j_i=se3.planar(found[k].T_j_i).xyt) for k in good]
        comparable, agree = consistency(planar, drift, np.inf, COVARIANCE_SCALE)
        believed: list[list[int]] = []
        for members in agreeing_sets(planar, agree & comparable):
            verdict = "too few agree" if support(planar, members) < SUPPORT else "accepted"
            if any(competing(members, other, comparable, agree) for other in believed):
                verdict = "another place fits better"
            for k in members:
                found[good[k]] = replace(found[good[k]], verdict=verdict)
            believed += [members] * (verdict == "accepted")
        return found

    def _alike(self, drift: Drift) -> list[Loop]:
        """Each key aligned with the places that look like its own, beyond the reach of distance."""
        n, found, ways = len(self.keys), list[Loop](), drift.ways(self.loops)
        contexts: Contexts | None = None
        looks = lru_cache(LOOKS)(lambda k: featured(self.places.points(k)[0], self.voxel))
        for i in range(0, n, self.config.every):
            off = reach(read_at(ways(i, np.arange(i)), self.poses[i]))[0]
            apart = np.linalg.norm(self.poses[:i, :2] - self.poses[i, :2], axis=1)
            old = self.path[i] - self.path[:i] > self.config.min_path_m
            far = np.flatnonzero(old & (off > self.config.reach_m) & (apart < off))
            if len(far) == 0:
                continue
            if contexts is None:
                contexts = Contexts([descriptor(self.places.points(k)[0], CONTEXT_M) for k in range(n)])
            for j in contexts.like(i, far, LIKEST, UNLIKE):
                start = pose_by_features(looks(i), looks(j), self.voxel, seed=1 + i * n + j)
                found.append(self._judged(i, j, start, float(off[j])))
        return found


def close_loops(
    keys: Keys, T_map_keys: Array, steps: Sequence[Constraint], voxel: float, config: Loop3dConfig
) -> tuple[CloudLoops, list[Loop]]:
    """Loops by distance, then by appearance; with any of those by distance again, from there."""
    finder = CloudLoops(keys, T_map_keys, steps, voxel, config.every)
    recognised = finder.recognised() if config.appearance else []
    known = [finder.config.constraint(loop) for loop in recognised if loop.accepted]
    if known:
        start = optimise(SE3(finder.T), [*steps, *finder.loops, *firm(known)])
        start = optimise(start, [*steps, *finder.loops, *known])
        finder = CloudLoops(keys, start.matrix, steps, voxel, config.every, known)
    return finder, recognised
