"""A robot in a simulated world, step by step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from turtlebag.api import given
from turtlebag.api.given import PathLike, Pose
from turtlebag.datasets.durations import seconds
from turtlebag.datasets.types import Observation, Twist
from turtlebag.pipeline.stages.record import scene_of
from turtlebag.pipeline.stages.requests.drives import RecordRequest
from turtlebag.sim import simulator
from turtlebag.sim.robots import RobotSpec
from turtlebag.sim.simulator import Truth
from turtlebag.sim.world import World


class Simulator:
    """Steps of 1/30 s: velocities in, sensor data out. A context manager that closes it.

    The same world, robot, settings, seed and commands give the same observations to the last bit, which are
    also those that `record` writes. Settings are those of `record`: `{"sim.sensors": "clean"}`.
    """

    def __init__(
        self,
        world: PathLike | type,
        robot: PathLike | None = None,
        *,
        seed: int = 1,
        start: Pose | None = None,
        config: PathLike | None = None,
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        """`start` is the true pose in the world (default: its spawn). InputError for unknown names."""
        asked = RecordRequest.checked(
            world=world, robot=robot, seed=seed, start=start, config=config, settings=settings or {}
        )
        self._scene = scene = scene_of(asked)
        self._simulator = simulator.Simulator(scene.world, scene.robot, scene.sim, scene.seed)
        self.reset()

    def __enter__(self) -> Simulator:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the physics engine."""
        self._simulator.close()

    @property
    def world(self) -> World:
        """The world, with its `bounds` (x_min, x_max, y_min, y_max) [m]."""
        return self._scene.world

    @property
    def robot(self) -> RobotSpec:
        """The robot: its footprint, limits and sensors."""
        return self._scene.robot

    @property
    def observation(self) -> Observation:
        """The last sensor data: `odometry`, `joints`, `imu`, and `scan` if a sweep has ended."""
        return self._observation

    @property
    def truth(self) -> Truth:
        """Ground truth: true pose and twist in the world, and contacts."""
        return self._simulator.truth

    @property
    def time_s(self) -> float:
        """Simulated seconds since the start."""
        return seconds(self._observation.stamp_ns)

    def clearance(self) -> float:
        """Distance from the robot to the nearest thing [m]."""
        return self._simulator.clearance()

    def reseed(self, seed: int) -> None:
        """Use another seed from the next reset on."""
        self._simulator.seed = seed

    def reset(self, start: Pose | None = None) -> Observation:
        """Start again, at another true pose if given; InputError if it is in an obstacle."""
        T_start = self._scene.start if start is None else given.pose(start, "start")
        self._observation = self._simulator.reset(T_start)
        return self._observation

    def step(self, v: float = 0.0, w: float = 0.0) -> Observation:
        """Drive for 1/30 s at v [m/s] forward and w [rad/s] to the left, as far as the motors can follow."""
        self._observation = self._simulator.step(Twist(float(v), float(w)))
        return self._observation

    def __repr__(self) -> str:
        return f"Simulator: {self.robot.name} in {self.world.name}, {self.time_s:.1f} s"
