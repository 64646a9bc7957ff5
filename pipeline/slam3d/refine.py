"""Joint refinement: every key cloud against the places of the keys it overlaps with, all poses at once.

Lu and Milios (1997) with point-to-plane distances: each overlapping pair is aligned at the current poses,
which gives a relative pose with its information; the pose graph is solved; and again, until nothing moves.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial import cKDTree

from turtlebag.datasets import se3
from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.slam.factors import Constraint
from turtlebag.pipeline.slam.pose_graph import optimise
from turtlebag.pipeline.slam3d.cloud_tracking import thinned
from turtlebag.pipeline.slam3d.key_clouds import Keys, Places
from turtlebag.pipeline.slam3d.surfels import fit

SHRINK = 0.4
"""The gate of each round, of that before."""
ENOUGH = 5e-4
"""Rounds end when no key moves by more [m, rad]."""


class Refine3dConfig(BaseModel):
    """The joint refinement."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    rounds: int = Field(default=3, ge=0, description="align-and-solve rounds; 0 switches it off")
    reach: int = Field(default=2, ge=0, description="keys on each side that make a place")
    neighbours: int = Field(default=6, gt=0, description="places a key cloud is aligned with")
    radius_voxels: float = Field(
        default=12.0, gt=0.0, description="places lie within this distance, in voxels"
    )
    points: int = Field(default=1500, gt=100, description="points of a key cloud that are aligned")
    gate_voxels: float = Field(default=0.7, gt=0.0, description="largest distance to a surfel, in voxels")
    kernel_m: float = Field(default=0.03, gt=0.0)
    min_overlap: float = Field(default=0.4, gt=0.0, le=1.0)
    soft: float = Field(
        default=3.0, ge=0.0, description="Cauchy width (0: not robust), in standard deviations"
    )
    inflation: float = Field(default=50.0, gt=0.0, description="how much a pair's information is divided by")


def refine(
    keys: Keys,
    T_map_keys: Array,
    steps: Sequence[Constraint],
    voxel: float,
    config: Refine3dConfig,
) -> tuple[Array, list[Constraint]]:
    """Refined key poses (n, 4, 4) and the constraints of the last round; `steps` hold throughout."""
    poses, constraints = T_map_keys, list(steps)
    for round_ in range(config.rounds):
        pairs = overlapping_pairs(poses, config.radius_voxels * voxel, config.reach, config.neighbours)
        constraints = [*steps, *_pair_constraints(keys, poses, pairs, voxel, round_, config)]
        new = optimise(poses, constraints, iterations=10)
        moved = np.abs(se3.log(se3.inverse(poses) @ new)).max()
        poses = new
        if moved < ENOUGH:
            break
    return poses, constraints


def overlapping_pairs(T_map_keys: Array, radius: float, reach: int, neighbours: int) -> NDArray[np.int64]:
    """Pairs (n, 2): key i and the anchor j of a place without it, sorted by j.

    For each key the places just before and after it in time, and its nearest ones, spread over the visits
    rather than taken from one.
    """
    n, apart = len(T_map_keys), reach + 1
    xyz = T_map_keys[:, :3, 3]
    found: set[tuple[int, int]] = set()
    for i, near in enumerate(cKDTree(xyz).query_ball_point(xyz, radius)):
        found |= {(i, j) for j in (i - apart, i + apart) if 0 <= j < n}
        others = np.array([k for k in near if abs(k - i) > reach], dtype=np.int64)
        order = np.argsort(np.linalg.norm(xyz[others] - xyz[i], axis=1), kind="stable")
        taken: list[int] = []
        for k in others[order].tolist():
            if len(taken) < neighbours and all(abs(k - t) > 2 * reach for t in taken):
                taken.append(k)
        found |= {(i, k) for k in taken}
    return np.array(sorted(found, key=lambda pair: pair[::-1]), dtype=np.int64).reshape(-1, 2)


def _pair_constraints(
    keys: Keys,
    poses: Array,
    pairs: NDArray[np.int64],
    voxel: float,
    round_: int,
    config: Refine3dConfig,
) -> list[Constraint]:
    places = Places(keys, poses, voxel, config.reach)
    found, last = [], -1
    gate = max(config.gate_voxels * voxel * SHRINK**round_, 3.0 * config.kernel_m)
    for i, j in pairs.tolist():
        if j != last:
            places.forget(last)
            last = j
        points = thinned(keys.clouds[i], config.points).astype(np.float64)
        guess = se3.inverse(poses[j]) @ poses[i]
        result = fit(
            places.surfels(j),
            points,
            guess,
            origin=keys.origin,
            gate=gate,
            kernel=config.kernel_m,
            iterations=8,
        )
        if result.overlap >= config.min_overlap:
            information = observable(result.information) / config.inflation
            found.append(Constraint(j, i, result.T, information, "pair", config.soft))
    return found


BLIND_SHARE = 0.01
"""A direction with less than this share of the information of the best one is not seen at all."""


def observable(information: Array) -> Array:
    """Information (6, 6) without the directions the surfaces do not hold: along a corridor, say.

    Normals err by some degrees, so a blind direction still gathers a share of the others' information.
    Rotation and translation are judged apart.
    """
    out = information.copy()
    for block in (slice(0, 3), slice(3, 6)):
        values, vectors = np.linalg.eigh(information[block, block])
        for k in np.flatnonzero(values < BLIND_SHARE * values[-1]):
            keep = np.eye(6)
            keep[block, block] -= np.outer(vectors[:, k], vectors[:, k])
            out = keep @ out @ keep
    return out
