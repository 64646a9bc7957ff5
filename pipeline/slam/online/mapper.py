"""Online SLAM: scan by scan while the robot drives, with work and memory bounded by counts, not by time.

Front end, loops and factors are the offline mapper's. Each scan is tracked as it comes; key scans wait for
their loops in a queue, with one alignment per scan, and iSAM2 (Kaess et al. 2012) solves the graph.
If a place has enough key scans, later ones are removed from the graph (a reduced pose graph,
Johannsson et al. 2012), so graph and clouds grow with the area seen and not with the time driven.

What needs the whole log is left to `finish`, which maps all scans as `run_slam` does: places recognised
beyond the reach of drift, refinement, the odometry's delay, the robot's own body in the scans, the gyro.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array, between, compose
from turtlebag.datasets.types import Imu, LidarSpec, MountedLidar, Recording, Scan, Trajectory
from turtlebag.pipeline.slam.graph.constraints import Constraint
from turtlebag.pipeline.slam.graph.refinement import refine
from turtlebag.pipeline.slam.grid import make_grid
from turtlebag.pipeline.slam.mapper import SlamConfig, run_slam
from turtlebag.pipeline.slam.odometry.front_ends import front_end_maker
from turtlebag.pipeline.slam.odometry.track import step_constraints
from turtlebag.pipeline.slam.odometry.tracker import FIELD_KEYS, Tracker
from turtlebag.pipeline.slam.online.loops import GrowingLoops
from turtlebag.pipeline.slam.online.memory import Columns, GrowingLog, GrowingScans
from turtlebag.pipeline.slam.scans.clouds import KeyScans
from turtlebag.pipeline.slam.scans.range_noise import SCANS, range_noise

# Key scans of one place: of this size, seen in one of this many directions.
PLACE_M, DIRECTIONS = 0.5, 8
# The track is lost if, in this many scans in a row, less than this share of the points in known space fits.
LOST_SCANS, LOST_AGREEMENT = 5, 0.6


class Kept(NamedTuple):
    """How much an online mapper keeps in memory."""

    tidy_scans: int = 256
    """After so many scans those that are no key scans are dropped, except the last ones."""
    last_scans: int = 64
    """The last ones, to which the front end may return after a gap."""
    place_keys: int = 3
    """So many key scans are enough for a place."""
    log_scans: int = 20_000
    """The whole log is kept up to so many scans."""


USUAL = Kept()


class Mapper:
    """Online mapper: scans in, pose and map out. The map's frame is the odometry's at the first scan; without
    odometry, the robot's."""

    def __init__(
        self,
        lidar: LidarSpec,
        T_base_lidar: SE2,
        config: SlamConfig | None = None,
        kept: Kept = USUAL,
        others: Sequence[MountedLidar] = (),
    ) -> None:
        """`others` are further lidars, whose scans have the `sensor` 1 and on."""
        lidars = MountedLidar(lidar, T_base_lidar), *others
        self.config, self._kept = config or SlamConfig(), kept
        self.jumps: list[float] = []
        """How far each closed loop moved the robot [m]."""
        self._log = GrowingLog(lidars)
        self._usable = self.config.usable(*lidars)
        self._scans = GrowingScans(self._usable)
        # of every scan of the log: the number of the last key, and the scan's pose relative to it
        self._by_key = Columns()
        self._tracker: Tracker | None = None
        self._loops: GrowingLoops | None = None
        self._T_map_track = np.zeros(3)
        self._misfits = 0

    def __len__(self) -> int:
        return len(self._log)

    def add(self, scan: Scan, odometry: SE2 | Trajectory | None, imu: Sequence[Imu] = ()) -> SE2:
        """Add a scan; returns T_map_base at its stamp.

        `odometry` is the pose T_odom_base at that stamp, or all its samples since the last scan's, to the end
        of the sweep (stamps must increase); the same kind, or none, for every scan. `imu` likewise.
        """
        self._log.append(scan, odometry, imu)
        self._append()
        tracker = self._tracker
        if tracker is None or self._loops is None:
            self._begin()
        else:
            self._extend(tracker)
            stamps = self._scans["stamp_ns"]
            tracker.step(seconds(int(stamps[-1] - stamps[-2])))
            self._judge(tracker)
            self._revise(tracker)
            self._close_loops(tracker, self._loops)
        assert self._tracker is not None
        assert self._loops is not None
        T_key_scan = between(self._tracker.pose_of(self._tracker.keys[-1]), self._tracker.pose)
        self._by_key.append(key=np.array([len(self._tracker.keys) - 1]), T_key_scan=T_key_scan[None])
        if len(self._scans) - len(self._tracker.keys) >= self._kept.tidy_scans + self._kept.last_scans:
            self._tidy(self._tracker, self._loops)
        return self.T_map_base

    @property
    def T_map_base(self) -> SE2:
        """Current estimate of the newest scan's pose."""
        assert self._tracker is not None
        return SE2(compose(self._T_map_track, self._tracker.pose))

    @property
    def T_map_odom(self) -> SE2:
        """The odometry frame on the map."""
        return self.T_map_base @ SE2(self._scans["T_odom_base"][-1]).inverse()

    @property
    def lost(self) -> bool:
        """Whether the newest scans fit the earlier ones so badly that their poses are guesses."""
        return self._misfits >= LOST_SCANS

    @property
    def fit(self) -> float:
        """The share of the newest scan's points in known space that lie on known surfaces, 0..1."""
        return 1.0 if self._tracker is None else self._tracker.placed.agreement

    @property
    def sigma_m(self) -> float | None:
        """Standard deviation of the robot's position on the map [m], by the graph for the last key scan
        checked for loops; None before."""
        return None if self._loops is None else self._loops.sigma_m

    @property
    def T_map_keys(self) -> SE2:
        """Poses of the key scans."""
        return SE2.identity(0) if self._loops is None else SE2(self._loops.poses)

    @property
    def keys(self) -> NDArray[np.int64]:
        """Numbers of the key scans among all added scans, from 0 on."""
        if self._tracker is None:
            return np.zeros(0, dtype=np.int64)
        return self._log.numbers[self._scans["number"][self._tracker.keys]]

    @property
    def trajectory(self) -> Trajectory:
        """Current estimates of the poses of all scans."""
        T_map_scans = self.T_map_keys[self._by_key["key"]] @ SE2(self._by_key["T_key_scan"])
        return Trajectory(self._log.stamps_ns, T_map_scans)

    @property
    def constraints(self) -> list[Constraint]:
        """Constraints between the key scans: steps and loops."""
        return [] if self._loops is None else [*self._loops.steps, *self._loops.loops]

    def distrust(self, within_m: float) -> None:
        """Leave out of the map the newest scans, since the robot came within `within_m` of its position."""
        away = np.linalg.norm(self.trajectory.poses.xy - self.T_map_base.xy, axis=1) > within_m
        self._log.trusted[int(np.flatnonzero(away)[-1]) + 1 if away.any() else 1 :] = False

    def map(self) -> OccupancyGrid:
        """The occupancy grid of the key scans and the newest scan."""
        numbers = self._scans["number"]
        assert self._tracker is not None
        T_map = {key: SE2(pose) for key, pose in zip(self._tracker.keys, self.T_map_keys.xyt, strict=True)}
        T_map[len(numbers) - 1] = self.T_map_base
        shown = [k for k in T_map if self._log.trusted[numbers[k]]]
        seen, motion = self._log.some(numbers[shown]), SE2(self._scans["motion"][shown])
        return make_grid(seen, SE2.stack([T_map[k] for k in shown]), self.config.grid, self._usable, motion)

    def finish(self) -> tuple[Trajectory, OccupancyGrid]:
        """Poses and map by the offline mapper from all scans; once old scans were dropped, by
        the refinement of the remaining ones."""
        if self._log.whole:
            result = run_slam(self.recording(), self.config)
            return result.trajectory, result.grid
        assert self._tracker is not None
        assert self._loops is not None
        keys, loops = np.array(self._tracker.keys), self._loops
        refined, _ = refine(self._scans.view(), keys, self.T_map_keys, loops.steps, self.config.refine)
        loops.poses = refined.xyt
        self._follow(self._tracker, loops)
        return self.trajectory, self.map()

    def recording(self) -> Recording:
        """All remaining trusted scans, as a log."""
        return self._log.recording()

    def _append(self) -> None:
        """Prepare the newest scan."""
        number = len(self._log) - 1
        if number < SCANS and number & (number + 1) == 0:
            # more scans give a better estimate of the lidar's noise
            self._scans.noise = range_noise(self._log.recording(), self._usable)
        self._scans.append(self._log.last(), number)

    def _begin(self) -> None:
        clouds, make = self._scans.view(), front_end_maker(self.config.front_end)
        self._tracker = Tracker(clouds, self._log.last(), self.config.tracking, self._usable, make)
        self._loops = GrowingLoops(clouds, self._tracker.pose, self.config.loops)

    def _extend(self, tracker: Tracker) -> None:
        odometry = self._scans["T_odom_base"] if self._log.has_odometry else None
        tracker.extend(self._scans.view(), odometry)

    def _judge(self, tracker: Tracker) -> None:
        """Count scans that do not fit. One without points says nothing if there is odometry."""
        blind = tracker.clouds.placed_by(tracker.scan) == "nothing"
        if blind and tracker.odometry is None:
            self._misfits += 1
        elif not blind:
            self._misfits = 0 if self.fit >= LOST_AGREEMENT else self._misfits + 1

    def _revise(self, tracker: Tracker) -> None:
        """Correct earlier scans that the newest one revises, relative to their keys."""
        key, T_key_scan = self._by_key["key"], self._by_key["T_key_scan"]
        for scan, _ in tracker.placed.revised:
            number = self._scans["number"][scan]
            T_key_scan[number] = between(tracker.pose_of(tracker.keys[key[number]]), tracker.pose_of(scan))

    def _close_loops(self, tracker: Tracker, loops: GrowingLoops) -> None:
        """A new key scan for the graph, if there is one, and one more alignment."""
        if len(tracker.keys) > len(loops.poses):
            steps = step_constraints(tracker.track(len(loops.poses) - 1), self.config.tracking)
            T_last_key = between(*tracker.last_keys(2)[1])
            loops.add_key(KeyScans(tracker.clouds, np.array(tracker.keys)), T_last_key, steps)
        before = self.T_map_base
        if loops.work():
            self._follow(tracker, loops)
            self.jumps.append(float(np.hypot(*(before.inverse() @ self.T_map_base).xy)))

    def _tidy(self, tracker: Tracker, loops: GrowingLoops) -> None:
        """Drop what is not needed any more: scans that are no key scans, and keys of well-seen places."""
        needed = loops.needed()
        needed[-FIELD_KEYS:] = True
        kept = needed | _first_of_places(loops.poses, self._kept.place_keys)
        stays = np.zeros(len(self._scans), dtype=bool)
        stays[-self._kept.last_scans :] = True
        stays[np.array(tracker.keys)] = kept
        self._scans.keep(stays)
        tracker.forget(~stays)
        self._extend(tracker)
        scans = KeyScans(tracker.clouds, np.array(tracker.keys))
        if not kept.all():
            self._hang_on(kept, loops.poses)
            loops.keep(kept, scans)
            self._follow(tracker, loops)
        else:
            loops.scans = scans
        if len(self._log) > self._kept.log_scans:
            self._drop_scans()

    def _drop_scans(self) -> None:
        """The log, too, keeps only scans with clouds."""
        stays = np.zeros(len(self._log), dtype=bool)
        stays[self._scans["number"]] = True
        self._log.keep(stays)
        self._by_key.keep(stays)
        self._scans["number"][:] = np.arange(len(self._scans))

    def _follow(self, tracker: Tracker, loops: GrowingLoops) -> None:
        """Move the track to the graph's pose of its last key scan."""
        self._T_map_track = (SE2(loops.poses[-1]) @ SE2(tracker.pose_of(tracker.keys[-1])).inverse()).xyt

    def _hang_on(self, kept: NDArray[np.bool_], T_map_keys: Array) -> None:
        """Poses relative to removed keys become relative to the last key before that stays."""
        before = np.maximum.accumulate(np.where(kept, np.arange(len(kept)), 0))
        key, T_map = self._by_key["key"], SE2(T_map_keys)
        T_new_old = (T_map[before].inverse() @ T_map)[key]
        T_key_scan = self._by_key["T_key_scan"]
        T_key_scan[:] = (T_new_old @ SE2(T_key_scan)).xyt
        key[:] = (np.cumsum(kept) - 1)[before[key]]


def _first_of_places(T_map_keys: Array, count: int) -> NDArray[np.bool_]:
    """Which of the keys (n, 3) are among the first `count` of their place, (n,)."""
    place = np.floor(T_map_keys / [PLACE_M, PLACE_M, 2.0 * np.pi / DIRECTIONS]).astype(np.int64)
    _, of = np.unique(place, axis=0, return_inverse=True)
    order = np.argsort(of, kind="stable")
    first = np.searchsorted(of[order], of[order])
    among = np.empty(len(of), dtype=bool)
    among[order] = np.arange(len(of)) - first < count
    return among
