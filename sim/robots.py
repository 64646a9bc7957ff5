"""Robots: YAML specifications of differential drives with a planar lidar."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, field_validator

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.types import LidarSpec, MountedLidar, RobotModel
from turtlebag.datasets.yaml_files import find_named, known_names, load_model

FOLDER = Path(__file__).parent / "robots"
CONTROL_HZ = 30
"""Commands and observations a second, of every robot: the rate of the TurtleBot3's own /odom."""
PERIOD_S = 1.0 / CONTROL_HZ
"""From a control step to the next."""

MOST = 1e6
"""No number of a robot is larger, in whichever unit."""
Number = Annotated[float, Field(ge=-MOST, le=MOST, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, le=MOST, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0.0, le=MOST, allow_inf_nan=False)]
Vector = tuple[Number, Number, Number]


def _divides(rate_hz: float) -> float:
    """ValueError when scans would not fall on control steps."""
    steps = CONTROL_HZ / rate_hz
    if steps < 1.0 or abs(steps - round(steps)) > 1e-9:
        raise ValueError(f"{CONTROL_HZ} must be a whole multiple of it, got {rate_hz:g}")
    return rate_hz


Rate = Annotated[Positive, AfterValidator(_divides)]
"""Turns of a lidar a second."""
LidarName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,30}$")]


class Limits(Settings):
    """Limits that the motor layer enforces on every command: speeds, accelerations, and rim acceleration."""

    max_v: Positive
    max_w: Positive
    max_dv: Positive
    max_dw: Positive
    wheel_acceleration: Positive
    command_delay: Annotated[float, Field(ge=0.0, le=2.0)] = 0.0
    """From a command until it reaches the motors [s], in whole control steps."""


class _Part(Settings):
    """A rigid part of the body: collision shape at `center`, mass at `com`, all in base_footprint."""

    name: str
    center: Vector
    mass: Positive
    com: Vector
    inertia: tuple[Positive, Positive, Positive]


class BoxPart(_Part):
    """A box-shaped part."""

    kind: Literal["box"]
    size: tuple[Positive, Positive, Positive]


class SpherePart(_Part):
    """A ball: casters."""

    kind: Literal["sphere"]
    radius: Positive


Part = Annotated[BoxPart | SpherePart, Field(discriminator="kind")]


class Wheels(Settings):
    """Two driven wheels. `radius` and `joint_y` are true, `controller_radius` (None: the true one) and
    `separation` are the controller's values.
    """

    radius: Positive
    width: Positive
    joint_y: Positive
    separation: Positive
    mass: Positive
    inertia: tuple[Positive, Positive, Positive]
    torque: Positive
    encoder_ticks: int = Field(gt=0)
    friction: Positive = 0.5
    """On the floor, unless a run sets `physics.friction`."""
    controller_radius: Positive | None = None
    turn_per_m: Annotated[float, Field(ge=-0.5, le=0.5)] = 0.0
    """How much it turns where its odometry says straight ahead, as one wheel is larger [rad/m]."""
    calibration_error: Annotated[float, Field(ge=0.0, lt=0.5)] = 0.01
    """The controller's radius and track are wrong by up to this share, drawn once per run."""
    slip: Annotated[float, Field(ge=0.0, le=0.1)] | None = None
    turn_slip: Annotated[float, Field(ge=0.0, le=0.5)] | None = None
    """Random slip, as in `sim.odometry`; None: by `sim.sensors`."""


class LidarErrors(Settings):
    """Errors of a lidar's readings; standard deviations unless stated otherwise.

    Per beam: `sigma` [m] and `sigma_square` [1/m], which grows with the square of the distance as in a
    triangulating lidar; `angle_deg`, the direction error; and the `resolution` [m]. Per turn:
    `turn_scale`, a share of all its distances; `jitter`, a share of its time; `stamp_delay` [s], from the
    first beam to the stamp, uniform between the two values. Per unit, drawn once per run:
    `offset` [m], `scale`, `square` [1/m], and `speed`, a share of the rotation rate. Lost beams: a share
    `lost` of all, and exp(-c / grazing) of those that hit a surface at a cosine c to its normal. What is
    known of this very unit comes on top of what is drawn: `known_offset` [m], `known_square` [1/m].
    """

    sigma: NonNegative = 0.01
    sigma_square: NonNegative = 0.0
    angle_deg: NonNegative = 0.0
    resolution: NonNegative = 0.0
    turn_scale: NonNegative = 0.0
    jitter: Annotated[float, Field(ge=0.0, le=0.05)] = 0.0
    stamp_delay: tuple[NonNegative, NonNegative] = (0.0, 0.0)
    offset: NonNegative = 0.0
    scale: NonNegative = 0.0
    square: NonNegative = 0.0
    speed: Annotated[float, Field(ge=0.0, le=0.05)] = 0.0
    known_offset: Annotated[float, Field(ge=-0.5, le=0.5)] = 0.0
    known_square: Annotated[float, Field(ge=-0.1, le=0.1)] = 0.0
    lost: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    grazing: NonNegative = 0.0

    @field_validator("stamp_delay")
    @classmethod
    def _in_order(cls, delay: tuple[float, float]) -> tuple[float, float]:
        if delay[1] < delay[0] or delay[1] > 0.2:
            raise ValueError("from and to in seconds, 0.2 at most")
        return delay


