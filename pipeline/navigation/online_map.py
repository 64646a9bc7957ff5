"""SLAM while driving: every scan is placed once as it comes, loops are closed as the map is wanted.

The front end and the loop closure are the offline mapper's own, fed bit by bit; the grid while driving
shows the key scans. When the drive is over, `finish` maps the whole recording as the offline mapper does.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Observation, Recording, Scan, Trajectory
from turtlebag.pipeline.navigation.growing_clouds import GrowingClouds
from turtlebag.pipeline.slam.clouds import KNOTS, sweep_motion
from turtlebag.pipeline.slam.course import Course
from turtlebag.pipeline.slam.loops import BATCH, LoopFinder
from turtlebag.pipeline.slam.occupancy import make_grid
from turtlebag.pipeline.slam.slam import FRONT_ENDS, SlamConfig, run_slam
from turtlebag.pipeline.slam.steps import step_constraints

# A scan is kept when the robot has moved this far since the last one kept.
KEEP_M, KEEP_RAD = 0.1, 0.15
LEAST_SCANS = 3
HERE_M = 0.15
# Odometry samples that reach back past the start of a sweep.
RECENT = 32


@dataclass
class _Kept:
    """What is remembered of the scans kept, in their order: `odometry` (3,), `motion` (KNOTS, 3)."""

    scans: list[Scan] = field(default_factory=list)
    odometry: list[Array] = field(default_factory=list)
    motion: list[Array] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.scans)


class OnlineMap:
    """Takes in observations; `update` draws the map so far. The map frame is odometry's at the start."""

    def __init__(self, T_base_lidar: SE2, config: SlamConfig) -> None:
        self.T_map_odom = SE2.identity()
        self.grid: OccupancyGrid | None = None
        self._T_base_lidar, self._config = T_base_lidar, config
        self._stamps: list[int] = []
        self._odometry: list[SE2] = []
        self._kept = _Kept()
        self._clouds = GrowingClouds()
        self._course: Course | None = None
        self._loops: LoopFinder | None = None
        self._searched = 0
        self._distrusted: set[int] = set()

    def observe(self, observation: Observation) -> None:
        """Take in odometry, and place the scan if there is one and the robot has moved on."""
        self._stamps.append(observation.odometry.stamp_ns)
        self._odometry.append(observation.odometry.T_odom_base)
        scan = observation.scan
        if scan is None:
            return
        one = self._recording([scan], RECENT)
        at = one.T_odom_base
        assert at is not None
        if len(self._kept) >= LEAST_SCANS:
            x, y, yaw = (SE2(self._kept.odometry[-1]).inverse() @ at[0]).xyt
            if np.hypot(x, y) < KEEP_M and abs(yaw) < KEEP_RAD:
                return
        motion = sweep_motion(one) if scan.lidar.time_increment != 0.0 else None
        self._kept.scans.append(scan)
        self._kept.odometry.append(at.xyt[0])
        self._kept.motion.append(np.zeros((KNOTS, 3)) if motion is None else motion.xyt[0])
        self._place(one, motion)

    def distrust(self) -> None:
        """The robot has been pushing against something here: its scans since it came are not drawn.

        Wheels that turn on the spot bend the sweeps, by which each scan's beams are put in order.
        """
        assert self._course is not None
        here = self._course.pose[:2]
        for k in range(len(self._kept) - 1, 0, -1):
            if np.linalg.norm(self._course.poses[k][:2] - here) > HERE_M:
                break
            self._distrusted.add(k)

    @property
    def ready(self) -> bool:
        """Whether there is enough to map."""
        return len(self._kept) >= LEAST_SCANS

    def update(self) -> OccupancyGrid:
        """Close loops and draw what the key scans and the last one saw; also corrects `T_map_odom`."""
        course = self._course
        assert course is not None
        keys = np.array(course.keys)
        T_map_keys = self._closed(course, keys)
        last = len(self._kept) - 1
        T_last = T_map_keys[-1] @ (SE2(course.poses[keys[-1]]).inverse() @ SE2(course.pose))
        self.T_map_odom = T_last @ SE2(self._kept.odometry[last]).inverse()
        poses = {int(key): pose for key, pose in zip(keys, T_map_keys.xyt, strict=True)} | {last: T_last.xyt}
        shown = [k for k in poses if k not in self._distrusted]
        recording = self._recording([self._kept.scans[k] for k in shown], None)
        motion = SE2(np.array([self._kept.motion[k] for k in shown]))
        drawn_at = SE2(np.array([poses[k] for k in shown]))
        self.grid = make_grid(recording, drawn_at, self._config.grid, self._usable, motion)
        return self.grid

    def finish(self) -> OccupancyGrid:
        """The map of everything seen, as the offline mapper makes it."""
        result = run_slam(self.recording(), self._config)
        last = max(set(range(len(self._kept))) - self._distrusted)
        self.T_map_odom = result.trajectory.poses[-1] @ SE2(self._kept.odometry[last]).inverse()
        self.grid = result.grid
        return result.grid

    def recording(self) -> Recording:
        """What was kept, as a log."""
        trusted = [scan for k, scan in enumerate(self._kept.scans) if k not in self._distrusted]
        return self._recording(trusted, None)

    @property
    def _usable(self) -> float:
        return self._config.usable(self._kept.scans[0].lidar)

    def _recording(self, scans: list[Scan], recent: int | None) -> Recording:
        """Scans with the odometry about them, of which the last `recent` samples are enough or all needed."""
        first = 0 if recent is None else -recent
        odometry = Trajectory(np.array(self._stamps[first:]), SE2.stack(self._odometry[first:]))
        stamps = np.array([scan.stamp_ns for scan in scans])
        return Recording(
            source="exploration",
            stamps_ns=stamps,
            ranges=np.stack([scan.ranges for scan in scans]),
            lidar=scans[0].lidar,
            T_base_lidar=self._T_base_lidar,
            T_odom_base=odometry.at(stamps),
            odometry=odometry,
        )

    def _place(self, one: Recording, motion: SE2 | None) -> None:
        """The pose of the newest scan among the last key scans, by the front end."""
        self._clouds.append(one, self._usable, motion)
        odometry = np.array(self._kept.odometry)
        if self._course is None:
            make, clouds = FRONT_ENDS[self._config.front_end], self._clouds.view()
            self._course = Course(clouds, one, self._config.tracking, self._usable, make)
            return
        stamps = np.array([kept.stamp_ns for kept in self._kept.scans])
        self._course.extend(self._clouds.view(), odometry, stamps)
        before = SE2(self._course.pose)
        self._course.step()
        # What the last update corrected holds on; the front end's own step comes on top.
        T_map_last = self.T_map_odom @ SE2(odometry[-2])
        T_map_base = T_map_last @ (before.inverse() @ SE2(self._course.pose))
        self.T_map_odom = T_map_base @ SE2(odometry[-1]).inverse()

    def _closed(self, course: Course, keys: NDArray[np.int64]) -> SE2:
        """Key poses with the loops closed that were found among them."""
        track = course.track()
        steps = step_constraints(track, self._config.tracking)
        T_track_keys = track.T_track_base[keys]
        if not self._config.loops.enabled or len(keys) < 3:
            return T_track_keys
        part = np.zeros(len(keys), dtype=np.int64)
        clouds = self._clouds.view()
        if self._loops is None:
            self._loops = LoopFinder(clouds, keys, T_track_keys, steps, self._config.loops, part)
        else:
            self._loops.extend(clouds, keys, T_track_keys, steps, part)
        while self._searched < len(keys):
            batch = range(self._searched, min(self._searched + BATCH, len(keys)))
            self._loops.process(batch)
            self._searched = batch.stop
        return SE2(self._loops.poses)
