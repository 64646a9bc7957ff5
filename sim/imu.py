"""The IMU: yaw rate and specific force of a body moving on the floor, with noise and a random-walk bias."""

from __future__ import annotations

import math

import numpy as np

from turtlebag.datasets.se2 import Array
from turtlebag.datasets.settings import NonNegative, Settings
from turtlebag.datasets.types import Imu, Twist
from turtlebag.sim.robots import CONTROL_HZ, ImuMount, RobotSpec

RATE_HZ = 100
DRAWN = 300
"""Samples whose errors are drawn at once."""
GRAVITY = 9.81


class ImuConfig(Settings):
    """Standard deviations: white noise a sample, bias at the start, and bias walk a root-second; None: as in
    the robot's file.
    """

    enabled: bool = True
    """Whether there is an IMU."""
    gyro_noise: NonNegative | None = None
    """Of a sample of the gyro [rad/s]."""
    gyro_bias: NonNegative | None = None
    """Of the gyro's bias at the start [rad/s]."""
    gyro_walk: NonNegative | None = None
    """Of its walk [rad/s/sqrt(s)]."""
    accelerometer_noise: NonNegative | None = None
    """Of a sample of the accelerometer [m/s^2]."""
    accelerometer_bias: NonNegative | None = None
    """Of its bias at the start [m/s^2]."""
    accelerometer_walk: NonNegative | None = None
    """Of its walk [m/s^2/sqrt(s)]."""

    def resolved(self, mount: ImuMount) -> ImuConfig:
        """The same with the errors of this IMU where none are set."""
        own = mount.model_dump(exclude={"position"})
        return self.model_copy(update={name: of for name, of in own.items() if getattr(self, name) is None})


class ImuSensor:
    """Samples at 100 Hz between control steps, from the true planar motion; roll and pitch are left out."""

    def __init__(self, robot: RobotSpec, config: ImuConfig, rng: np.random.Generator) -> None:
        self._config, self._rng = config, rng
        self._lever = robot.imu.position[:2]
        errors = config.resolved(robot.imu).model_dump()
        noise, bias, walk = (
            np.repeat([errors[f"gyro_{name}"], errors[f"accelerometer_{name}"]], 3)
            for name in ("noise", "bias", "walk")
        )
        self._noise, self._walk = noise, walk / math.sqrt(RATE_HZ)
        self._bias = bias * rng.standard_normal(6)
        self._last = Twist()
        self._count = 0
        self._errors = np.zeros((0, 6))

    def samples(self, step: int, twist: Twist) -> tuple[Imu, ...]:
        """Samples taken up to the end of control step number `step`, after which the body has this twist."""
        if not self._config.enabled:
            return ()
        # Sample j is taken at j / RATE_HZ; the step ends at step / CONTROL_HZ.
        until = step * RATE_HZ // CONTROL_HZ
        n = until - self._count
        at = [(self._count + 1 + k) * (CONTROL_HZ / RATE_HZ) - (step - 1) for k in range(n)]
        self._count = until
        last, self._last = self._last, twist
        while len(self._errors) < n:
            self._errors = np.concatenate([self._errors, self._drawn()])
        values = self._true(last, twist, at) + self._errors[:n]
        self._errors = self._errors[n:]
        period = 10**9 // RATE_HZ
        return tuple(Imu((until - n + 1 + k) * period, values[k, :3], values[k, 3:]) for k in range(n))

    def _drawn(self) -> Array:
        """Noise and wandering bias of the next samples, (DRAWN, 6)."""
        noise, steps = self._rng.standard_normal((2, DRAWN, 6))
        walk = (self._walk * steps).cumsum(axis=0) + self._bias
        self._bias = walk[-1]
        return np.asarray(self._noise * noise + walk)

    def _true(self, before: Twist, after: Twist, at: list[float]) -> Array:
        """Gyro and specific force, (n, 6), at fractions (n) of a control step; linear speeds between."""
        dv, dw = (after.v - before.v) * CONTROL_HZ, (after.w - before.w) * CONTROL_HZ
        x, y = self._lever
        rows = []
        for fraction in at:  # three or four, fewer than are worth an operation on arrays
            v, w = before.v + fraction * (after.v - before.v), before.w + fraction * (after.w - before.w)
            # Acceleration of a point of the body: of the base, from the turning rate's change, centripetal.
            forward, aside = dv - dw * y - w * w * x, v * w + dw * x - w * w * y
            rows.append((0.0, 0.0, w, forward, aside, GRAVITY))
        return np.array(rows).reshape(-1, 6)
