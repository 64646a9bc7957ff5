"""Reactive obstacle avoidance, `avoid.mode=guarded`: the tutorial's tiers, with the robot's footprint.

It never commands a motion that would end in contact by the last sweep, treats beams below the minimum
range as contact, turns one way until the path is free, notices by comparing sweeps that
its wheels turn but it does not move, backs off from obstacles it cannot see and remembers where they are.
"""

from __future__ import annotations

import math

import numpy as np

from turtlebag.datasets.se2 import SE2, Array, wrap
from turtlebag.datasets.types import RobotModel, Twist
from turtlebag.pipeline.navigation.bump_reflex import BACK_OFF_M, BumpReflex, Escape
from turtlebag.pipeline.navigation.obstacle_memory import ObstacleMemory
from turtlebag.pipeline.navigation.sensing import DeskewedScan
from turtlebag.planners.control.collision_monitor import CollisionMonitor
from turtlebag.planners.tasks.recovery import ProgressWatch
from turtlebag.planners.tasks.sector_rule import SLOW_V, STOP_M, TURN_W, Decision, tutorial_rule

# Half the corridor kept free ahead is half the robot's width and this; something in it nearer than this
# before the nose counts as the nearest tier [m].
SIDE_ROOM_M, NOSE_ROOM_M = 0.06, 0.2
# It turns away from what it bumped into by this [rad].
TURN_AWAY_RAD = 1.6
# So many changes of the freer side, one after the other, count as dithering: it keeps its side.
MOST_FLIPS = 3
# After so long [s] about one place, within this [m], it turns to where most room is: at the sweep 20 s on. In
# a corner where it cannot turn round, it drives out first.
# With 0.5 m the worst of four drives touches something low 33 times for 17.
RESTLESS_S, RESTLESS_M = 19.9, 0.4


class GuardedAvoidance:
    """Decides at every sweep, and watches over every command."""

    def __init__(self, model: RobotModel, memory: ObstacleMemory) -> None:
        self.monitor = CollisionMonitor(model)
        self._half_width = float(np.abs(model.footprint[:, 1]).max()) + SIDE_ROOM_M
        self._nose = float(model.footprint[:, 0].max())
        self.turning = 0.0
        """The side that it turns to until the way is free: 1 left, -1 right, 0 neither."""
        self._flips = 0
        self._memory, self._reflex = memory, BumpReflex(memory)
        self._progress = ProgressWatch(RESTLESS_S, RESTLESS_M, math.inf)
        self.decision = Decision("hold", Twist())
        """What was decided at the newest sweep."""

    def interrupted(self) -> None:
        """A teleop override has ended: manoeuvres and watches start anew; bumped places are kept."""
        self._progress.reset()
        self.decision = Decision("hold", Twist())
        self.turning, self._flips = 0.0, 0
        self._reflex.interrupt()

    def command(self, sweep: DeskewedScan, T_odom_base: SE2, last: Twist, *, new_sweep: bool) -> Twist:
        """The command of a tick, as far as it is safe; it is decided anew after a sweep."""
        if new_sweep:
            self.decision = self.decide(sweep, T_odom_base, last)
        wanted = self.decision.command
        factor = self.monitor.limit(wanted, self.points_base(sweep, T_odom_base))
        return Twist(wanted.v * factor, wanted.w * factor)

    def points_base(self, sweep: DeskewedScan, T_odom_base: SE2) -> Array:
        """Everything to keep off, seen from the base: the sweep and the remembered places."""
        points = np.concatenate([sweep.around_odom, self._memory.bumps(sweep.stamp_ns)])
        return T_odom_base.inverse() @ points

    def decide(self, sweep: DeskewedScan, T_odom_base: SE2, last: Twist) -> Decision:
        """What to do after a new sweep."""
        away = TURN_AWAY_RAD if sweep.sectors.left > sweep.sectors.right else -TURN_AWAY_RAD
        if self._reflex.triggered(sweep, T_odom_base, last, away, SE2.identity()):
            self.turning = 0.0
        points = self.points_base(sweep, T_odom_base)
        command = self._reflex.command(sweep.stamp_ns, T_odom_base)
        if command is not None:
            return self.possible(Decision("back off" if command.v else "turn away", command), points)
        return self.possible(self._tiers(sweep, T_odom_base, points), points)

    def _tiers(self, sweep: DeskewedScan, T_odom_base: SE2, points: Array) -> Decision:
        s = sweep.sectors
        barred = s.front < STOP_M or self._gap(points) < NOSE_ROOM_M
        if self._progress.stuck(sweep.stamp_ns, T_odom_base):
            angle = most_room(T_odom_base.inverse() @ sweep.around_odom)
            way = self._way_out(points) if barred else 0.0
            self._reflex.escape = Escape(sweep.stamp_ns, T_odom_base, way, angle)
            return Decision("turn away", Twist(0.0, 0.0))
        if barred:
            self._turn_to(1.0 if s.left > s.right else -1.0)
            side = "left" if self.turning > 0.0 else "right"
            return Decision(f"stop, turn {side}", Twist(0.0, self.turning * TURN_W))
        self.turning, self._flips = 0.0, 0
        return tutorial_rule(s)

    def _way_out(self, points: Array) -> float:
        """How far to drive from a place where it cannot turn: forwards, or backwards if that is freer [m]."""
        forwards, backwards = (self.monitor.free_way(v, points, BACK_OFF_M) for v in (SLOW_V, -SLOW_V))
        return BACK_OFF_M if forwards > backwards else -BACK_OFF_M

    def _turn_to(self, freer: float) -> None:
        """Turn to the freer side; after some changes of mind keep to one until the way is free."""
        if self.turning == 0.0 or (freer != self.turning and self._flips < MOST_FLIPS):
            self._flips += self.turning != 0.0
            self.turning = freer

    def _gap(self, points: Array) -> float:
        """Free length before the nose within the corridor as wide as the robot."""
        ahead = points[(points[:, 0] > 0.0) & (np.abs(points[:, 1]) < self._half_width)]
        return float(ahead[:, 0].min()) - self._nose if len(ahead) else math.inf

    def possible(self, decision: Decision, points: Array) -> Decision:
        """The decision, or the nearest thing to it that touches nothing."""
        command = decision.command
        if self.monitor.limit(command, points) > 0.0:
            return decision
        first = math.copysign(TURN_W, command.w if command.w else self.turning or 1.0)
        for name, other in (
            ("turn", Twist(0.0, first)),
            ("turn", Twist(0.0, -first)),
            ("back off", Twist(-SLOW_V, 0.0)),
            ("creep", Twist(0.5 * SLOW_V, 0.0)),
        ):
            if self.monitor.limit(other, points) > 0.0:
                if other.w:
                    self.turning = math.copysign(1.0, other.w)
                return Decision(name, other)
        return Decision("hold", Twist())


def most_room(points_base: Array) -> float:
    """Angle to the 30 degree sector whose nearest point (n, 2) is farthest away."""
    bearing = np.arctan2(points_base[:, 1], points_base[:, 0])
    distance = np.linalg.norm(points_base, axis=1)
    best, angle = -1.0, math.pi
    centers, half = np.linspace(-math.pi, math.pi, 24, endpoint=False, retstep=True)
    for center in centers:
        inside = distance[np.abs(wrap(bearing - center)) < half]
        room = float(inside.min()) if len(inside) else math.inf
        if room > best:
            best, angle = room, float(center)
    return angle
