"""Motor layer and wheel odometry, as on the robot's board, with its (imperfect) calibration."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated

import numpy as np
from pydantic import Field

from turtlebag.datasets.se2 import SE2, wrapped
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.types import Twist
from turtlebag.sim.robots import PERIOD_S, RobotSpec

DRAWN = 300
"""Control steps whose slip is drawn at once."""


class OdometryConfig(Settings):
    """Errors of wheel odometry.

    Calibration: configured wheel radius and track are wrong by up to these fractions, drawn once per run;
    None: by the robot's `calibration_error`.
    Slip: `slip` is the standard deviation of a wheel's slip [m] after a metre, `turn_slip`
    of opposite slip of both [rad] after a turn of a radian; both grow with the square root.
    """

    radius_error: Annotated[float, Field(ge=0.0, lt=0.5)] | None = None
    """Largest error of the configured wheel radius, as a fraction of it; drawn once a run."""
    track_error: Annotated[float, Field(ge=0.0, lt=0.5)] | None = None
    """The same of the distance between the wheels."""
    slip: Annotated[float, Field(ge=0.0, le=0.1)] | None = None
    """None: by the robot, else by `sim.sensors`."""
    turn_slip: Annotated[float, Field(ge=0.0, le=0.5)] | None = None
    """None: by the robot, else by `sim.sensors`."""


class Calibration:
    """Track and wheel radii, left and right [m], as the board believes them."""

    def __init__(self, robot: RobotSpec, config: OdometryConfig, rng: np.random.Generator) -> None:
        wheels, (radius, track) = robot.wheels, rng.uniform(-1.0, 1.0, 2)
        radius_error, track_error = (
            wheels.calibration_error if error is None else error
            for error in (config.radius_error, config.track_error)
        )
        middle = (wheels.controller_radius or wheels.radius) * (1.0 + radius_error * float(radius))
        aside = wheels.turn_per_m * wheels.joint_y
        self.radii = (middle * (1.0 + aside), middle * (1.0 - aside))
        self.track = wheels.separation * (1.0 + track_error * float(track))


class Motors:
    """Commands to wheel speeds, within the limits of speed and acceleration."""

    def __init__(self, robot: RobotSpec, calibration: Calibration) -> None:
        self._limits, self._calibration = robot.limits, calibration
        self._v = self._w = self._left = self._right = 0.0

    def step(self, command: Twist) -> tuple[float, float]:
        """Target speeds of the left and right wheel [rad/s] for the next control step."""
        limits, dt = self._limits, PERIOD_S
        v = min(max(command.v, -limits.max_v), limits.max_v) if math.isfinite(command.v) else 0.0
        w = min(max(command.w, -limits.max_w), limits.max_w) if math.isfinite(command.w) else 0.0
        self._v = _approach(self._v, v, limits.max_dv * dt)
        self._w = _approach(self._w, w, limits.max_dw * dt)
        # Rim speeds; each wheel has its own ramp, as in the Gazebo plugin.
        swing = 0.5 * self._calibration.track * self._w
        self._left = _approach(self._left, self._v - swing, limits.wheel_acceleration * dt)
        self._right = _approach(self._right, self._v + swing, limits.wheel_acceleration * dt)
        left, right = self._calibration.radii
        return self._left / left, self._right / right


def _approach(value: float, target: float, step: float) -> float:
    return min(max(target, value - step), value + step)


class Slip:
    """Random slip: wheels that turn a little more or less than the robot rolls, and encoders that see it."""

    def __init__(self, robot: RobotSpec, config: OdometryConfig, rng: np.random.Generator) -> None:
        self._metre, self._radian = config.slip or 0.0, config.turn_slip or 0.0
        self._radius, self._track = robot.wheels.radius, 2.0 * robot.wheels.joint_y
        self._rng = rng
        self._rolled: tuple[float, float] | None = None
        self._in_vain = (0.0, 0.0)
        self._draws: Iterator[list[float]] = iter(())

    def encoders(self, left_rad: float, right_rad: float) -> tuple[float, float]:
        """Angles that the encoders see, from those that moved the robot [rad]."""
        if self._metre == 0.0 and self._radian == 0.0:
            return left_rad, right_rad
        last = self._rolled or (left_rad, right_rad)
        self._rolled = (left_rad, right_rad)
        left, right = self._radius * (left_rad - last[0]), self._radius * (right_rad - last[1])
        a, b, both = next(self._draws, None) or self._drawn()
        swing = 0.5 * self._track * self._radian * math.sqrt(abs(right - left) / self._track) * both
        left_more = (self._metre * math.sqrt(abs(left)) * a - swing) / self._radius
        right_more = (self._metre * math.sqrt(abs(right)) * b + swing) / self._radius
        self._in_vain = (self._in_vain[0] + left_more, self._in_vain[1] + right_more)
        return left_rad + self._in_vain[0], right_rad + self._in_vain[1]

    def _drawn(self) -> list[float]:
        """The first of many draws; the others are kept."""
        self._draws = iter(self._rng.standard_normal((DRAWN, 3)).tolist())
        return next(self._draws)


class WheelOdometry:
    """Encoder ticks integrated by the mid-point rule, starting at a given pose."""

    def __init__(self, robot: RobotSpec, calibration: Calibration, start: SE2) -> None:
        self._rad_per_tick = 2.0 * math.pi / robot.wheels.encoder_ticks
        self._calibration = calibration
        self._x, self._y, self._yaw = (float(value) for value in start.xyt)
        self._ticks: tuple[int, int] | None = None

    def update(self, left_rad: float, right_rad: float) -> tuple[SE2, Twist]:
        """Pose in odom and twist after the wheels reached these true angles [rad]."""
        ticks = (math.floor(left_rad / self._rad_per_tick), math.floor(right_rad / self._rad_per_tick))
        last = self._ticks or ticks
        self._ticks = ticks
        left, right = (
            (now - before) * self._rad_per_tick * radius
            for now, before, radius in zip(ticks, last, self._calibration.radii, strict=True)
        )
        forward, turn = 0.5 * (left + right), (right - left) / self._calibration.track
        self._x += forward * math.cos(self._yaw + 0.5 * turn)
        self._y += forward * math.sin(self._yaw + 0.5 * turn)
        self._yaw = wrapped(self._yaw + turn)
        T_odom_base = SE2(np.array([self._x, self._y, self._yaw]))
        return T_odom_base, Twist(forward / PERIOD_S, turn / PERIOD_S)


class Board:
    """The robot's board: commands become wheel speeds, encoder readings become odometry."""

    def __init__(self, robot: RobotSpec, config: OdometryConfig, seed: int, start: SE2) -> None:
        calibration = Calibration(robot, config, stream(seed, "calibration"))
        self.motors = Motors(robot, calibration)
        self.slip = Slip(robot, config, stream(seed, "slip"))
        self.odometry = WheelOdometry(robot, calibration, start)
