"""Front end: each scan matched with the last key scans, several hypotheses competing.

Odometry can lie (wheels slip, encoders freeze) and scans can be blind (corridors). Each scan is
therefore aligned from several starts - odometry, constant velocity - and scored by how well it fits
where the key scans looked; the alignment itself carries odometry as a heavy-tailed prior, which decides
the directions the scan cannot see and gives way where the scan contradicts it. Wheels that the scans
keep contradicting lose that say until the scans confirm them. Scans without surfaces (posts, legs)
are registered by KISS-ICP.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datasets.se2 import SE2, Array, between, compose
from datasets.types import Recording
from pipeline.slam.align import Alignment, align
from pipeline.slam.calibration import Calibration, calibrate
from pipeline.slam.clouds import MIN_LINES, Clouds, point_information
from pipeline.slam.correlative import best_pose, make_field
from pipeline.slam.odometry import LidarOdometry
from pipeline.slam.track import GAP_S, Track, TrackingConfig, confirms
from pipeline.slam.witnesses import Wheels

# A score must be that much higher to prefer a steady motion to the odometry's.
SURELY_BETTER = 0.05
# Without odometry the last motion is expected to go on, with this share of an odometry step's information.
STEADY_SHARE = 0.05
# Odometry is calibrated anew whenever the key scans have doubled since this many.
FIRST_CALIBRATION = 25
# For so many scans after a gap the motion since is open.
DOUBTED_SCANS = 12
# A scan fits when its cost is no more than this above what is usual.
FITS = 0.25
# Less of a scan than this on the surfaces of others tells nothing.
LEAST_OVERLAP = 0.3
# What a surprising odometry weighs against the misfit of points, of all of which it counts like so many.
SURPRISE = 0.03


@dataclass
class Doubt:
    """What went before a gap: the scan, its pose (3,), and for how many scans it is looked back at."""

    scan: int
    T_map_base: Array
    left: int = DOUBTED_SCANS


class Tracker:
    """State of the front end: the last pose, the velocity and the local map of key scans."""

    def __init__(self, clouds: Clouds, recording: Recording, config: TrackingConfig, max_range: float):
        self.clouds, self.config = clouds, config
        self.max_range = max_range
        self.kiss: LidarOdometry | None = None
        self._kiss_scan = -1
        self.odometry = None if recording.T_odom_base is None else recording.T_odom_base.xyt
        self.stamps = recording.stamps_ns
        self.doubt: Doubt | None = None
        self.wheels = Wheels(config.odometry)
        self.settled: range = range(0)
        self.keys: list[int] = []
        self.key_poses: list[Array] = []
        self._last = 0
        self.velocity = np.zeros(3)
        self.calibration = Calibration()
        self._next_calibration = FIRST_CALIBRATION
        self._has_reference = False
        self._usual_cost = 0.3

    def start(self, scan: int, T_map_base: Array) -> None:
        """The first scan defines the map."""
        self.pose = np.array(T_map_base, dtype=np.float64)
        self._add_key(scan)

    def extend(self, clouds: Clouds, T_odom_base: Array, stamps_ns: NDArray[np.int64]) -> None:
        """The log has gone on: all its scans, with odometry (n, 3) and stamps."""
        self.clouds, self.odometry, self.stamps = clouds, T_odom_base, stamps_ns

    def step(self, scan: int) -> tuple[Alignment, int]:
        """Pose of the next scan."""
        odometry_step = self._odometry_step(scan)
        if not self._has_reference:
            return self._carry(scan, odometry_step)
        believed = odometry_step is not None and self.wheels.believed
        steadily = self.velocity if self.wheels.believed else self.wheels.steady_step()
        steady = compose(self.pose, steadily)
        carried = steady if odometry_step is None else compose(self.pose, odometry_step)
        guess = carried if believed else steady
        information = self.config.odometry.information(steadily if odometry_step is None else odometry_step)
        if not believed:
            information *= STEADY_SHARE
        if self.config.kiss.enabled and self.clouds.placed_by(scan) == "points":
            result, source = self._by_points(scan, carried, steady)
        else:
            starts = [(0, guess)] if odometry_step is None else [(0, carried), (1, steady)]
            result, source = self._by_lines(scan, starts if believed else starts[::-1], information)
        new = result.T_map_base.xyt
        sure, self._last = self._judge(scan, result), scan
        if self.doubt is not None:
            self.wheels.forget()
        elif odometry_step is not None:
            self.wheels.judge(odometry_step, new, result.information)
        self.velocity = between(self.pose, new)
        self.pose = new
        if self._moved_enough() and self.can_be_key(scan) and sure:
            self._add_key(scan)
        return result, source

    def _judge(self, scan: int, found: Alignment) -> bool:
        """Begin a doubt at a gap; end it when odometry and scans agree on what happened since.

        Returns whether the pose found may be built on.
        """
        if self.odometry is None:
            return True
        waited = abs(int(self.stamps[scan]) - int(self.stamps[scan - 1])) > GAP_S * 1e9
        since = self.doubt or Doubt(scan - 1, self.pose)
        move = between(since.T_map_base, found.T_map_base.xyt)
        agreed = confirms(self._odometry_since(since.scan, scan), move)
        fits = found.cost <= self._usual_cost + FITS
        since.left -= 1
        if self.doubt is None and waited:
            self.doubt = since
        elif since.left <= 0 or (agreed and fits):
            self.doubt, self.settled = None, range(since.scan + 1, scan)
        return self.doubt is None or (agreed and found.overlap >= LEAST_OVERLAP)

    def _by_lines(
        self, scan: int, starts: list[tuple[int, Array]], information: Array
    ) -> tuple[Alignment, int]:
        """The scan on the surfaces of the last key scans; where it fits none, the first start."""
        guess = starts[0][1]
        points, config = self.clouds.of(scan)[:: max(1, self.clouds.lines(scan) // 90)], self.config
        searched, _ = best_pose(
            self.field, points, guess, config.search_m, config.search_rad, config.search_step_rad
        )
        best = self._best(scan, [*starts, (0, searched)], guess, information)
        if self.doubt is not None:
            step = self._odometry_since(self.doubt.scan, scan)
            carried = compose(self.doubt.T_map_base, step)
            other = self._best(scan, [(0, carried)], carried, self.config.odometry.information(step))
            if other is not None and (best is None or other[2] < best[2]):
                best = other
        if best is None or best[2] > self._usual_cost + FITS:
            wide = self._recover(scan, [pose for _, pose in starts])
            again = self._best(scan, [(3, wide)], guess, information)
            if again is not None and (best is None or again[2] < best[2] - 0.05):
                best = again
        if best is None:
            return Alignment(SE2(guess), np.zeros((3, 3)), 0.0, 0.0, 0.0), 0
        self._usual_cost += 0.02 * (best[2] - self._usual_cost)
        return best[0], best[1]

    def _by_points(self, scan: int, guess: Array, steady: Array) -> tuple[Alignment, int]:
        """The scan by KISS-ICP: posts and legs are points without a surface to slide along."""
        points, config = self.clouds.of(scan), self.config
        if self.kiss is None or self._kiss_scan != scan - 1:
            self.kiss = self._kiss_of_keys()
        self._kiss_scan = scan
        found = [self.kiss.register(points, start) for start in (guess, steady)]
        scores = [best_pose(self.field, points, pose, 0.0, 0.0, 1.0)[1] for pose in found]
        best = int(scores[1] > scores[0] + SURELY_BETTER)
        if scores[best] < config.kiss.min_score:
            self.kiss.update(points, guess, guess)
            return Alignment(SE2(guess), np.zeros((3, 3)), scores[best], 0.0, 1.0), 0
        self.kiss.update(points, found[best], guess)
        information = point_information(points) / config.sigma_m**2
        return Alignment(SE2(found[best]), information, scores[best], 0.0, 1.0 - scores[best]), 2

    def _kiss_of_keys(self) -> LidarOdometry:
        """KISS-ICP with the map of the last key scans."""
        kiss = LidarOdometry(self.config.kiss, self.max_range)
        n = self.config.field_keys
        for key, pose in zip(self.keys[-n:], self.key_poses[-n:], strict=True):
            kiss.update(self.clouds.of(key), pose, pose)
        return kiss

    def can_be_key(self, scan: int) -> bool:
        """Whether other scans can be matched with this one."""
        if self.clouds.lines(scan) >= MIN_LINES:
            return True
        return self.config.kiss.enabled and self.clouds.placed_by(scan) == "points"

    def _carry(self, scan: int, odometry_step: Array | None) -> tuple[Alignment, int]:
        """Before the first scan with surfaces there is nothing to match with: odometry carries."""
        if odometry_step is not None:
            self.pose = compose(self.pose, odometry_step)
        if self.can_be_key(scan):
            self._add_key(scan)
        return Alignment(SE2(self.pose), np.zeros((3, 3)), 0.0, 0.0, 0.0), 0

    def _odometry_step(self, scan: int) -> Array | None:
        if self.odometry is None:
            return None
        return self._odometry_since(scan - 1, scan)

    def take_settled(self) -> list[tuple[int, Array]]:
        """Scans since a gap, once it is clear what happened in it: their poses (3,) as odometry has them seen
        from the pose found last. Hypotheses took turns for them before."""
        found = [
            (scan, compose(self.pose, self._odometry_since(self._last, scan)))
            for scan in self.settled
            if scan not in self.keys
        ]
        self.settled = range(0)
        return found

    def _odometry_since(self, before: int, scan: int) -> Array:
        assert self.odometry is not None
        return self.calibration.corrected(between(self.odometry[before], self.odometry[scan]))

    def key_odometry(self) -> Array:
        """Raw odometry steps between successive key scans, (keys - 1, 3)."""
        assert self.odometry is not None
        T = SE2(self.odometry[self.keys])
        return (T[:-1].inverse() @ T[1:]).xyt

    def calibrated(self) -> Calibration:
        """The odometry's systematic errors as far as the key scans show them."""
        if self.odometry is None or not self.config.calibration or len(self.keys) < 2:
            return Calibration()
        keys = np.array(self.keys)
        return calibrate(self.clouds, keys, SE2(np.array(self.key_poses)), SE2(self.odometry[keys]))

    def _best(
        self, scan: int, starts: Iterable[tuple[int, Array]], prior: Array, information: Array
    ) -> tuple[Alignment, int, float] | None:
        """The alignment of least cost over the starts; cost is per usable point, 0 good .. 1 bad."""
        config, best = self.config, None
        usable = self.clouds.lines(scan)
        if usable < MIN_LINES:
            return None
        tried: list[Array] = []
        keys, poses = self._references()
        for source, start in starts:
            # starts this near each other end at the same pose
            if any(np.abs(between(other, start)).max() < 0.03 for other in tried):
                continue
            tried.append(start)
            result = align(
                self.clouds,
                scan,
                start,
                keys,
                poses,
                gate=config.gate_m,
                sigma=config.sigma_m,
                prior=prior,
                prior_information=information,
                prior_soft=config.odometry.soft,
                most_points=config.most_points,
            )
            e = between(prior, result.T_map_base.xyt)
            surprise = np.log1p(e @ information @ e / config.odometry.soft**2)
            # what the key scans could not see is neither hit nor miss
            fit = result.known * result.cost + (1.0 - result.known) * self._usual_cost
            cost = fit + SURPRISE * float(surprise)
            if best is None or cost < best[2]:
                best = (result, source, cost)
        return best

    def _recover(self, scan: int, centers: list[Array]) -> Array:
        """Exhaustive search in a wide window about each centre: the track may be lost."""
        points = self.clouds.of(scan)[::4]
        config = self.config
        found = [
            best_pose(self.field, points, center, config.recovery_m, config.recovery_rad, 0.035)
            for center in centers[:2]
        ]
        return max(found, key=lambda pair: pair[1])[0]

    def _references(self) -> tuple[NDArray[np.int64], Array]:
        n = self.config.reference_keys
        return np.array(self.keys[-n:]), np.array(self.key_poses[-n:])

    def _moved_enough(self) -> bool:
        delta = between(self.key_poses[-1], self.pose)
        config = self.config
        return bool(
            np.hypot(delta[0], delta[1]) > config.key_distance_m or abs(delta[2]) > config.key_turn_rad
        )

    def _add_key(self, scan: int) -> None:
        self.keys.append(scan)
        self.key_poses.append(self.pose)
        self._has_reference = self._has_reference or self.can_be_key(scan)
        if len(self.keys) == self._next_calibration:
            self.calibration = self.calibrated()
            self._next_calibration *= 2
        n, config = self.config.field_keys, self.config
        self.field = make_field(
            self.clouds,
            np.array(self.keys[-n:]),
            np.array(self.key_poses[-n:]),
            config.field_resolution_m,
            config.field_sigma_m,
        )


