"""Joint refinement: every key scan aligned with every key scan it overlaps, all poses at once.

Lu and Milios (1997), with point-to-line distances: each overlapping pair is linearised at the current
poses into a relative pose with its full information matrix, the pose graph is solved, and the pairs
are linearised again, the gate shrinking, until nothing moves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.settings import Settings
from turtlebag.pipeline.slam.graph.back_end import BackEnd
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind
from turtlebag.pipeline.slam.graph.cost import Poses
from turtlebag.pipeline.slam.graph.edits import KeyEdits
from turtlebag.pipeline.slam.graph.partners import alike_within, overlapping_pairs, partner_radius
from turtlebag.pipeline.slam.graph.pose_graph import Gtsam, optimise
from turtlebag.pipeline.slam.scans.align import match_information
from turtlebag.pipeline.slam.scans.clouds import Clouds
from turtlebag.pipeline.slam.scans.correspondences import Limits
from turtlebag.pipeline.slam.scans.pairs import match_pairs

# Where no key moved farther in a round [m or rad], the next round is the last.
STILL = 0.01


class RefineConfig(Settings):
    """The joint refinement."""

    rounds: int = Field(
        default=5, ge=0, le=100, description="linearise-and-solve rounds at most; 0: no refinement"
    )


def refine(
    clouds: Clouds,
    keys: NDArray[np.int64],
    T_map_keys: SE2,
    steps: Sequence[Constraint],
    config: RefineConfig,
    edits: KeyEdits = KeyEdits(),  # noqa: B008 (frozen)
    back_end: BackEnd | None = None,
) -> tuple[SE2, list[Constraint]]:
    """Refined poses of the key scans and the pair constraints of the last round.

    `steps` are the odometry constraints between successive keys, kept in the graph throughout. Pairs that a
    person rejected are left out.
    """
    radius, solve = partner_radius(clouds), (back_end or Gtsam()).optimise

    def matched(poses: SE2, f: float) -> list[Constraint]:
        pairs = overlapping_pairs(poses, radius, alike=alike_within(radius))
        pairs = pairs[~edits.rejects(pairs[:, 0], pairs[:, 1])]
        return pair_constraints(clouds, keys, poses, pairs, Limits.between(f))

    return in_rounds(T_map_keys, steps, config.rounds, matched, solve)


def in_rounds(
    T_map_keys: Poses,
    steps: Sequence[Constraint],
    rounds: int,
    matched: Callable[[Poses, float], list[Constraint]],
    solve: Callable[[Poses, Sequence[Constraint], int], Poses] = optimise,
) -> tuple[Poses, list[Constraint]]:
    """Match pairs at the current poses and solve the graph, again and again. `matched` gives the constraints
    of a round, from its progress: 0 (the first) to 1 (the last). After a round in which nothing moved much,
    those between are left out."""
    poses: Poses = T_map_keys
    constraints = list(steps)
    progress: list[float] = np.linspace(0.0, 1.0, rounds).tolist()
    while progress:
        constraints = [*steps, *matched(poses, progress.pop(0))]
        before, poses = poses, solve(poses, constraints, 5)
        if np.abs((before.inverse() @ poses).vector()).max() < STILL:
            del progress[:-1]
    return poses, constraints


def pair_constraints(
    clouds: Clouds,
    keys: NDArray[np.int64],
    T_map_keys: SE2,
    pairs: NDArray[np.int64],
    limits: Limits,
) -> list[Constraint]:
    """One constraint for each pair that overlaps enough, linearised at the given poses."""
    found = match_pairs(clouds, keys, T_map_keys, pairs, limits)
    good, information = found.possible, match_information(found.information)
    return [
        Constraint(i, j, T_i_j, of_pair, Kind.PAIR, Constraint.CAUCHY)
        for (i, j), T_i_j, of_pair in zip(
            pairs[good].tolist(), found.T_i_j[good], information[good], strict=True
        )
    ]
