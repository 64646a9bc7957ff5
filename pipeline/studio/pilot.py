"""The robot's side of a session: it localises, maps, and does what it was told, all at once."""

from __future__ import annotations

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Observation, Twist
from turtlebag.pipeline.navigation.driver import Driver
from turtlebag.pipeline.navigation.drivers import Kit, make_navigator
from turtlebag.pipeline.navigation.localiser import Localiser
from turtlebag.pipeline.navigation.navigator import NavigationDriver
from turtlebag.pipeline.navigation.online_map import OnlineMap
from turtlebag.pipeline.slam.mapper import Mapper
from turtlebag.pipeline.studio.tasks import Task
from turtlebag.planners.control.interface import SpeedLimits, ramped
from turtlebag.planners.costmap import Costmap
from turtlebag.planners.obstacle_layer import ObstacleLayer
from turtlebag.planners.tasks.sequence import GoalSequence
from turtlebag.sim.robots import PERIOD_S

DRAWN_EVERY_NS = 2 * 10**9
"""While mapping, loops are closed and the map is drawn this often, if the robot has moved since."""
MOVED_M, MOVED_RAD = 0.05, 0.05


class Pilot(Driver):
    """A driver of whatever task there is; without one it stands still. It never sees the truth."""

    def __init__(self, kit: Kit) -> None:
        super().__init__(kit.sensing)
        self.kit = kit
        self.task: Task | None = None
        self.navigation: NavigationDriver | None = None
        """Localises on the map that is loaded, and drives on it; None without a map."""
        self.localiser: Localiser | None = None
        self.mapper: OnlineMap | None = None
        """Of the map that was begun here; None when there is none."""
        self.mapping = False
        self._limits = SpeedLimits.of(kit.robot.model, PERIOD_S)
        self._drawn_ns = 0
        self._drawn_at = SE2.identity()
        self.state = "idle"

    @property
    def T_map_odom(self) -> SE2:
        """Odometry's frame on the map; the same as the map's while nothing else is known."""
        if self.localiser is not None:
            return self.localiser.T_map_odom or SE2.identity()
        return SE2.identity() if self.mapper is None else self.mapper.T_map_odom

    @property
    def slam(self) -> Mapper | None:
        """What has mapped a scan at least."""
        return None if self.mapper is None else self.mapper.mapper

    @property
    def localised(self) -> bool:
        """Whether there is a pose on a map that was loaded."""
        return self.localiser is not None and self.localiser.T_map_odom is not None

    @property
    def told(self) -> bool:
        """Whether the robot was told where it is, or to find out."""
        return self.localiser is not None and self.localiser.amcl.initialised

    def load(self, grid: OccupancyGrid, costmap: Costmap, now_ns: int) -> None:
        """Go by this map from now on; no pose on it is known, and what was mapped here is forgotten."""
        idle = GoalSequence((), self.kit.config.sequence)
        self.navigation, self.localiser = make_navigator(self.kit, grid, costmap, idle)
        self.mapper, self.mapping = None, False
        self.kit.publisher.map(now_ns, grid)

    def start_mapping(self) -> None:
        """Begin a new map, and go by it."""
        self.navigation = self.localiser = None
        self.mapper, self.mapping = OnlineMap(self.kit.robot.T_base_lidar, self.kit.config.explore.slam), True

    def keep_out(self, costmap: Costmap) -> None:
        """The map that is loaded has other places to keep out of."""
        assert self.navigation is not None
        self.navigation.use(self.kit.tools(ObstacleLayer(costmap)))

    def begin(self, task: Task) -> None:
        """Do this from the next step on."""
        self.task = task
        task.driver.resume(self._last)

    def end_task(self) -> None:
        """Do nothing more."""
        self.task, self.state, self.goal_index = None, "idle", -1
        if self.navigation is not None:
            self.navigation.begin(GoalSequence((), self.kit.config.sequence))

    def step(self, observation: Observation) -> Twist:
        """The command of the task, or a standstill."""
        self._look(observation)
        if self.task is None:
            self._last = ramped(Twist(), self._last, self._limits)
        else:
            self._last = self.task.driver.step(observation)
        self._note(observation)
        return self._last

    def stand_by(self, observation: Observation) -> None:
        """Localise and map on while someone drives by hand."""
        self._look(observation)
        if self.task is not None:
            self.task.driver.stand_by(observation)
        self._note(observation)

    def resume(self, last: Twist) -> None:
        """Go on with the task from where the robot has been brought."""
        super().resume(last)
        if self.task is not None:
            self.task.driver.resume(last)

    def _look(self, observation: Observation) -> None:
        """Feed what the task itself does not."""
        self.sensing.observe(observation)
        driver = None if self.task is None else self.task.driver
        if self.mapping and self.mapper is not None and (self.task is None or self.task.explorer is None):
            self.mapper.observe(observation)
            self._draw(self.mapper, observation)
        if self.navigation is not None and driver is not self.navigation:
            self.navigation.stand_by(observation)
        if self.localiser is not None:
            self.localiser.scan_poses.clear()  # a session writes them as it goes on

    def _draw(self, mapper: OnlineMap, observation: Observation) -> None:
        now, T_odom_base = observation.stamp_ns, observation.odometry.T_odom_base
        if observation.scan is None or not mapper.ready or now - self._drawn_ns < DRAWN_EVERY_NS:
            return
        x, y, yaw = (self._drawn_at.inverse() @ T_odom_base).xyt.tolist()
        if mapper.grid is not None and abs(yaw) < MOVED_RAD and x * x + y * y < MOVED_M**2:
            return
        self._drawn_ns, self._drawn_at = now, T_odom_base
        self.kit.publisher.map(now, mapper.update())
        self.kit.publisher.map_to_odom(now, mapper.T_map_odom)

    def _note(self, observation: Observation) -> None:
        known = self.localised or self.mapper is not None
        self.estimate = self.T_map_odom @ observation.odometry.T_odom_base if known else None
        if self.task is not None:
            self.state, self.goal_index = self.task.driver.state, self.task.driver.goal_index
