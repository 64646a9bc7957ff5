"""The guarded way of driving about: the tutorial's tiers, for a robot that knows its own shape.

It never asks for a motion that the last sweep shows to end in a touch, treats beams that are too
short to measure as touching, turns one way until the way is free, notices by comparing sweeps that
its wheels turn and it does not move, backs off from what it cannot see and remembers where that was.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy
from pydantic import BaseModel, ConfigDict, Field

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.spans import Seconds
from turtlebag.datasets.types import RobotModel, Twist
from turtlebag.planners.control.monitor import CollisionMonitor, MonitorConfig
from turtlebag.planners.tasks.avoid import AvoidConfig, Decision, Sectors

POSSIBLE = 0.15
"""A command of which the monitor passes no more than this part is not worth giving."""
AHEAD_M, BEHIND_M = 0.05, 0.015
"""How far beyond the nose and behind the tail the thing that stopped it is taken to stand."""


class GuardConfig(BaseModel):
    """Metres, seconds, radians."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    monitor: MonitorConfig = MonitorConfig(padding=0.03, reaction=0.15, braking_share=0.6)
    side_room: float = Field(default=0.06, ge=0.0)
    """Half the corridor kept free ahead is half the robot's width and this."""
    nose_room: float = Field(default=0.2, gt=0.0)
    """Something in the corridor nearer than this before the nose counts as the nearest tier."""
    slip_travel: float = Field(default=0.1, gt=0.0)
    """Odometry that must have passed before two sweeps are compared for standing still."""
    slip_ratio: float = Field(default=0.5, gt=0.0, lt=1.0)
    """Standing still must explain the sweep by this factor better than odometry does."""
    back_off: float = Field(default=0.25, gt=0.0)
    back_off_v: float = Field(default=0.1, gt=0.0)
    turn_away: float = Field(default=1.6, gt=0.0)
    memory: Seconds = 120.0
    """How long a place where it got stuck is kept out of."""
    flips: int = Field(default=3, ge=0)
    """So many changes of the freer side, one after the other, count as dithering: it keeps its side."""
    restless: Seconds = Field(default=20.0, gt=0.0)
    """After so long within `restless_reach` it turns to where most room is."""
    restless_reach: float = Field(default=0.4, gt=0.0)


@dataclass(frozen=True, eq=False)
class View:
    """What the guard looks at: all in the odometry frame, at one instant."""

    now_s: float
    T_odom_base: SE2
    hits_odom: Array
    sectors: Sectors


class SlipWatch:
    """Tells turning wheels from a moving robot by comparing sweeps."""

    def __init__(self, config: GuardConfig) -> None:
        self.config = config
        self._pose: SE2 | None = None
        self._points = np.zeros((0, 2))

    def reset(self) -> None:
        """Start from the next sweep."""
        self._pose = None

    def slipping(self, T_odom_base: SE2, hits_odom: Array) -> bool:
        """Whether the new sweep fits the remembered one better without the motion odometry tells of."""
        points = T_odom_base.inverse() @ hits_odom
        if self._pose is None or len(points) < 30 or len(self._points) < 30:
            self._pose, self._points = T_odom_base, points
            return False
        x, y, yaw = (self._pose.inverse() @ T_odom_base).xyt.tolist()
        if math.hypot(x, y) < self.config.slip_travel:
            if abs(yaw) > 0.6:
                self._pose, self._points = T_odom_base, points
            return False
        tree = scipy.spatial.cKDTree(self._points)
        still = _misfit(tree, SE2.from_xyt(0.0, 0.0, yaw) @ points)
        moved = _misfit(tree, SE2.from_xyt(x, y, yaw) @ points)
        stood = _misfit(tree, points)
        self._pose, self._points = T_odom_base, points
        return min(still, stood) < self.config.slip_ratio * moved


