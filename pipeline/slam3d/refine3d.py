"""Joint refinement in 3D: every key cloud aligned with the places of the key clouds it overlaps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from turtlebag.datasets import se3
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.se3 import SE3
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind
from turtlebag.pipeline.slam.graph.partners import overlapping_pairs
from turtlebag.pipeline.slam.graph.refinement import RefineConfig, in_rounds
from turtlebag.pipeline.slam3d.key_clouds import REACH, Keys, Places, thinned
from turtlebag.pipeline.slam3d.surfels import (
    COVARIANCE_SCALE,
    GATE_VOXELS,
    KERNEL_M,
    LEAST_OVERLAP,
    observable,
)

RADIUS_VOXELS = 12.0
"""Key clouds farther apart see too little of the same to be partners."""
FINE_KERNELS = 3.0
"""The gate of the last round, in kernels."""
POINTS = 1500
"""Points of a cloud that are aligned."""
CARRIED_GATE_M, CARRIED = 0.1, np.full(12, 0.01)
"""How far off a pose that the keys have carried may be, and its standard deviations [m, rad]."""


def refine(
    keys: Keys, T_map_keys: Array, steps: Sequence[Constraint], voxel: float, config: RefineConfig
) -> tuple[Array, list[Constraint]]:
    """Refined key poses (n, 4, 4) and the constraints of the last round; `steps` hold throughout.

    A place is made of a key and those up to REACH from it; keys are matched with places that they are no
    part of, those just beyond their own always: they tie the log together.
    """

    def matched(T_map_keys: SE3, f: float) -> list[Constraint]:
        poses = T_map_keys.matrix
        gate = rough * (fine / rough) ** f
        places, found = Places(keys, poses, voxel), []
        near = overlapping_pairs(se3.planar(poses), RADIUS_VOXELS * voxel)
        along = np.arange(max(len(poses) - REACH - 1, 0))[:, None] + [0, REACH + 1]
        apart = np.unique(np.vstack([near[near[:, 1] - near[:, 0] > REACH], along]), axis=0)
        # either is the place of the other; in order, so that each place is made once
        for i, j in sorted([*apart.tolist(), *apart[:, ::-1].tolist()]):
            guess = se3.inverse(poses[i]) @ poses[j]
            result = places.fit(i, keys.points(j, POINTS), guess, gate)
            if result.overlap >= LEAST_OVERLAP:
                information = observable(result.information) / COVARIANCE_SCALE
                found.append(Constraint(i, j, result.T, information, Kind.PAIR, Constraint.CAUCHY))
        return found

    rough = max(GATE_VOXELS * voxel, fine := FINE_KERNELS * KERNEL_M)
    poses, constraints = in_rounds(SE3(T_map_keys), steps, config.rounds, matched)
    return poses.matrix, constraints


def reregistered(places: Places, points: Array, T_map_carried: Array) -> Array:
    """Pose (4, 4) of a cloud (n, 3) aligned with the key nearest to where the keys around it carried it; that
    itself where it does not fit."""
    near = places.nearest(T_map_carried)
    T_map_key = places.T_map_keys[near]
    guess = se3.inverse(T_map_key) @ T_map_carried
    found = places.fit(near, thinned(points, POINTS), guess, CARRIED_GATE_M, CARRIED)
    near_enough = np.linalg.norm((found.T - guess)[:3, 3]) <= CARRIED_GATE_M
    return T_map_key @ found.T if found.overlap >= LEAST_OVERLAP and near_enough else T_map_carried
