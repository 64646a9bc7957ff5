"""What a running robot keeps: its log, and the scans that front end and loops still need."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.durations import nanoseconds
from turtlebag.datasets.motion import known_motion
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Imu, ImuLog, MountedLidar, Recording, Scan, Trajectory
from turtlebag.pipeline.slam.scans.clouds import PER_POINT, Clouds, make_clouds
from turtlebag.pipeline.slam.scans.range_noise import RangeNoise

# Odometry samples kept from before the start of a sweep.
RECENT = 64
# If mapping starts in the middle of a log, this much odometry from before is used, too [s].
BEFORE_S = 1.0


class Columns:
    """Named arrays of one length that grow along their first axis; capacity doubles, so appending is cheap.
    `columns[name]` are the rows so far, not copied; the first rows appended define the columns."""

    def __init__(self) -> None:
        self._room: dict[str, NDArray[Any]] = {}
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def __contains__(self, name: str) -> bool:
        return name in self._room

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self._room[name][: self._count]

    def append(self, **rows: NDArray[Any]) -> None:
        """Append rows to every column; ValueError if columns are missing or new."""
        if self._room and rows.keys() != self._room.keys():
            raise ValueError(f"rows of {', '.join(rows)}; those before were of {', '.join(self._room)}")
        count = self._count + len(next(iter(rows.values())))
        for name, new in rows.items():
            room = self._room.get(name)
            if room is None or count > len(room):
                grown = np.empty((max(1024, 2 * count), *new.shape[1:]), dtype=new.dtype)
                if room is not None:
                    grown[: self._count] = room[: self._count]
                self._room[name] = room = grown
            room[self._count : count] = new
        self._count = count

    def keep(self, stays: NDArray[np.bool_]) -> None:
        """Keep only these rows (n,); arrays handed out earlier stay as they are."""
        kept = {name: self[name][stays] for name in self._room}
        self._room, self._count = {}, 0
        if kept:
            self.append(**kept)


class GrowingScans:
    """The scans so far with their points and lines, each prepared once; old ones can be dropped.

    `scans[name]` has a row for each: `number` in the log, `stamp_ns`, `T_odom_base` (n, 3), zero without
    odometry, and `motion` (n, KNOTS, 3) during the sweep. `noise` is the lidar's, for those still to come.
    """

    def __init__(self, usable_m: float, noise: RangeNoise | None = None) -> None:
        self.usable_m, self.noise = usable_m, noise or RangeNoise()
        self._points, self._scans = Columns(), Columns()
        self._origin, self._bins = np.zeros((1, 2)), np.ones(1, dtype=np.int64)

    def __len__(self) -> int:
        return len(self._scans)

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self._scans[name]

    def append(self, recording: Recording, number: int) -> None:
        """Append a scan: a recording of it alone, and its number in the log."""
        motion, end = known_motion(recording), len(self._points)
        one = make_clouds(recording, self.usable_m, motion, self.noise)
        self._points.append(**{name: getattr(one, name) for name in PER_POINT})
        T_odom_base = recording.T_odom_base
        self._scans.append(
            table=np.where(one.table < 0, -1, one.table + end).astype(np.int32),
            end=end + one.starts[1:],
            number=np.array([number]),
            sensor=one.sensor,
            stamp_ns=recording.stamps_ns,
            T_odom_base=np.zeros((1, 3)) if T_odom_base is None else T_odom_base.xyt,
            motion=motion.xyt,
        )
        self._origin, self._bins = one.origin, one.bins

    def keep(self, stays: NDArray[np.bool_]) -> None:
        """Keep only these scans (n,), numbered anew."""
        ends = self._scans["end"]
        counts = np.diff(ends, prepend=0)
        self._points.keep(np.repeat(stays, counts))
        self._scans.keep(stays)
        new_ends, table = np.cumsum(counts[stays]), self._scans["table"]
        moved = (ends[stays] - new_ends)[:, None]
        table[:] = np.where(table < 0, -1, table - moved)
        self._scans["end"][:] = new_ends

    def view(self) -> Clouds:
        """The clouds of all current scans, without copying their points."""
        points, starts = {name: self._points[name] for name in PER_POINT}, np.append(0, self._scans["end"])
        scans = {"table": self._scans["table"], "starts": starts, "sensor": self._scans["sensor"]}
        return Clouds(**points, **scans, origin=self._origin, bins=self._bins)


class GrowingLog:
    """Scans with the odometry and the IMU around them, and whether they are to be drawn."""

    def __init__(self, lidars: Sequence[MountedLidar]) -> None:
        self._lidars = tuple(lidars)
        self._beams = max(lidar.spec.n_beams for lidar in lidars)
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
            ranges=np.pad(scan.ranges, (0, self._beams - len(scan.ranges)), constant_values=np.nan)[None],
            sensor=np.array([scan.sensor], dtype=np.uint8),
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
        imu, log, first = None, self._scans, self._lidars[0]
        if len(self._imu) and not recent:
            columns = self._imu["stamp_ns"], self._imu["angular_velocity"], self._imu["linear_acceleration"]
            imu = ImuLog(*columns)
        return Recording(
            source="the scans so far",
            stamps_ns=log["stamp_ns"][scans],
            ranges=log["ranges"][scans],
            lidar=first.spec,
            T_base_lidar=first.T_base_lidar,
            topic=first.topic,
            others=self._lidars[1:],
            sensor=log["sensor"][scans] if len(self._lidars) > 1 else None,
            T_odom_base=SE2(log["T_odom_base"][scans]) if self.has_odometry else None,
            odometry=self._stream(recent) if len(self._odometry) else None,
            imu=imu,
        )


def heard(recording: Recording, first: int = 0) -> Iterator[tuple[Scan, SE2 | Trajectory | None]]:
    """The scans of a log from one on, with the odometry since the last one, as `Mapper.add` takes them."""
    stream, begin = recording.odometry, 0
    if stream is not None and first > 0:
        earlier = np.searchsorted(stream.stamps_ns, recording.stamps_ns[first] - nanoseconds(BEFORE_S))
        begin = min(int(earlier), len(stream) - 1)
    for k in range(first, len(recording)):
        scan = recording.scan(k)
        if stream is None:
            yield scan, None if recording.T_odom_base is None else recording.T_odom_base[k]
            continue
        end = int(
            np.searchsorted(stream.stamps_ns, scan.stamp_ns + nanoseconds(scan.lidar.sweep_s), side="right")
        )
        end = len(stream) if k == len(recording) - 1 else max(end, begin + (k == first))
        yield scan, Trajectory(stream.stamps_ns[begin:end], stream.poses[begin:end])
        begin = end
