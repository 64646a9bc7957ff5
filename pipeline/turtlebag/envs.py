"""Gymnasium environments, for which gymnasium must be installed: `pip install 'turtlebag[envs]'`.

`gymnasium.make("turtlebag.envs:TurtleBag/Goal-v0")` creates the only one.

Observations are sensor data; rewards are computed from ground truth.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlebag.api.simulation import Simulator
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import FREE
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Observation
from turtlebag.sim.raycast import distance_to_outlines

try:
    import gymnasium
    from gymnasium import spaces
except ImportError:
    raise InputError("turtlebag.envs needs gymnasium; run: pip install 'turtlebag[envs]'") from None

STEPS = 6
"""Control periods of 1/30 s in a step: as long as a turn of the lidar."""
SECTORS = 36
"""The scan is reduced to the nearest return in each of this many sectors, from straight ahead to the left."""
REACHED_M, NEAREST_M, ROOM_M = 0.25, 0.8, 0.1
"""Distance at which a goal counts as reached, least distance of a new goal, and clearance around it."""
FARTHEST_M = 100.0
TRIES = 200


class GoalEnv(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """Drive to a goal drawn at random, by lidar and odometry.

    Action (2,): forward and turning speed as shares -1..1 of the robot's limits, for 0.2 s.
    Observation (40,): 36 ranges [m] from straight ahead to the left; distance [m] and bearing [rad] of the
    goal by the odometry; forward [m/s] and turning speed [rad/s]. Reward: metres gained towards the goal, 10
    for reaching it, -10 for touching something; both end the episode. The same seed gives the same episode.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 (Gymnasium's own way)

    def __init__(self, world: str = "turtlebot3_world", robot: str | None = None) -> None:
        self._sim = Simulator(world, robot)
        lidar, limits = self._sim.robot.lidar, self._sim.robot.limits
        self._farthest = float(lidar.range_max)
        self._speeds = np.array([limits.max_v, limits.max_w])
        high = np.array([*[lidar.range_max] * SECTORS, FARTHEST_M, np.pi, 10.0, 10.0], dtype=np.float32)
        low = np.array([*[0.0] * SECTORS, 0.0, -np.pi, -10.0, -10.0], dtype=np.float32)
        self.observation_space = spaces.Box(low, high)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """A new episode from the spawn; `options={"goal": (x, y)}` sets the goal, in the world [m]."""
        super().reset(seed=seed)
        self._sim.reseed(int(self.np_random.integers(2**31)))
        first = self._sim.reset()
        given = (options or {}).get("goal")
        self._goal = self._drawn() if given is None else np.asarray(given, dtype=np.float64)
        if self._goal.shape != (2,) or not np.isfinite(self._goal).all():
            raise InputError(f"goal: expected x, y in metres, not {given!r}")
        # Odometry starts at the true spawn, so the goal is known in its frame.
        self._ranges = np.full(SECTORS, self._farthest)
        return self._seen(first), {"goal": self._goal.copy()}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Drive for 0.2 s."""
        v, w = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0) * self._speeds
        before, touched = self._distance(), False
        for _ in range(STEPS):
            observation = self._sim.step(v, w)
            truth = self._sim.truth
            touched = touched or truth.contact_visible or truth.contact_low
            self._look(observation)
        distance = self._distance()
        reached = distance < REACHED_M and not touched
        reward = before - distance + 10.0 * reached - 10.0 * touched
        info = {"distance_m": distance, "reached": reached, "touched": touched}
        return self._seen(observation), float(reward), bool(reached or touched), False, info

    def close(self) -> None:
        """Release the physics engine."""
        self._sim.close()

    def _distance(self) -> float:
        return float(np.hypot(*(self._goal - self._sim.truth.T_world_base.xy)))

    def _look(self, observation: Observation) -> None:
        """The nearest return in each sector, from the newest scan of the main lidar."""
        scan = observation.scan
        if scan is None or scan.sensor != 0:
            return
        ranges = np.where(scan.valid(), scan.ranges, self._farthest)
        angles = scan.lidar.angles + float(self._sim.robot.T_base_lidar.yaw)
        sector = np.floor(np.mod(angles, 2.0 * np.pi) / (2.0 * np.pi) * SECTORS).astype(int) % SECTORS
        self._ranges = np.full(SECTORS, self._farthest)
        np.minimum.at(self._ranges, sector, ranges)

    def _seen(self, observation: Observation) -> NDArray[np.float32]:
        odometry = observation.odometry
        x, y = odometry.T_odom_base.inverse() @ self._goal
        goal = (min(np.hypot(x, y), FARTHEST_M), np.arctan2(y, x))
        seen = np.array([*self._ranges, *goal, odometry.twist.v, odometry.twist.w], dtype=np.float32)
        return np.clip(seen, self.observation_space.low, self.observation_space.high)  # type: ignore[attr-defined]

    def _drawn(self) -> NDArray[np.float64]:
        """A place inside the world where the robot can stand."""
        world, robot = self._sim.world, self._sim.robot
        floor = world.rasterize(robot.lidar_height)
        places = floor.center_of(np.argwhere(floor.cells == FREE))
        things = world.touchable(robot.height)
        for _ in range(TRIES):
            goal = places[self.np_random.integers(len(places))]
            near = np.hypot(*(goal - self._sim.truth.T_world_base.xy)) < NEAREST_M
            footprint = SE2.from_xyt(goal[0], goal[1], 0.0) @ robot.model.footprint
            if not near and distance_to_outlines(footprint, things.segments, things.circles) > ROOM_M:
                return np.asarray(goal)
        raise InputError(f"{world.name}: found no place for a goal; give one in options")


gymnasium.register("TurtleBag/Goal-v0", entry_point="turtlebag.envs:GoalEnv", max_episode_steps=600)