class Lidar(Settings):
    """A planar lidar at `pose` in base_footprint, `height` over the floor."""

    pose: Vector
    height: Positive
    n_beams: int = Field(gt=0, le=10_000)
    angle_min: Number
    angle_increment_deg: Annotated[Positive, Field(le=360.0)]
    range_min: Positive
    range_max: Positive
    rate_hz: Rate
    sweep: Annotated[float, Field(ge=-1.0, le=1.0)] = 1.0
    """Share of a turn during which beams are taken; negative: in the opposite order, from the last one on."""
    errors: LidarErrors = LidarErrors()

    def spec(self, turning: bool, rate_hz: float | None = None) -> LidarSpec:
        """Its geometry; with `turning` off all beams are taken at once; at its own rate or another."""
        period = 1.0 / (rate_hz or self.rate_hz)
        return LidarSpec(
            self.n_beams,
            self.angle_min,
            float(np.deg2rad(self.angle_increment_deg)),
            self.range_min,
            self.range_max,
            period * self.sweep / self.n_beams if turning else 0.0,
            period,
        )


class Lidar3dMount(Settings):
    """A spinning 3D lidar at `position` in base_footprint: rings at even elevations."""

    position: Vector
    n_rings: int = Field(gt=1, le=256)
    elevation_deg: tuple[Number, Number]
    n_azimuths: int = Field(gt=0, le=10_000)
    range_min: Positive
    range_max: Positive
    rate_hz: Rate


class ImuMount(Settings):
    """Where the IMU sits in base_footprint, and its errors: standard deviations of white noise a sample, of
    the bias at the start, and of the bias's walk a root-second.
    """

    position: Vector
    gyro_noise: NonNegative = 2e-4
    gyro_bias: NonNegative = 5e-4
    gyro_walk: NonNegative = 2e-5
    accelerometer_noise: NonNegative = 1.7e-2
    accelerometer_bias: NonNegative = 5e-2
    accelerometer_walk: NonNegative = 5e-4


class RobotSpec(Settings):
    """A robot file."""

    name: str
    height: Positive
    footprint: list[tuple[Number, Number]] = Field(min_length=3, max_length=100)
    axle_height: Positive = 0.010
    """Height of base_link over base_footprint (the TurtleBot3 URDFs' own choice)."""
    limits: Limits
    parts: list[Part] = Field(min_length=1, max_length=100)
    wheels: Wheels
    lidar: Lidar
    more_lidars: dict[LidarName, Lidar] = Field(default={}, max_length=7)
    """By the end of their topic: the scans of `rear` are on /scan_rear, in the frame base_scan_rear."""
    imu: ImuMount
    lidar3d: Lidar3dMount | None = None

    @property
    def T_base_lidar(self) -> SE2:
        """Lidar in base_footprint."""
        return SE2.from_xyt(*self.lidar.pose)

    @property
    def lidars(self) -> dict[str, Lidar]:
        """All planar lidars by the end of their topic, the main one, of /scan, first."""
        return {"": self.lidar, **{f"_{name}": lidar for name, lidar in self.more_lidars.items()}}

    def mounted(self, turning: bool = True, rate_hz: float | None = None) -> tuple[MountedLidar, ...]:
        """The planar lidars, where they sit and their topics; as in `Lidar.spec`."""
        return tuple(
            MountedLidar(lidar.spec(turning, rate_hz), SE2.from_xyt(*lidar.pose), f"/scan{name}")
            for name, lidar in self.lidars.items()
        )

    @property
    def lidar_height(self) -> float:
        """Height of the lidar plane over the floor [m]."""
        return self.lidar.height

    @cached_property
    def model(self) -> RobotModel:
        """What planners may know of it."""
        limits = self.limits
        return RobotModel(
            self.name,
            np.array(self.footprint, dtype=np.float64),
            limits.max_v,
            limits.max_w,
            limits.max_dv,
            limits.max_dw,
        )


def load_robot(name_or_path: str) -> RobotSpec:
    """A built-in robot by name or a YAML file by path; InputError for unknown names lists the known."""
    return load_model(RobotSpec, find_named(name_or_path, FOLDER, "robot"))


def stamp_of(step: float) -> int:
    """Stamp of a control step, or of a time between two of them [ns]; a whole nanosecond number."""
    return round(step * 10**9 / CONTROL_HZ)


def robot_names() -> list[str]:
    """Names of the built-in robots."""
    return known_names(FOLDER)


def static_transforms(robot: RobotSpec) -> list[tuple[str, str, tuple[float, float, float], float]]:
    """(parent, child, xyz, yaw) of the robot's fixed frames, for /tf_static."""
    axle = robot.axle_height
    ix, iy, iz = robot.imu.position
    links = [
        ("base_footprint", "base_link", (0.0, 0.0, axle), 0.0),
        *(
            ("base_link", f"base_scan{name}", (*lidar.pose[:2], lidar.height - axle), lidar.pose[2])
            for name, lidar in robot.lidars.items()
        ),
        ("base_link", "imu_link", (ix, iy, iz - axle), 0.0),
    ]
    if robot.lidar3d is not None:
        px, py, pz = robot.lidar3d.position
        links.append(("base_link", "lidar_3d", (px, py, pz - axle), 0.0))
    return links
