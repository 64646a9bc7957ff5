"""Pose hypotheses under perceptual aliasing: other places that explain the scans as well as the estimate.

A global search ends in one place; in a building that repeats itself, another one explains the
scans as well. Each such place is kept as a hypothesis: a rigid motion of the map onto itself, which is
applied to every later estimate of the filter (multi-hypothesis localisation: Jensfelt,
Kristensen 2001). Later scans decide which one is right, each hypothesis aligned at its best.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2, Array, wrap
from turtlebag.pipeline.localisation.deskewed_beams import Beams
from turtlebag.pipeline.localisation.estimate import REACH_XY, REACH_YAW, main_cluster
from turtlebag.pipeline.localisation.global_search import (
    LEAST_EFFECTIVE,
    STAGE_PARTICLES,
    GlobalSearch,
)
from turtlebag.pipeline.localisation.local_search import climb
from turtlebag.pipeline.localisation.lost_detection import ALIKE, SETTLING

# Two places are so far apart [m] or turned so much [rad] - nearer ones the filter itself sorts out. Where
# less than this is explained, as on the map of another building, nothing can be said about other places.
APART, LEAST_FIT = 1.0, 0.7


@dataclass(frozen=True, eq=False)
class Keyframe:
    """A scan that the filter used, with odometry at its stamp."""

    beams: Beams
    T_odom_base: SE2


class Aliasing:
    """Finds the places that look like the estimate's, and weighs them against it scan by scan."""

    def __init__(self, search: GlobalSearch, rng: np.random.Generator) -> None:
        self._search, self._rng = search, rng

    def find(self, scans: Sequence[Keyframe], T_map_odom: SE2) -> list[SE2]:
        """Motions of the map onto itself, T_map_map, to the places that explain the scans about best.

        The first is the identity - the estimate `T_map_odom` itself - unless another place explains the
        scans clearly better. Only the identity is left where the map explains too little of them anyhow.
        """
        here = [T_map_odom @ scan.T_odom_base for scan in scans]
        found = [SE2.identity()]
        fits = [self.polish(found[0], scans, here)[0]]
        for scan, T_map_base in zip(scans, here, strict=True):
            for pose in self.places(scan.beams, [known @ T_map_base for known in found]):
                fit, T_map_map = self.polish(SE2.from_array(pose) @ T_map_base.inverse(), scans, here)
                # What was drawn beside a peak explains less, and must not stand for the place.
                explains = fit > max(LEAST_FIT, max(fits) - ALIKE)
                if explains and all(apart(T_map_map @ here[-1], known @ here[-1]) for known in found):
                    found.append(T_map_map)
                    fits.append(fit)
        return [T_map_map for T_map_map, fit in zip(found, fits, strict=True) if fit > max(fits) - ALIKE]

    def fits(self, hypotheses: Sequence[SE2], scan: Keyframe, T_map_odom: SE2) -> Array:
        """Agreement of a scan with the map under each of the hypotheses (n,), at the best pose near by."""
        here = [T_map_odom @ scan.T_odom_base]
        return np.array([self.polish(T_map_map, [scan], here)[0] for T_map_map in hypotheses])

    def places(self, beams: Beams, known: Sequence[SE2]) -> list[Array]:
        """Centres (3,) of the clusters of poses that one scan alone makes likely: a share that counts.

        Places that are `known` are not drawn: the likeliest would leave few poses to the others.
        """
        poses = self._search.draw(STAGE_PARTICLES, beams, self._rng, without=lambda p: at_one_of(known, p))
        places, fewest = [], LEAST_EFFECTIVE * STAGE_PARTICLES
        while len(poses) > fewest:
            centre = main_cluster(poses, np.full(len(poses), 1.0 / len(poses))).T_map_base.xyt
            near = within(poses, centre)
            if near.sum() <= fewest:
                break
            places.append(centre)
            poses = poses[~near]
        return places

    def polish(self, T_map_map: SE2, scans: Sequence[Keyframe], here: Sequence[SE2]) -> tuple[float, SE2]:
        """Mean agreement of the scans where it is highest near a hypothesis, and the hypothesis there."""
        last = here[-1]
        # The scans' poses hang together by odometry: all are moved with the last one.
        relative = [last.inverse() @ T_map_base for T_map_base in here]
        best, pose = climb(lambda poses: self.mean_agreement(poses, relative, scans), (T_map_map @ last).xyt)
        return best, SE2.from_array(pose) @ last.inverse()

    def mean_agreement(self, poses: Array, relative: Sequence[SE2], scans: Sequence[Keyframe]) -> Array:
        """Mean agreement (n,) of the scans with the map, where the last is taken from each of the poses
        (n, 3) and the others lie `relative` to it, T_last_base."""
        total = np.zeros(len(poses))
        for T_last_base, scan in zip(relative, scans, strict=True):
            there = np.ascontiguousarray((SE2(poses) @ T_last_base).xyt)
            total += self._search.agreements(there, scan.beams)
        return total / len(scans)


class PoseHypotheses:
    """Hypotheses as motions of the map onto itself, T_map_map, and how well each explains the scans."""

    def __init__(self, poses: Sequence[SE2]) -> None:
        self.poses = list(poses)
        self._fits: deque[Array] = deque(maxlen=SETTLING)

    def judge(self, fits: Array) -> SE2 | None:
        """Update with the agreement (n,) of a scan under each; the last hypothesis, if only one is left.

        Hypotheses that fall clearly behind (not ALIKE) over `SETTLING` scans are dropped.
        """
        self._fits.append(fits)
        if len(self._fits) == SETTLING:
            mean = np.mean(self._fits, axis=0)
            kept = mean > mean.max() - ALIKE
            self.poses = [pose for pose, stays in zip(self.poses, kept, strict=True) if stays]
            self._fits = deque((row[kept] for row in self._fits), maxlen=SETTLING)
        return self.poses[0] if len(self.poses) == 1 else None


def apart(one: SE2, other: SE2, reach: float = APART) -> Any:
    """Whether a pose and another (or each of many) are two places: farther apart than `reach` [m, rad]."""
    x, y, yaw = np.moveaxis((one.inverse() @ other).xyt, -1, 0)
    return (np.hypot(x, y) > reach) | (np.abs(yaw) > reach)


def at_one_of(places: Sequence[SE2], poses: Array) -> NDArray[np.bool_]:
    """Which poses (n, 3) are at one of the places, (n,) of bool."""
    return np.any([~apart(T_map_base, SE2(poses)) for T_map_base in places], axis=0)


def within(poses: Array, centre: Array) -> NDArray[np.bool_]:
    """Which poses (n, 3) are about a place, (n,) of bool."""
    near = np.hypot(poses[:, 0] - centre[0], poses[:, 1] - centre[1]) <= REACH_XY
    return np.asarray(near & (np.abs(wrap(poses[:, 2] - centre[2])) <= REACH_YAW), dtype=np.bool_)