def _misfit(tree: scipy.spatial.cKDTree, points: Array) -> float:
    """Mean distance of points to their nearest neighbours, far ones cut at 0.2 m."""
    distance, _ = tree.query(points, distance_upper_bound=0.2)
    return float(np.minimum(distance, 0.2).mean())


class Guard:
    """Decides at every sweep, and watches over every command."""

    def __init__(self, model: RobotModel, rule: AvoidConfig, config: GuardConfig) -> None:
        self.config = config
        self.rule = rule
        self.monitor = CollisionMonitor(model, config.monitor)
        self.stuck = 0
        """How often it noticed that it was stuck."""
        self._half_width = float(np.abs(model.footprint[:, 1]).max()) + config.side_room
        self._nose = float(model.footprint[:, 0].max())
        self._tail = float(model.footprint[:, 0].min())
        self._turning = 0.0
        self._flips = 0
        self._slip = SlipWatch(config)
        self._unseen: list[tuple[float, Array]] = []
        self._manoeuvre: _Escape | None = None
        self._anchor: tuple[float, SE2] | None = None

    def interrupted(self) -> None:
        """Someone else has driven: manoeuvres and what was being watched are over; places stay known."""
        self._manoeuvre, self._anchor = None, None
        self._turning, self._flips = 0.0, 0
        self._slip.reset()

    def points_base(self, view: View) -> Array:
        """Everything to keep off, seen from the base: the sweep and the remembered places."""
        alive = [(t, p) for t, p in self._unseen if view.now_s - t < self.config.memory]
        self._unseen = alive
        points = np.concatenate([view.hits_odom, *[p for _, p in alive]])
        return view.T_odom_base.inverse() @ points

    def decide(self, view: View, last: Twist) -> Decision:
        """What to do after a new sweep."""
        if self._slip.slipping(view.T_odom_base, view.hits_odom) and self._manoeuvre is None:
            self._got_stuck(view, last)
        if self._manoeuvre is not None:
            command = self._manoeuvre.command(view.T_odom_base)
            if command is not None:
                return self._possible(Decision("back off" if command.v else "turn away", command), view)
            self._manoeuvre = None
            self._slip.reset()
        return self._possible(self._tiers(view), view)

    def pass_on(self, command: Twist, view: View) -> Twist:
        """The command as far as it is safe in this tick."""
        factor = self.monitor.limit(command, self.points_base(view))
        return Twist(command.v * factor, command.w * factor)

    def _tiers(self, view: View) -> Decision:
        s, rule = view.sectors, self.rule
        gap = self._gap(self.points_base(view))
        near = s.front < rule.stop_distance or gap < self.config.nose_room
        if near:
            self._turn_to(1.0 if s.left > s.right else -1.0)
            side = "left" if self._turning > 0.0 else "right"
            return Decision(f"stop, turn {side}", Twist(0.0, self._turning * rule.turn_w))
        self._turning, self._flips = 0.0, 0
        if self._restless(view):
            self._manoeuvre = _Escape(view.T_odom_base, 0.0, self._to_most_room(view), self.config)
            return Decision("turn away", Twist(0.0, 0.0))
        side, sign = ("left", 1.0) if s.left > s.right else ("right", -1.0)
        if s.front <= rule.slow_distance:
            return Decision(f"slow, veer {side}", Twist(rule.slow_v, sign * rule.slow_w))
        return Decision("straight", Twist(rule.cruise_v, 0.0))

    def _turn_to(self, freer: float) -> None:
        """Turn to the freer side; after some changes of mind keep to one until the way is free."""
        if self._turning == 0.0 or (freer != self._turning and self._flips < self.config.flips):
            self._flips += self._turning != 0.0
            self._turning = freer

    def _gap(self, points: Array) -> float:
        """Free length before the nose within the corridor as wide as the robot."""
        ahead = points[(points[:, 0] > 0.0) & (np.abs(points[:, 1]) < self._half_width)]
        return float(ahead[:, 0].min()) - self._nose if len(ahead) else math.inf

    def _possible(self, decision: Decision, view: View) -> Decision:
        """The decision, or the nearest thing to it that touches nothing."""
        points = self.points_base(view)
        command = decision.command
        if self.monitor.limit(command, points) > POSSIBLE:
            return decision
        w = self.rule.turn_w
        first = math.copysign(w, command.w if command.w else self._turning or 1.0)
        for name, other in (
            ("turn", Twist(0.0, first)),
            ("turn", Twist(0.0, -first)),
            ("back off", Twist(-self.config.back_off_v, 0.0)),
            ("creep", Twist(0.5 * self.rule.slow_v, 0.0)),
        ):
            if self.monitor.limit(other, points) > POSSIBLE:
                if other.w:
                    self._turning = math.copysign(1.0, other.w)
                return Decision(name, other)
        return Decision("hold", Twist())

    def _got_stuck(self, view: View, last: Twist) -> None:
        """Remember what cannot be seen at the leading edge, and start to get away from it."""
        self.stuck += 1
        self._turning = 0.0
        backwards = last.v < 0.0
        edge = self._tail - BEHIND_M if backwards else self._nose + AHEAD_M
        ys = np.linspace(-self._half_width, self._half_width, 5)
        edge_points = np.stack([np.full(5, edge), ys], axis=1)
        self._unseen.append((view.now_s, view.T_odom_base @ edge_points))
        away = self.config.turn_away * (1.0 if view.sectors.left > view.sectors.right else -1.0)
        distance = self.config.back_off * (-1.0 if backwards else 1.0)
        self._manoeuvre = _Escape(view.T_odom_base, distance, away, self.config)

    def _restless(self, view: View) -> bool:
        """Whether it has been about the same place for long."""
        if self._anchor is not None:
            t, pose = self._anchor
            if float(np.linalg.norm(view.T_odom_base.xy - pose.xy)) < self.config.restless_reach:
                if view.now_s - t < self.config.restless:
                    return False
                self._anchor = (view.now_s, view.T_odom_base)
                return True
        self._anchor = (view.now_s, view.T_odom_base)
        return False

    def _to_most_room(self, view: View) -> float:
        """Angle to the 30 degree sector whose nearest point is farthest away."""
        points = view.T_odom_base.inverse() @ view.hits_odom
        bearing = np.arctan2(points[:, 1], points[:, 0])
        distance = np.linalg.norm(points, axis=1)
        best, angle = -1.0, math.pi
        for center in np.linspace(-math.pi, math.pi, 24, endpoint=False):
            off = np.abs((bearing - center + math.pi) % (2.0 * math.pi) - math.pi)
            inside = distance[off < math.radians(15.0)]
            room = float(inside.min()) if len(inside) else 10.0
            if room > best:
                best, angle = room, float(center)
        return angle


class _Escape:
    """Back off a distance, then turn an angle, or as much of both as a few seconds allow."""

    def __init__(self, start: SE2, distance: float, angle: float, config: GuardConfig) -> None:
        self._config = config
        self._distance = distance
        self._angle = angle
        self._start = start
        self._turned_from: float | None = None
        self._sweeps = 0

    def command(self, T_odom_base: SE2) -> Twist | None:
        """The twist until the next sweep; None when it is over."""
        self._sweeps += 1
        if self._sweeps > 50:
            return None
        done = float(np.linalg.norm(T_odom_base.xy - self._start.xy))
        if self._turned_from is None and done < abs(self._distance) and self._sweeps < 20:
            return Twist(-math.copysign(self._config.back_off_v, self._distance), 0.0)
        if self._turned_from is None:
            self._turned_from = float(T_odom_base.yaw)
        turned = (float(T_odom_base.yaw) - self._turned_from + math.pi) % (2.0 * math.pi) - math.pi
        if abs(turned) >= min(abs(self._angle), math.pi - 0.2):
            return None
        return Twist(0.0, math.copysign(0.5, self._angle))
