"""ICP odometry (front end `lines`): each scan matched with the last key scans, several hypotheses competing.

Odometry can be wrong (wheels slip, encoders freeze) and scans can be blind (corridors). Each scan is
therefore aligned from several starts - odometry, constant velocity, standstill - and scored by how well it
fits where the key scans looked. Odometry is a heavy-tailed prior of the alignment: it determines
the directions that the scan cannot observe and gives way where the scan contradicts it. Wheels that the scans
keep contradicting are ignored until the scans confirm them. Scans without surfaces (posts, legs)
are registered by KISS-ICP.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from turtlebag.datasets.motion import ANY_ROBOT
from turtlebag.datasets.se2 import SE2, Array, between, compose
from turtlebag.pipeline.slam.odometry.front_end import Placed
from turtlebag.pipeline.slam.odometry.kiss import KissIcp
from turtlebag.pipeline.slam.odometry.track import HYPOTHESES, STEADY_SHARE, confirms
from turtlebag.pipeline.slam.odometry.tracker import Tracker
from turtlebag.pipeline.slam.odometry.trust import OdometryTrust
from turtlebag.pipeline.slam.scans.align import Alignment, Prior, align
from turtlebag.pipeline.slam.scans.correlative import best_pose
from turtlebag.pipeline.slam.scans.correspondences import Limits

STANDSTILL = HYPOTHESES.index("standstill")
# Gauss-Newton steps from one start.
ITERATIONS = 10
# For this many scans after a gap the motion across it is uncertain.
DOUBTED_SCANS = 12
# A scan fits if its cost exceeds the usual cost by no more than this; the usual cost starts at this value and
# follows that of each scan with this weight.
FITS, USUAL_COST, FOLLOWS = 0.25, 0.3, 0.02
# Where the track may be lost, the scan is searched within this window [m, rad]; if this share of it fits, no
# farther than any robot drives meanwhile, because beyond it fits only places that look alike. At the right
# place of an unseen maze 0.71 fitted, after robots were carried by 0.9 m 0.35 to 0.52.
LOST, HALF = 1.0, 0.5
# The place found by this search must cost less by this much than that of the track.
SURELY_BETTER = 0.05
# Weight of the odometry's normalised innovation squared (NIS, under a Cauchy kernel) against the misfit of
# points, as if it were this many of all points.
NIS_WEIGHT = 0.01


Found = tuple[Alignment, int, float]
"""An alignment, its start, and its cost."""


@dataclass
class Doubt:
    """The state before a gap: the pose (3,) of the last scan, whether the wheels were trusted, and how many
    scans ago it was."""

    T_map_base: Array
    wheels_believed: bool
    ago: int = 1


class Lines:
    """Point-to-line alignment; keeps the odometry's record and the state before a gap."""

    def __init__(self, tracker: Tracker) -> None:
        self.tracker = tracker
        self.doubt: Doubt | None = None
        self.wheel_trust = OdometryTrust(tracker.config.odometry)
        self._by_points = KissIcp(tracker)
        self._usual_cost = USUAL_COST

    def step(self, points: Array, odometry_step: Array | None, wait_s: float) -> Placed:
        """As in `FrontEnd`."""
        tracker, scan = self.tracker, self.tracker.scan
        if tracker.clouds.placed_by(scan) == "points":
            by_points = self._by_points.step(points, odometry_step, wait_s)
            fit, source = by_points.overlap, by_points.source
            at = SE2(by_points.T_track_base)
            found = Alignment(at, by_points.information, fit, by_points.rmse, 1.0 - fit)
        else:
            found, source = self._on_surfaces(scan, odometry_step, abs(wait_s))
        matched, (found, sure, settled) = found, self._judge(scan, found)
        pose, source = found.T_map_base.xyt, source if found is matched else 0
        if self.doubt is not None:
            self.wheel_trust.forget()
        elif odometry_step is not None:
            self.wheel_trust.judge(odometry_step, pose, found.information)
        revised = tuple((k, compose(pose, tracker.odometry_since(scan, k))) for k in settled)
        return Placed(pose, found.information, found.overlap, found.rmse, source, sure, revised, found.known)

    def _on_surfaces(self, scan: int, odometry_step: Array | None, wait_s: float) -> tuple[Alignment, int]:
        """The starts: the odometry, if there is any and it is trusted, and constant velocity."""
        tracker = self.tracker
        starts, share = [(1, compose(tracker.pose, tracker.velocity))], STEADY_SHARE
        expected = tracker.velocity if odometry_step is None else odometry_step
        if odometry_step is not None:
            starts.append((0, compose(tracker.pose, odometry_step)))
            if self.wheel_trust.trusted:
                starts, share = starts[::-1], 1.0
        return self._by_lines(scan, starts, share * tracker.config.odometry.information(expected), wait_s)

    def _judge(self, scan: int, found: Alignment) -> tuple[Alignment, bool, range]:
        """Begin a doubt at a gap, and end it when odometry and scans agree on the motion since.

        If they do not agree in time, the odometry is taken to be right if the scan fits nothing, or if it was
        trusted before the gap and the scan's pose is not certain: a scan may fit somewhere nearby by chance.
        Returns the scan's pose, whether it is certain, and, once the doubt is over, the scans since the gap:
        hypotheses alternated for them, and trusted odometry gives their poses relative to this one.
        """
        tracker, settled = self.tracker, range(0)
        if tracker.odometry is None:
            return found, True, settled
        since = self.doubt or Doubt(tracker.pose, self.wheel_trust.trusted)
        driven = tracker.odometry_since(scan - since.ago)
        agreed = confirms(driven, between(since.T_map_base, found.T_map_base.xyt))
        fits = found.cost <= self._usual_cost + FITS
        if self.doubt is None and tracker.after_gap:
            self.doubt = since
        elif since.ago >= DOUBTED_SCANS or (agreed and fits):
            self.doubt, believed = None, since.wheels_believed
            there = found.possible and (found.certain or not believed)
            if not (agreed or there):
                found = _fits_nothing(compose(since.T_map_base, driven))
            if agreed or believed or not there:
                settled = range(scan - since.ago + 1, scan)
        since.ago += 1
        return found, self.doubt is None or (agreed and found.possible), settled

    def _by_lines(
        self, scan: int, starts: list[tuple[int, Array]], information: Array, wait_s: float
    ) -> tuple[Alignment, int]:
        """The scan aligned with the last key scans; the first start if it fits none."""
        guess = starts[0][1]
        tracker, config = self.tracker, self.tracker.config
        best = self._best(scan, starts, guess, information)
        if self.doubt is not None:
            step = tracker.odometry_since(scan - self.doubt.ago)
            carried = compose(self.doubt.T_map_base, step)
            other = self._best(scan, [(0, carried)], carried, config.odometry.information(step))
            best = other if _beats(other, best) else best
        if any(math.dist(start[:2], tracker.pose[:2]) > Limits.rough().gate for _, start in starts):
            # wheels may spin in front of an obstacle, farther than partners are searched
            still = self._best(scan, [(STANDSTILL, tracker.pose)], guess, information)
            if still is not None and still[0].certain and _beats(still, best):
                best = still
        if best is None or best[2] > self._usual_cost + FITS:
            there = best is not None and best[0].overlap >= HALF
            window = [min(LOST, speed * wait_s) if there else LOST for speed in ANY_ROBOT]
            wide = self._recover(scan, [pose for _, pose in starts], *window)
            again = self._best(scan, [(3, wide)], guess, information)
            best = again if _beats(again, best, by=SURELY_BETTER) else best
        if best is None:
            return _fits_nothing(guess), 0
        self._usual_cost += FOLLOWS * (best[2] - self._usual_cost)
        return best[0], best[1]

    def _best(
        self, scan: int, starts: Iterable[tuple[int, Array]], prior: Array, information: Array
    ) -> Found | None:
        """The alignment of least cost over the starts; cost is per usable point, 0 good .. 1 bad."""
        tracker, best = self.tracker, None
        if not tracker.clouds.has_lines(scan):
            return None
        tried: list[Array] = []
        keys, poses = tracker.last_keys()
        limits, odometry = Limits.rough().of_one_scan(ITERATIONS), Prior.of_odometry(prior, information)
        for source, start in starts:
            # starts too close for a good match to distinguish end at the same pose
            if any(np.abs(between(other, start)).max() < Limits.fine().sigma for other in tried):
                continue
            tried.append(start)
            result = align(tracker.clouds, scan, start, keys, poses, limits, odometry)
            # Points in space that the key scans did not see are half a miss: a pose where everything is seen
            # again is more probable than one in unseen space, or odometry that jumps would win by leaving the
            # known area.
            unseen = 1.0 - result.known
            fit = result.known * result.cost + unseen * (self._usual_cost + 0.5 * FITS)
            cost = fit + NIS_WEIGHT * odometry.cost(result.T_map_base.xyt)
            if best is None or cost < best[2]:
                best = (result, source, cost)
        return best

    def _recover(self, scan: int, centers: list[Array], window_m: float, window_rad: float) -> Array:
        """Exhaustive search in a wide window around each centre, because the track may be lost."""
        points = self.tracker.clouds.of(scan)[::4]
        field = self.tracker.field
        found = [best_pose(field, points, center, window_m, window_rad) for center in centers]
        return max(found, key=lambda pair: pair[1])[0]


def _beats(one: Found | None, best: Found | None, by: float = 0.0) -> bool:
    """Whether one costs less than the best so far."""
    return one is not None and (best is None or one[2] < best[2] - by)


def _fits_nothing(pose: Array) -> Alignment:
    """A scan of which only the pose (3,) is known."""
    return Alignment(SE2(pose), np.zeros((3, 3)), 0.0, 0.0, 0.0)
