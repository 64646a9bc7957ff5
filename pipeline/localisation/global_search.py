"""Global localisation: poses drawn from the likelihood of one scan over the whole free space.

Of a few thousand particles drawn over a building, none is within the width of the likelihood's peak
of the truth. So candidates are annealed (Deutscher, Blake, Reid 2000; tempering as in Del Moral,
Doucet, Jasra 2006): weighted by a flattened likelihood, resampled, perturbed, weighted by a steeper one.
As a source of the recovery's random particles this is sensor resetting (Lenser, Veloso 2000).

The paths of the beams count, too: a beam seen through a wall, or one without return that ends at
a wall, is evidence against a pose, which the likelihood field alone does not have.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.grid import FREE, OccupancyGrid
from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import SE2, Array, wrap
from turtlebag.datasets.types import LidarSpec
from turtlebag.pipeline.localisation.deskewed_beams import Beams, evenly_spaced
from turtlebag.pipeline.localisation.likelihood_field import (
    DistanceField,
    FloatGrid,
    distance_field,
    meets_wall,
)
from turtlebag.pipeline.localisation.parameters import AmclConfig
from turtlebag.pipeline.localisation.resampling import effective_size, low_variance

# With these numbers 100 of 100 robots were found in the house, and 40 of 40 in buildings not used for tuning
# (docs/lab/localisation.md); the effect of each is not measured. Poses drawn over the free space; the
# best are kept.
CANDIDATES = 20000
# Perturbation after each stage: standard deviations [m and rad], and the number of particles left for the
# next.
SHAKES = (0.10, 0.05, 0.03)
STAGE_PARTICLES = 3000
# Standard deviations of a search around a pose [m, m, rad]: by default those of an initial pose.
USUAL = AmclConfig()
AROUND = np.sqrt([USUAL.initial_cov_xx, USUAL.initial_cov_yy, USUAL.initial_cov_aa])
# Each weighting is flattened until this share of the candidates is effective; fewer together are not a place.
LEAST_EFFECTIVE = 0.02
# Beams are not independent: the final likelihood has at most this exponent.
STEEPEST = 0.3
# Beams with a return used in a search, as many without, and twice as many of both for an agreement.
MOST_HITS = 60
# A beam may end this far before its wall; ranges farther apart are different.
PATH_SLACK_M = 0.2
# Probability of no return although the map has a wall in reach.
P_MISSED = 0.1


class GlobalSearch:
    """Likelihood of poses with the paths of the beams, and draws from it over the free space of a map."""

    def __init__(
        self,
        grid: OccupancyGrid,
        field: DistanceField,
        config: AmclConfig,
        range_max: float,
        candidates: int = CANDIDATES,
    ) -> None:
        """`candidates` are the poses that a search draws over the free space. ValueError if there is none."""
        self._candidates = candidates
        self.field = field
        self.range_max = range_max
        self._grid, self._free = grid, np.argwhere(grid.cells == FREE)
        if len(self._free) == 0:
            raise ValueError("the map has no free cell")
        self._noise = (config.sigma_hit, config.z_hit, config.z_rand / range_max)

    def uniform(self, count: int, rng: np.random.Generator) -> Array:
        """`count` poses, (count, 3), on free cells with any heading."""
        cells = self._free[rng.integers(len(self._free), size=count)]
        within = rng.uniform(-0.5, 0.5, size=(count, 2)) * self._grid.resolution
        yaw = rng.uniform(-np.pi, np.pi, size=count)
        turned = SE2.from_xyt(0.0, 0.0, float(self._grid.T_map_grid.yaw)) @ within
        return np.column_stack([self._grid.center_of(cells) + turned, yaw])

    def log_likelihood(self, poses: Array, beams: Beams) -> Array:
        """Flattened log likelihood (n,) of poses (n, 3) in the map frame."""
        return STEEPEST * self.path_log_likelihood(poses, beams)

    def agreement(self, pose: Array, beams: Beams) -> float:
        """Share of the beams, 0..1, that the map explains from a pose (3,): near 1 at the right place."""
        return float(self.agreements(pose[None], beams)[0])

    def agreements(self, poses: Array, beams: Beams) -> Array:
        """`agreement` (n,) of each of the poses (n, 3)."""
        p = path_probabilities(*self._arguments(poses, beams, 2 * MOST_HITS))
        if p.shape[1] == 0:
            return np.zeros(len(poses))
        hits = min(len(beams), 2 * MOST_HITS)
        best = np.where(np.arange(p.shape[1]) < hits, sum(self._noise[1:]), 1.0 - P_MISSED)
        return np.asarray(np.mean(p / best, axis=1))

    def draw(
        self,
        count: int,
        beams: Beams,
        rng: np.random.Generator,
        around: Array | None = None,
        without: Callable[[Array], NDArray[np.bool_]] | None = None,
    ) -> Array:
        """`count` poses, (count, 3), probable by this scan alone: anywhere, or `around` a pose (3,).
        `without` excludes poses (n, 3); if it excludes all, none are drawn."""
        if around is None:
            poses = self.uniform(self._candidates, rng)
        else:
            poses = around + rng.standard_normal((STAGE_PARTICLES, 3)) * AROUND
        for shake in SHAKES:
            if without is not None and len(poses := poses[~without(poses)]) == 0:
                return poses
            weights = tempered(self.path_log_likelihood(poses, beams))
            poses = poses[low_variance(weights, STAGE_PARTICLES, rng.random())]
            poses = poses + rng.standard_normal(poses.shape) * shake
        weights = tempered(self.path_log_likelihood(poses, beams))
        poses = poses[rng.permutation(low_variance(weights, count, rng.random()))]
        poses[:, 2] = wrap(poses[:, 2])
        return poses

    def path_log_likelihood(self, poses: Array, beams: Beams) -> Array:
        """Log likelihood (n,) of poses (n, 3) in the map frame, as if the beams were independent."""
        p = path_probabilities(*self._arguments(poses, beams, MOST_HITS))
        return np.log(p).sum(axis=1)

    def _arguments(self, poses: Array, beams: Beams, most: int) -> tuple:
        hits = evenly_spaced(len(beams), most)
        silent = evenly_spaced(len(beams.silent_origins), most)
        starts = np.concatenate([beams.origins[hits], beams.silent_origins[silent]])
        ways = np.concatenate(
            [beams.points[hits] - beams.origins[hits], beams.silent_directions[silent] * self.range_max]
        )
        poses = np.ascontiguousarray(poses)  # of one layout, or it would be compiled once more
        return self.field.distance, self.field.frame, poses, starts, ways, len(hits), self._noise


def tempered(log_likelihood: Array) -> Array:
    """Normalised weights of the steepest power that leaves enough of the candidates effective."""
    low, high = 0.0, STEEPEST
    relative = log_likelihood - log_likelihood.max()
    for _ in range(12):
        power = 0.5 * (low + high)
        weights = np.exp(power * relative)
        if effective_size(weights / weights.sum()) < LEAST_EFFECTIVE * len(relative):
            high = power
        else:
            low = power
    weights = np.exp(low * relative)
    return weights / weights.sum()


@njit(cache=True)
def path_probabilities(
    distance: FloatGrid,
    frame: tuple[float, float, float, float],
    poses: Array,
    starts: Array,
    ways: Array,
    hits: int,
    noise: tuple[float, float, float],
) -> Array:
    """Probability of each beam from each pose, (n, m).

    `starts` and `ways` (m, 2) are in the base frame; the first `hits` beams ended at start + way, the others
    had no return along it. `frame`: the field's corner in the map and cells per metre; `noise`: sigma_hit,
    z_hit, z_rand / range_max.
    """
    rows, cols = distance.shape
    x0, y0, yaw0, per_metre = frame
    c0, s0 = np.cos(yaw0), np.sin(yaw0)
    sigma, z_hit, p_rand = noise
    out = np.empty((len(poses), len(starts)))
    for i in range(len(poses)):
        dx, dy = poses[i, 0] - x0, poses[i, 1] - y0
        px, py = c0 * dx + s0 * dy, c0 * dy - s0 * dx
        c, s = np.cos(poses[i, 2] - yaw0), np.sin(poses[i, 2] - yaw0)
        for j in range(len(starts)):
            ox, oy = px + c * starts[j, 0] - s * starts[j, 1], py + s * starts[j, 0] + c * starts[j, 1]
            wx, wy = c * ways[j, 0] - s * ways[j, 1], s * ways[j, 0] + c * ways[j, 1]
            length = np.hypot(wx, wy)
            blocked = meets_wall(distance, per_metre, (ox, oy), (wx, wy), length, length - PATH_SLACK_M)
            if j >= hits:
                out[i, j] = P_MISSED if blocked else 1.0 - P_MISSED
                continue
            p = p_rand
            col, row = int((ox + wx) * per_metre), int((oy + wy) * per_metre)
            if not blocked and 0 <= col < cols and 0 <= row < rows:
                d = distance[row, col]
                p += z_hit * np.exp(-0.5 * (d / sigma) ** 2)
            out[i, j] = p
    return out


def global_search(grid: OccupancyGrid, lidar: LidarSpec, config: AmclConfig) -> GlobalSearch:
    """The search for a lidar on a map, by the settings."""
    field = distance_field(grid, config.likelihood_max_dist)
    return GlobalSearch(grid, field, config, config.range_limits(lidar)[1])
