"""The types shared by all packages. Stamps are integer nanoseconds, everything else SI units and radians."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.findings import Finding
from turtlebag.datasets.se2 import SE2, Array, wrap
from turtlebag.datasets.sensor_times import SensorTimes

Stamps = NDArray[np.int64]

NOTHING_M = 0.01
"""A range below this is how some drivers write "no return"."""


@dataclass(frozen=True, slots=True)
class Twist:
    """Planar velocity of the base: forward [m/s] and counter-clockwise [rad/s]."""

    v: float = 0.0
    w: float = 0.0


@dataclass(frozen=True)
class LidarSpec:
    """Geometry of a planar lidar, as sensor_msgs/LaserScan states it.

    Beam i points at `angle_min + i * angle_increment` in the lidar frame and is taken
    `(i - first_beam) mod n_beams` times `time_increment` seconds after the scan's stamp (0: all at once; with
    a negative increment the beams are taken in the opposite order, and the stamp is still that of the first).
    A range is a return when `range_min <= r < range_max`; range_max and more, as +inf, is "no return", -inf
    "nearer than range_min", NaN invalid (REP-117).
    """

    n_beams: int
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    time_increment: float = 0.0
    scan_time: float = 0.0
    first_beam: int = 0

    def __post_init__(self) -> None:
        if self.n_beams < 1:
            raise ValueError(f"a lidar needs at least one beam, got {self.n_beams}")
        if not 0.0 <= self.range_min < self.range_max:
            raise ValueError(f"lidar ranges {self.range_min}..{self.range_max} m are not an interval")
        if not 0 <= self.first_beam < self.n_beams:
            raise ValueError(f"of {self.n_beams} beams, beam {self.first_beam} cannot be the first")

    @cached_property
    def order(self) -> NDArray[np.int64]:
        """How many beams are taken before each one, (n_beams,)."""
        place = (np.arange(self.n_beams) - self.first_beam) % self.n_beams
        return place if self.time_increment >= 0.0 else self.n_beams - 1 - place

    @cached_property
    def shares(self) -> Array:
        """When in the sweep each beam is taken, 0 for the first and 1 for the last, (n_beams,)."""
        return np.linspace(0.0, 1.0, self.n_beams)[self.order]

    @property
    def sweep_s(self) -> float:
        """Time from the first beam to the last [s]."""
        return abs(self.time_increment) * (self.n_beams - 1)

    @cached_property
    def angles(self) -> Array:
        """Beam angles in the lidar frame, (n_beams,)."""
        return self.angle_min + self.angle_increment * np.arange(self.n_beams, dtype=np.float64)

    @cached_property
    def directions(self) -> Array:
        """Unit vectors of the beams in the lidar frame, (n_beams, 2)."""
        return np.stack([np.cos(self.angles), np.sin(self.angles)], axis=-1)

    def turned_over(self) -> LidarSpec:
        """Its beams when mounted upside down, as seen from above; each keeps its time within the sweep."""
        return replace(self, angle_min=-self.angle_min, angle_increment=-self.angle_increment)

    def returns(self, ranges: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Which ranges [m] (any shape) are returns from a surface."""
        return (ranges >= max(self.range_min, NOTHING_M)) & (ranges < self.range_max)

    def silent(self, ranges: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Which ranges (any shape) mean "no return"."""
        return ranges >= self.range_max


@dataclass(frozen=True, eq=False, slots=True)
class Scan:
    """One sweep. `stamp_ns` is the time of the first beam; `ranges` is (n_beams,) float32 [m]; `sensor` says
    which of the robot's lidars took it."""

    stamp_ns: int
    ranges: NDArray[np.float32]
    lidar: LidarSpec
    sensor: int = 0

    def valid(self) -> NDArray[np.bool_]:
        """Which beams measured a surface, (n_beams,)."""
        return self.lidar.returns(self.ranges)

    def points_lidar(self) -> Array:
        """Measured points, (n_valid, 2) in the lidar frame, not deskewed."""
        ok = self.valid()
        return self.lidar.directions[ok] * self.ranges[ok, None].astype(np.float64)


@dataclass(frozen=True, eq=False)
class MountedLidar:
    """A lidar, its pose on the robot, and the topic of its scans, if they are from a bag."""

    spec: LidarSpec
    T_base_lidar: SE2
    topic: str = ""

    def same(self, other: MountedLidar) -> bool:
        """Whether the other one has the same beams at the same place."""
        return self.spec == other.spec and np.allclose(self.T_base_lidar.xyt, other.T_base_lidar.xyt)


@dataclass(frozen=True, slots=True)
class Odometry:
    """Wheel odometry at one instant; the twist is in the base frame."""

    stamp_ns: int
    T_odom_base: SE2
    twist: Twist


@dataclass(frozen=True, slots=True)
class Joints:
    """Wheel joints (left, right) at one instant: angle [rad] and speed [rad/s]."""

    stamp_ns: int
    position: tuple[float, float]
    velocity: tuple[float, float]


@dataclass(frozen=True, eq=False, slots=True)
class Imu:
    """One IMU sample in the IMU frame: angular velocity [rad/s] and specific force [m/s^2], (3,) each."""

    stamp_ns: int
    angular_velocity: Array
    linear_acceleration: Array


@dataclass(frozen=True, slots=True)
class Observation:
    """Sensor data of one control period, all that the robot knows. It never contains ground truth.

    `scan` is the sweep that ended in the period, if any: with a turning lidar
    its stamp is up to one scan time before `stamp_ns`. `cloud` is the same for a 3D lidar, with
    the stamp of its first beam [ns].
    """

    stamp_ns: int
    odometry: Odometry
    joints: Joints
    scan: Scan | None = None
    imu: tuple[Imu, ...] = ()
    cloud: tuple[int, Cloud] | None = None


def neighbours(stamps_ns: Stamps, wanted_ns: Stamps) -> tuple[Stamps, Stamps, Array]:
    """For each wanted stamp the indices of the (increasing) stamps before and after it, and its fraction
    0 to 1 between them; beyond the ends, the end stamps are used.
    """
    last = len(stamps_ns) - 1
    high = np.clip(np.searchsorted(stamps_ns, wanted_ns, side="right"), 1, max(last, 1))
    low, high = high - 1, np.minimum(high, last)
    # Differences of nanosecond integers are exact; seconds since 1970 as floats are not.
    span = np.maximum(stamps_ns[high] - stamps_ns[low], 1)
    return low, high, np.clip((wanted_ns - stamps_ns[low]) / span, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Stamped poses, in the order of their source (stamps need not be monotone)."""

    stamps_ns: Stamps
    poses: SE2

    def __post_init__(self) -> None:
        if self.poses.shape != self.stamps_ns.shape:
            raise ValueError(f"{self.stamps_ns.shape} stamps for {self.poses.shape} poses")

    @staticmethod
    def untimed(poses: SE2) -> Trajectory:
        """Poses (n,) without times, in order."""
        return Trajectory(np.arange(len(poses), dtype=np.int64), poses)

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def __str__(self) -> str:
        return f"{len(self)} poses, {self.length():.2f} m, {self.duration():.1f} s"

    def length(self) -> float:
        """Length of the path [m]."""
        return float(np.linalg.norm(np.diff(self.poses.xy, axis=0), axis=1).sum())

    def duration(self) -> float:
        """Span of the stamps [s]."""
        return seconds(int(np.ptp(self.stamps_ns))) if len(self) else 0.0

    def at(self, stamps_ns: Stamps) -> SE2:
        """Interpolated poses at the given stamps; beyond the ends, the end poses.

        Needs strictly increasing stamps (ValueError otherwise).
        """
        if len(self) == 0 or np.any(np.diff(self.stamps_ns) <= 0):
            raise ValueError("a trajectory must have increasing stamps to be interpolated")
        low, high, fraction = neighbours(self.stamps_ns, np.asarray(stamps_ns))
        return self.poses[low].interpolate(self.poses[high], fraction)

    def sampled(self, stamps_ns: Stamps) -> Trajectory:
        """The same path with poses at the given stamps, as `at` finds them."""
        return Trajectory(stamps_ns, self.at(stamps_ns))


@dataclass(frozen=True, eq=False)
class ImuLog:
    """IMU samples of a recording: stamps (n,), gyro and specific force (n, 3) in the IMU frame."""

    stamps_ns: Stamps
    angular_velocity: Array
    linear_acceleration: Array


@dataclass(frozen=True, eq=False)
class Recording:
    """A whole planar lidar log in memory, the input of mapping and localisation.

    `ranges` is (n_scans, n_beams) float32, one row per scan in file order, normalised to REP-117; NaN where a
    scan has fewer beams than that of another lidar. `lidar` and `T_base_lidar` are the only lidar, or the
    first; `others` are further ones, and `sensor` (n_scans,) says which of the `lidars` took each scan.
    `T_odom_base` is the odometry pose at each scan's stamp, (n_scans,), or None if the log has none;
    `odometry` is the full-rate stream if there is one (None for CARMEN logs, whose odometry comes with
    each scan). `notes` has one line for everything that was skipped or repaired while reading, and
    `findings` what of it is wrong with a bag.
    `odometry_late_s` is a delay of the odometry that was corrected; `turned_over` means that the lidar was
    flipped because of the odometry alone; `times` are the sensors' times as estimated.
    """

    source: str
    stamps_ns: Stamps
    ranges: NDArray[np.float32]
    lidar: LidarSpec
    T_base_lidar: SE2
    T_odom_base: SE2 | None = None
    odometry: Trajectory | None = None
    imu: ImuLog | None = None
    notes: tuple[str, ...] = field(default=())
    findings: tuple[Finding, ...] = field(default=())
    odometry_late_s: float = 0.0
    turned_over: bool = False
    times: SensorTimes = field(default_factory=SensorTimes)
    topic: str = ""
    others: tuple[MountedLidar, ...] = field(default=())
    sensor: NDArray[np.uint8] | None = None

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def lidars(self) -> tuple[MountedLidar, ...]:
        """All lidars."""
        return (MountedLidar(self.lidar, self.T_base_lidar, self.topic), *self.others)

    @property
    def lidar_of(self) -> NDArray[np.uint8]:
        """Which of the lidars took each scan, (n_scans,)."""
        return np.zeros(len(self), dtype=np.uint8) if self.sensor is None else self.sensor

    def parts(self) -> list[tuple[NDArray[np.int64], Recording]]:
        """The scans of each lidar alone: their numbers (k,), and a recording of them."""
        if not self.others:
            return [(np.arange(len(self)), self)]
        T, found = self.T_odom_base, []
        for number, lidar in enumerate(self.lidars):
            rows = np.flatnonzero(self.lidar_of == number)
            part = replace(
                self,
                stamps_ns=self.stamps_ns[rows],
                ranges=self.ranges[rows, : lidar.spec.n_beams],
                lidar=lidar.spec,
                T_base_lidar=lidar.T_base_lidar,
                topic=lidar.topic,
                T_odom_base=None if T is None else T[rows],
                others=(),
                sensor=None,
            )
            found.append((rows, part))
        return found

    @cached_property
    def stride(self) -> int:
        """Grid steps between the lidar's beams; more than 1 if several geometries share a finer grid."""
        scan, beam = np.nonzero(~np.isnan(self.ranges[:: 1 + len(self) // 400]))
        apart = np.diff(beam)[np.diff(scan) == 0]
        return int(np.bincount(apart).argmax()) if len(apart) else 1

    @property
    def path(self) -> Trajectory | None:
        """Odometry at its full rate, or where the log has none at the scans; None without odometry."""
        if self.odometry is not None or self.T_odom_base is None:
            return self.odometry
        return Trajectory(self.stamps_ns, self.T_odom_base)

    def scan(self, index: int) -> Scan:
        """One sweep of the log."""
        number = int(self.lidar_of[index])
        lidar = self.lidars[number].spec
        return Scan(int(self.stamps_ns[index]), self.ranges[index, : lidar.n_beams], lidar, number)

    def duration(self) -> float:
        """Span of the scan stamps [s]."""
        return seconds(int(np.ptp(self.stamps_ns))) if len(self) else 0.0


@dataclass(frozen=True, eq=False, slots=True)
class Cloud:
    """One 3D scan: points (n, 3) in the lidar frame [m]; their times after the stamp (n,) [s] if known."""

    points: Array
    times: Array | None = None


@dataclass(frozen=True, eq=False)
class Recording3D:
    """A 3D lidar log: scans in file order, each with the odometry at its stamp.

    `clouds` can be iterated any number of times, one cloud in memory at a time. `T_base_lidar` is
    (4, 4), identity if the log does not contain it (`mounted` is False then). As in `Recording`, there is no
    ground truth in it.
    """

    source: str
    stamps_ns: Stamps
    clouds: Iterable[Cloud]
    T_base_lidar: Array
    mounted: bool = True
    T_odom_base: SE2 | None = None
    odometry: Trajectory | None = None
    imu: ImuLog | None = None
    notes: tuple[str, ...] = field(default=())
    findings: tuple[Finding, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def duration(self) -> float:
        """Span of the scan stamps [s]."""
        return seconds(int(np.ptp(self.stamps_ns))) if len(self) else 0.0


@dataclass(frozen=True, eq=False)
class RobotModel:
    """The properties of a robot that planners and controllers use.

    `footprint` is a convex polygon, (n, 2) counter-clockwise in the base frame [m]; speeds in m/s and
    rad/s, accelerations in m/s^2 and rad/s^2 (the same for braking).
    """

    name: str
    footprint: Array
    max_v: float
    max_w: float
    max_dv: float
    max_dw: float

    @cached_property
    def circumscribed_radius(self) -> float:
        """Radius of the circle around the base origin that contains the footprint [m]."""
        return float(np.linalg.norm(self.footprint, axis=1).max())

    @cached_property
    def inscribed_radius(self) -> float:
        """Distance from the base origin to the nearest footprint edge [m]."""
        a, b = self.footprint, np.roll(self.footprint, -1, axis=0)
        edge = b - a
        cross = np.abs(edge[:, 0] * -a[:, 1] + edge[:, 1] * a[:, 0])
        return float((cross / np.linalg.norm(edge, axis=1)).min())


def yaw_difference(a: Array, b: Array) -> Array:
    """Absolute angle between yaws a and b [rad]."""
    return np.abs(wrap(a - b))
