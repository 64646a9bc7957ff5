"""What the pose graphs of the plane and of space share: the constraint, its noise model, the solver.

With `slam/pose_graph.py` and `slam3d/graph.py` it wraps GTSAM, so that nothing else sees its
keys, its noise models or its failure modes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from turtlebag.datasets.se2 import Array

Kind = Literal["step", "odometry", "steady", "loop", "pair"]


@dataclass(frozen=True, eq=False)
class Constraint:
    """`T_i_j`, the pose of key j seen from key i, with its information in the frame of j.

    In the plane (3,) and (3, 3); in space (4, 4) and (6, 6), rotation first. `soft` is the width of the
    Cauchy kernel in standard deviations, 0 for none.
    """

    i: int
    j: int
    T_i_j: Array
    information: Array
    kind: Kind
    soft: float = 0.0


def noise(constraint: Constraint, floor: Array) -> Any:
    """GTSAM's noise model of a constraint; `floor` is added to keep its information positive definite."""
    import gtsam  # takes a quarter of a second, and most runs need no graph

    gaussian: Any = gtsam.noiseModel.Gaussian.Information(constraint.information + floor)
    if constraint.soft == 0.0:
        return gaussian
    cauchy = gtsam.noiseModel.mEstimator.Cauchy.Create(constraint.soft)
    return gtsam.noiseModel.Robust.Create(cauchy, gaussian)


def solved(graph: Any, values: Any, iterations: int, tolerance: float) -> Any:
    """The values that Levenberg-Marquardt ends at; `tolerance` is the relative decrease it stops at."""
    import gtsam

    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(iterations)
    parameters.setRelativeErrorTol(tolerance)
    return gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
