"""The log of a running robot: scans are appended, and it can be read as a `Recording`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.durations import nanoseconds
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Imu, ImuLog, LidarSpec, Recording, Scan, Trajectory
from turtlebag.pipeline.slam.online.columns import Columns

# Odometry samples kept from before the start of a sweep.
RECENT = 64
# If mapping starts in the middle of a log, this much odometry from before is used, too [s].
BEFORE_S = 1.0


def heard(recording: Recording, first: int = 0) -> Iterator[tuple[Scan, SE2 | Trajectory | None]]:
    """The scans of a log from one on, with the odometry since the last one, as `Mapper.add` takes them."""
    sweep_ns = nanoseconds(recording.lidar.time_increment * (recording.lidar.n_beams - 1))
    stream, begin = recording.odometry, 0
    if stream is not None and first > 0:
        earlier = np.searchsorted(stream.stamps_ns, recording.stamps_ns[first] - nanoseconds(BEFORE_S))
        begin = min(int(earlier), len(stream) - 1)
    for k in range(first, len(recording)):
        scan = recording.scan(k)
        if stream is None:
            yield scan, None if recording.T_odom_base is None else recording.T_odom_base[k]
            continue
        end = int(np.searchsorted(stream.stamps_ns, scan.stamp_ns + sweep_ns, side="right"))
        end = len(stream) if k == len(recording) - 1 else max(end, begin + (k == first))
        yield scan, Trajectory(stream.stamps_ns[begin:end], stream.poses[begin:end])
        begin = end


class GrowingLog:
    """Scans with the odometry and the IMU around them, and whether they are to be drawn."""

    def __init__(self, lidar: LidarSpec, T_base_lidar: SE2) -> None:
        self.lidar, self.T_base_lidar = lidar, T_base_lidar
        self.whole = True
        """Whether no scan was dropped."""
        self._scans, self._odometry, self._imu = Columns(), Columns(), Columns()
        self._added = 0

    def __len__(self) -> int:
        return len(self._scans)

    @property
    def has_odometry(self) -> bool:
        """Whether odometry comes with the scans."""
        return "T_odom_base" in self._scans

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """Stamps of all scans."""
        return self._scans["stamp_ns"]

    @property
    def numbers(self) -> NDArray[np.int64]:
        """The numbers of the remaining scans among all that were appended."""
        return self._scans["number"]

    @property
    def trusted(self) -> NDArray[np.bool_]:
        """Which scans may be mapped; may be changed in place."""
        return self._scans["trusted"]

    def append(self, scan: Scan, odometry: SE2 | Trajectory | None, imu: Sequence[Imu]) -> None:
        """One more scan; see `Mapper.add`."""
        at = {}
        if isinstance(odometry, Trajectory):
            self._odometry.append(stamp_ns=odometry.stamps_ns, T_odom_base=odometry.poses.xyt)
            at["T_odom_base"] = self._stream(RECENT).at(np.array([scan.stamp_ns])).xyt
        elif odometry is not None:
            at["T_odom_base"] = odometry.xyt[None]
        self._scans.append(
            stamp_ns=np.array([scan.stamp_ns], dtype=np.int64),
            ranges=scan.ranges[None],
            trusted=np.ones(1, dtype=np.bool_),
            number=np.array([self._added]),
            **at,
        )
        self._added += 1
        if imu:
            self._imu.append(
                stamp_ns=np.array([sample.stamp_ns for sample in imu], dtype=np.int64),
                angular_velocity=np.array([sample.angular_velocity for sample in imu]),
                linear_acceleration=np.array([sample.linear_acceleration for sample in imu]),
            )

    def keep(self, stays: NDArray[np.bool_]) -> None:
        """Keep only these scans (n,), and of the rest what the next scan needs."""
        self.whole = False
        self._scans.keep(stays)
        self._odometry.keep(np.arange(len(self._odometry)) >= len(self._odometry) - RECENT)
        self._imu = Columns()

    def last(self) -> Recording:
        """The newest scan alone."""
        return self._recording(slice(len(self) - 1, None), RECENT)

    def some(self, scans: NDArray[np.int64]) -> Recording:
        """Some scans (k,)."""
        return self._recording(scans, RECENT)

    def recording(self) -> Recording:
        """All scans that are trusted."""
        return self._recording(slice(None) if self.trusted.all() else self.trusted, 0)

    def _stream(self, recent: int) -> Trajectory:
        return Trajectory(self._odometry["stamp_ns"][-recent:], SE2(self._odometry["T_odom_base"][-recent:]))

    def _recording(self, scans: slice | NDArray[Any], recent: int) -> Recording:
        imu, log = None, self._scans
        if len(self._imu) and not recent:
            columns = self._imu["stamp_ns"], self._imu["angular_velocity"], self._imu["linear_acceleration"]
            imu = ImuLog(*columns)
        return Recording(
            source="the scans so far",
            stamps_ns=log["stamp_ns"][scans],
            ranges=log["ranges"][scans],
            lidar=self.lidar,
            T_base_lidar=self.T_base_lidar,
            T_odom_base=SE2(log["T_odom_base"][scans]) if self.has_odometry else None,
            odometry=self._stream(recent) if len(self._odometry) else None,
            imu=imu,
        )
