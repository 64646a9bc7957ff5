"""Finding out where the robot is, in closed loop: it turns to and fro, or drives about on its guard."""

from __future__ import annotations

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Observation, Twist
from turtlebag.pipeline.navigation.guarded import Guard, View
from turtlebag.pipeline.navigation.localiser import Localiser
from turtlebag.pipeline.navigation.relocalise import Action, RelocaliseConfig, Relocaliser
from turtlebag.pipeline.navigation.sensing import Sensing
from turtlebag.planners.control.interface import Controller
from turtlebag.planners.control.monitor import CollisionMonitor
from turtlebag.planners.tasks.avoid import Sectors, read_sectors
from turtlebag.planners.tasks.wiggle import Wiggle, WiggleConfig

JUMP_M, JUMP_RAD = 0.25, 0.25
"""An estimate that moves more than this with one scan was wrong before."""


class Seeker:
    """Watches the localiser, and drives while it is lost."""

    def __init__(
        self,
        config: RelocaliseConfig,
        wiggle: WiggleConfig,
        guard: Guard,
        sensing: Sensing,
        monitor: CollisionMonitor,
        controller: Controller,
    ) -> None:
        self._task, self._wiggle_config = Relocaliser(config), wiggle
        self._guard, self._sensing = guard, sensing
        self._monitor, self._controller = monitor, controller
        self._wiggle: Wiggle | None = None
        self._sectors: Sectors | None = None
        self._wanted = Twist()
        self._T_map_odom: SE2 | None = None

    def check(self, now_ns: int, localiser: Localiser) -> Action:
        """What to do now by what the filter says of itself."""
        amcl = localiser.amcl
        if localiser.updates == 0 and self._task.action == "go":
            return "go"
        before = self._task.action
        action = self._task.update(now_ns, amcl.converged, amcl.agrees, localiser.updates)
        if action == "restart":
            localiser.initialise_globally()
        if action != before:
            self._wiggle, self._wanted = None, Twist()
        return action

    def doubts(self, localiser: Localiser, *, arrived: bool = False, in_a_wall: bool = False) -> bool:
        """Whether the robot may well be elsewhere.

        Where it takes itself to have arrived, the newest scan must not speak against that; where it takes
        itself to stand in what the map shows as a wall, it is wrong before any scan says so.
        """
        return in_a_wall or (localiser.contradicted if arrived else localiser.amcl.lost)

    def look_about(self, now_ns: int, localiser: Localiser) -> None:
        """Believe nothing else before that."""
        self._task.suspect(now_ns, localiser.updates)

    def jumped(self, observation: Observation, localiser: Localiser) -> bool:
        """Whether the estimate has moved otherwise than by odometry since the last question.

        Such a robot looks about before it drives on by the new estimate.
        """
        before, self._T_map_odom = self._T_map_odom, localiser.T_map_odom
        if before is None or self._T_map_odom is None or before is self._T_map_odom:
            return False
        T_odom_base = observation.odometry.T_odom_base
        x, y, yaw = ((before @ T_odom_base).inverse() @ (self._T_map_odom @ T_odom_base)).xyt.tolist()
        far = x * x + y * y > JUMP_M * JUMP_M or abs(yaw) > JUMP_RAD
        if far and self._task.action == "go" and localiser.updates > 0:
            self._task.suspect(observation.stamp_ns, localiser.updates)
            self._wiggle = None
        return far

    def accept(self, localiser: Localiser) -> None:
        """The estimate has been moved for a reason that needs no looking about."""
        self._T_map_odom = localiser.T_map_odom

    def command(self, observation: Observation, last: Twist) -> Twist:
        """The command of a tick in which the robot is lost: no map is used, nothing seen is touched."""
        sight = self._sensing.sight
        if observation.scan is not None:
            self._sectors = read_sectors(observation.scan)
        if sight is None or self._sectors is None or self._task.action not in ("look", "roam"):
            return self._controller.brake(last)
        now = observation.stamp_ns
        T_odom_base = observation.odometry.T_odom_base
        if self._task.action == "look":
            self._wiggle = self._wiggle or Wiggle(self._wiggle_config)
            wanted = self._wiggle.command(now, False) or Twist()
            factor = self._monitor.limit(wanted, self._sensing.points_base(T_odom_base))
            return self._controller.ramp(Twist(0.0, wanted.w * factor), last)
        view = View(now * 1e-9, T_odom_base, sight.hits_odom, self._sectors)
        if observation.scan is not None:
            self._wanted = self._guard.decide(view, last).command
        return self._controller.ramp(self._guard.pass_on(self._wanted, view), last)
