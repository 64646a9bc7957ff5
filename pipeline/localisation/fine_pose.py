"""The fine pose: an estimate more accurate than the particles, tracked on the map's surfaces.

The particle cloud finds and keeps the right place, but its mean is limited by the map's cells and the number
of particles. Near that mean, one pose is predicted by odometry and corrected by point-to-line matching
of ALL beams (see wall_filter). It starts from the cloud, and restarts whenever
the two disagree, so it never leaves the cloud.

The alphas keep the cloud wide enough to recover; apart from its systematic error,
which is a state here, odometry is mostly far less noisy. How much less is learned from the NIS of the scans.
"""

from __future__ import annotations

import numpy as np

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array, wrap
from turtlebag.pipeline.localisation.estimate import NARROW_M, NARROW_RAD, Estimate, narrow
from turtlebag.pipeline.localisation.surfaces import fit_surfaces
from turtlebag.pipeline.localisation.wall_filter import WallFilter

# Share of the alphas' standard deviation: its start, its minimum (at most 1; without a minimum, scans that
# fit better than usual for an hour would leave nothing), how fast it follows the scans' NIS, and the value at
# which it keeps the NIS (below 1, because the residuals of one wall are correlated). With a constant share of
# 0.2, the house is 1.75 cm off instead of 1.34 where odometry is 15 % noisy; starting from 1, 0.97 instead of
# 0.92 with the usual noise.
FIRST_SHARE, LEAST_SHARE = 0.3, 0.05
SHARE_RATE, USUAL_NIS = 0.05, 0.5
# The covariance of the pose is so many times that of the filter, and all walls together stand off by a share
# of a cell and a turn [rad] (standard deviations): with them its 95 % ellipses hold as many of the poses
# (benchmarks/coverage.py).
SPREAD, ALL_CELLS, ALL_TURN = 4.0, 0.2, 0.003


class FinePose:
    """The tracked pose; `correct` gives the estimate to publish."""

    def __init__(self, grid: OccupancyGrid) -> None:
        self._surfaces = fit_surfaces(grid)
        off = ALL_CELLS * grid.resolution
        self._map = np.diag(np.square([off, off, ALL_TURN]))
        self._filter: WallFilter | None = None
        self.share = FIRST_SHARE
        """Share of the alphas' standard deviation that odometry is believed to have."""
        self.covariance: Array | None = None
        """Covariance (3, 3) of the last corrected pose on the map; None where that was the cloud's."""

    def forget(self) -> None:
        """Stop tracking until the cloud is narrow again."""
        self._filter = None

    def predict(self, T_base_new: SE2, motion: tuple[float, float, float], std: Array) -> None:
        """Move by odometry: the motion, decomposed, and the standard deviations (3,) of its parts."""
        if self._filter is not None:
            self._filter.predict(T_base_new, motion, self.share * std)

    def correct(self, cloud: Estimate, points_base: Array) -> SE2:
        """Pose after a scan's end points (n, 2) in the base frame; the mean of the cloud if it is too
        wide."""
        tracked = self._filter
        if tracked is not None:
            self.share = next_share(self.share, tracked.correct(points_base))
        if tracked is None or not agree(tracked.T_map_base, cloud):
            tracked = self._filter = self._started(cloud)
            if tracked is not None:
                tracked.correct(points_base)
        if tracked is None or not agree(tracked.T_map_base, cloud):
            self.covariance = None
            return cloud.T_map_base
        self.covariance = SPREAD * tracked.covariance + self._map if len(points_base) else None
        return tracked.T_map_base

    def _started(self, cloud: Estimate) -> WallFilter | None:
        return WallFilter(self._surfaces, cloud.T_map_base, cloud.core) if narrow(cloud.core) else None


def next_share(share: float, nis: float) -> float:
    """The share of the alphas after a scan: odometry is trusted less if the scan's NIS is above the usual."""
    return min(max(share * (1.0 + SHARE_RATE * (nis - USUAL_NIS)), LEAST_SHARE), 1.0)


def agree(T_map_base: SE2, cloud: Estimate) -> bool:
    """Whether a pose is within three standard deviations of the cloud, or within what counts as narrow
    anyway."""
    offset = np.abs(T_map_base.xyt - cloud.T_map_base.xyt)
    offset[2] = abs(wrap(offset[2]))
    reach = np.maximum([NARROW_M, NARROW_M, NARROW_RAD], 3.0 * np.sqrt(np.diag(cloud.core)))
    return bool(np.all(offset <= reach))
