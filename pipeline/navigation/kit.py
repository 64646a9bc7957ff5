"""What every driver of a run is made of."""

from __future__ import annotations

from dataclasses import dataclass

from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.parts import find
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.types import MountedLidar
from turtlebag.pipeline.navigation.config import NavigateConfig
from turtlebag.pipeline.navigation.goal_runner import Tools
from turtlebag.pipeline.navigation.sensing import Sensing
from turtlebag.planners.control.collision_monitor import CollisionMonitor
from turtlebag.planners.control.controller import Controller
from turtlebag.planners.control.dwa import Dwa
from turtlebag.planners.control.pursuit import Pursuit
from turtlebag.planners.obstacle_layer import ObstacleLayer
from turtlebag.sim.robots import PERIOD_S, RobotSpec


@dataclass(frozen=True, eq=False)
class Kit:
    """What every driver of a run is made of. `config.sim` is resolved for the robot."""

    robot: RobotSpec
    config: NavigateConfig
    seed: int
    sensing: Sensing
    publisher: BagWriter

    def lidars(self) -> tuple[MountedLidar, ...]:
        """The robot's planar lidars as they are simulated."""
        lidar = self.config.sim.lidar
        return self.robot.mounted(lidar.turning, lidar.rate_hz)

    def tools(self, obstacles: ObstacleLayer, config: NavigateConfig | None = None) -> Tools:
        """Controller and monitor, on the obstacle layer; `config` in place of the kit's own."""
        config, model = config or self.config, self.robot.model
        return Tools(
            model=model,
            controller=make_controller(self.robot, config),
            monitor=CollisionMonitor(model),
            obstacles=obstacles,
            plan=config.plan,
            checker=config.goal_checker,
            recovery=config.recovery,
            publisher=self.publisher,
            seed=int(stream(self.seed, "plan").integers(2**31)),
        )


def make_controller(robot: RobotSpec, config: NavigateConfig) -> Controller:
    """The configured local controller; InputError if it cannot be loaded."""
    if config.controller == "dwa":
        return Dwa(robot.model, config.dwa, PERIOD_S)
    if config.controller == "pursuit":
        return Pursuit(robot.model, PERIOD_S)
    own: Controller = find(config.controller, Controller)(robot.model, PERIOD_S)
    return own