def track_log(
    recording: Recording, clouds: Clouds, config: TrackingConfig, max_range: float, scans: Iterable[int]
) -> Track:
    """Run the front end over a log; `scans` yields 1, 2, ... (wrapped in a progress bar by callers)."""
    n = len(recording)
    poses = np.zeros((n, 3))
    overlap, rmse = np.ones(n), np.zeros(n)
    information, source = np.zeros((n, 3, 3)), np.zeros(n, dtype=np.int8)
    if recording.T_odom_base is not None:
        poses[0] = recording.T_odom_base.xyt[0]
    tracker = Tracker(clouds, recording, config, max_range)
    tracker.start(0, poses[0])
    for scan in scans:
        result, source[scan] = tracker.step(scan)
        poses[scan] = result.T_map_base.xyt
        overlap[scan], rmse[scan] = result.overlap, result.rmse
        information[scan] = result.information
        for before, pose in tracker.take_settled():
            poses[before] = pose
    calibration = tracker.calibrated()
    steps = None if tracker.odometry is None else calibration.corrected(tracker.key_odometry())
    keys = np.array(tracker.keys)
    usable = np.array([tracker.can_be_key(scan) for scan in range(n)])
    return Track(SE2(poses), keys, overlap, rmse, information, source, steps, calibration, usable)
