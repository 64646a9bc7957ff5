"""Deskewed scans around the robot, in the odometry frame."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from turtlebag.datasets.deskew import deskewed
from turtlebag.datasets.durations import nanoseconds, seconds
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Observation, Scan
from turtlebag.planners.tasks.sector_rule import Sectors, nearest, read_sectors
from turtlebag.sim.robots import RobotSpec

SILENT_S = 0.5
"""The robot stops after two lost scans in a row of a 5 Hz lidar."""


class OdometryBuffer:
    """The last odometry poses, for interpolation at a scan's stamp."""

    def __init__(self) -> None:
        self._samples: deque[tuple[int, SE2]] = deque(maxlen=32)

    def add(self, stamp_ns: int, T_odom_base: SE2) -> None:
        """Append the newest pose."""
        self._samples.append((stamp_ns, T_odom_base))

    def at(self, stamp_ns: int) -> SE2:
        """Odometry at a stamp, interpolated; outside of the buffer, its first or last pose."""
        newer = self._samples[-1]
        for sample in reversed(self._samples):
            if sample[0] <= stamp_ns:
                if newer[0] <= stamp_ns:
                    return newer[1]
                fraction = (stamp_ns - sample[0]) / (newer[0] - sample[0])
                return sample[1].interpolate(newer[1], fraction)
            newer = sample
        return newer[1]


def sweep_end_ns(scan: Scan) -> int:
    """Stamp of the end of a sweep [ns]."""
    return scan.stamp_ns + nanoseconds(scan.lidar.n_beams * abs(scan.lidar.time_increment))


@dataclass(frozen=True, eq=False)
class DeskewedScan:
    """One sweep in the odometry frame: end points of hits (n, 2), and of beams without return (m, 2).

    Beams nearer than the lidar can measure (-inf) are hits at its least range. `sensor` says which lidar took
    it; `others_odom` are the hits of the newest sweeps of the other lidars, and `sectors` are of all.
    """

    stamp_ns: int
    T_odom_lidar: SE2
    hits_odom: Array
    passes_odom: Array
    sectors: Sectors
    sensor: int = 0
    others_odom: tuple[Array, ...] = ()

    @property
    def around_odom(self) -> Array:
        """What all lidars hit, (n, 2)."""
        return np.concatenate([self.hits_odom, *self.others_odom]) if self.others_odom else self.hits_odom


class Sensing:
    """Keeps odometry and the newest sweep of each lidar."""

    @classmethod
    def of(cls, robot: RobotSpec) -> Sensing:
        """With all planar lidars of a robot."""
        first, *others = robot.mounted()
        return cls(first.T_base_lidar, [other.T_base_lidar for other in others])

    def __init__(self, T_base_lidar: SE2, others: Iterable[SE2] = ()) -> None:
        """The poses of the lidar and of further ones on the robot."""
        self.odometry = OdometryBuffer()
        self.sweep: DeskewedScan | None = None
        self.silent_s = 0.0
        """Time since the last scan of the lidar that has been silent longest [s]."""
        self.shown_ns: int | None = None
        """Stamp of the last observation [ns]."""
        self._T_base_lidars = T_base_lidar, *others
        self._heard_ns: dict[int, int] = {}
        self._newest: dict[int, DeskewedScan] = {}
        self._sectors: dict[int, Sectors] = {}

    @property
    def blind(self) -> bool:
        """Whether a lidar has been silent for too long to drive on."""
        return self.silent_s > SILENT_S

    def observe(self, observation: Observation) -> DeskewedScan | None:
        """Add an observation; the new sweep if it has one.

        Two drivers may share it: the second call with the same observation returns the same.
        """
        if observation.stamp_ns == self.shown_ns:
            return None if observation.scan is None else self.sweep
        self.shown_ns, odometry = observation.stamp_ns, observation.odometry
        self.odometry.add(odometry.stamp_ns, odometry.T_odom_base)
        if not self._heard_ns:
            self._heard_ns = dict.fromkeys(range(len(self._T_base_lidars)), observation.stamp_ns)
        if observation.scan is not None:
            self._heard_ns[observation.scan.sensor] = observation.stamp_ns
        self.silent_s = seconds(observation.stamp_ns - min(self._heard_ns.values()))
        if observation.scan is None:
            return None
        self.sweep = self._newest[observation.scan.sensor] = self._look(observation.scan)
        return self.sweep

    def points_base(self, T_odom_base: SE2) -> Array:
        """The hits of all lidars' newest sweeps as seen from the base now, (n, 2)."""
        if self.sweep is None:
            return np.zeros((0, 2))
        return T_odom_base.inverse() @ self.sweep.around_odom

    def _look(self, scan: Scan) -> DeskewedScan:
        T_base_lidar = self._T_base_lidars[scan.sensor]
        first, last = self.odometry.at(scan.stamp_ns), self.odometry.at(sweep_end_ns(scan))
        ranges = scan.ranges.astype(np.float64)
        near = np.isneginf(ranges) | (ranges < scan.lidar.range_min)
        hit = scan.valid() | near
        passed = scan.lidar.silent(scan.ranges)
        distance = np.where(near, scan.lidar.range_min, np.where(passed, scan.lidar.range_max, ranges))
        used = np.flatnonzero(hit | passed)
        origins, directions = deskewed(
            scan.lidar.directions[used],
            scan.lidar.order[used] / len(ranges),
            T_base_lidar.xyt,
            (first.inverse() @ last).xyt[None],
        )
        ends = first @ (origins + directions * distance[used, None])
        self._sectors[scan.sensor] = read_sectors(scan, float(T_base_lidar.yaw))
        return DeskewedScan(
            scan.stamp_ns,
            last @ T_base_lidar,
            ends[hit[used]],
            ends[passed[used]],
            nearest(self._sectors.values()),
            scan.sensor,
            tuple(one.hits_odom for number, one in self._newest.items() if number != scan.sensor),
        )
