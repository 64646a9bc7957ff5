"""Dynamic window approach (Fox, Burgard, Thrun 1997) over a navigation function (Brock, Khatib 1999).

Every arc that can be reached within the acceleration limits is driven in thought with the whole
footprint; the admissible one that gets nearest to the goal along the floor, and to the path, wins.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from datasets.se2 import SE2, Array
from datasets.types import RobotModel, Twist
from planners.control.interface import Ramped, ramped
from planners.control.monitor import moved
from planners.control.pursuit import Pursuit, PursuitConfig
from planners.costmap import Costmap
from planners.distance import distance_field
from planners.footprint import Field32, footprint_clearance, sample_footprint
from planners.wavefront import wave


class DwaConfig(BaseModel):
    """Names as in dwa_local_planner where the idea is the same; SI units."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    max_v: float = Field(default=1.4, gt=0.0)
    min_v: float = -0.4
    """Backwards, as far as the robot goes; 0 forbids it."""
    max_w: float = Field(default=2.0, gt=0.0)
    acceleration_share: float = Field(default=0.8, gt=0.0, le=1.0)
    window: float = Field(default=0.25, gt=0.0)
    """Time ahead over which the limits let the speed change [s]."""
    sim_time: float = Field(default=1.2, gt=0.0)
    sim_step: float = Field(default=0.1, gt=0.0)
    vx_samples: int = Field(default=9, ge=2)
    vth_samples: int = Field(default=21, ge=3)
    path_distance_bias: float = Field(default=0.3, ge=0.0)
    goal_distance_bias: float = Field(default=1.0, ge=0.0)
    forward_point_distance: float = Field(default=0.325, ge=0.0)
    backward_bias: float = Field(default=1.5, ge=0.0)
    """How many metres more of way a metre driven backwards counts as: it is slow, turning round pays."""
    clearance_bias: float = Field(default=1.5, ge=0.0)
    """Worth of each metre of room up to `comfort`, in metres of way."""
    comfort: float = Field(default=0.3, gt=0.0)
    least_room: float = Field(default=0.06, ge=0.0)
    """An arc that comes nearer than this to something is not admissible."""
    turning_room: float = Field(default=0.04, ge=0.0)
    """Ways as wide as the circumscribed circle and this are preferred, however long."""
    passage_room: float = Field(default=0.08, ge=0.0)
    """Ways narrower than the inscribed circle and this are not counted on."""
    settle_distance: float = Field(default=0.45, gt=0.0)
    """From here on the goal's pose is settled on as pure pursuit does."""


class Dwa(Ramped):
    """A controller (see planners.control.interface)."""

    def __init__(self, model: RobotModel, config: DwaConfig, pursuit: PursuitConfig, period: float) -> None:
        self.config = config
        super().__init__(
            model,
            period,
            max_v=config.max_v,
            max_w=config.max_w,
            acceleration_share=config.acceleration_share,
        )
        self.samples = sample_footprint(model, 0.05)
        self.state = "idle"
        self._settler = Pursuit(model, pursuit, period)
        self._path = SE2.identity(0)
        self._costmap: Costmap | None = None
        self._to_goal: Field32 = np.zeros((1, 1), dtype=np.float32)
        self._to_path: Field32 = np.zeros((1, 1), dtype=np.float32)

    def set_path(self, poses: SE2) -> None:
        """Follow a new path; the last pose is the goal."""
        self._path = poses
        self._costmap = None
        self._settler.set_path(poses)
        self.state = "follow"

    def command(self, pose: SE2, last: Twist, costmap: Costmap) -> Twist:
        """The next command: the best arc, or the settling on the goal."""
        if len(self._path) < 2:
            return self.brake(last)
        gap = float(np.linalg.norm(self._path.xy[-1] - pose.xy))
        if gap < self.config.settle_distance:
            if self._settler.state in ("turn", "follow"):
                self._settler.state = "settle"
            command = self._settler.command(pose, last, costmap)
            self.state = self._settler.state
            return command
        self.state = "follow"
        self._look_at(pose, costmap)
        return ramped(self._best_arc(pose, last, costmap), last, self.limits)

    def _look_at(self, pose: SE2, costmap: Costmap) -> None:
        """Distances to goal and path over the floor, anew when the floor has changed."""
        if costmap is self._costmap:
            return
        self._costmap = costmap
        res = costmap.resolution
        cells = np.floor((costmap.T_grid_map @ self._path.xy)[:, ::-1] / res).astype(np.int64)
        cells = np.clip(cells, 0, np.array(costmap.lethal.shape) - 1)
        here = np.floor((costmap.T_grid_map @ pose.xy)[::-1] / res).astype(np.int64)
        here = np.clip(here, 0, np.array(costmap.lethal.shape) - 1)
        s = self.samples
        for radius in (
            s.circumscribed + self.config.turning_room,
            s.inscribed + self.config.passage_room,
        ):
            free = costmap.clearance > radius
            self._to_goal = wave(free, int(cells[-1, 0]), int(cells[-1, 1]), np.inf) * np.float32(res)
            if np.isfinite(self._to_goal[here[0], here[1]]):
                break
        on = np.zeros(costmap.lethal.shape, dtype=bool)
        on[cells[:, 0], cells[:, 1]] = True
        self._to_path = distance_field(on, res)

    def _best_arc(self, pose: SE2, last: Twist, costmap: Costmap) -> Twist:
        c, limits = self.config, self.limits
        dv, dw = limits.max_dv * c.window, limits.max_dw * c.window
        lowest = min(max(c.min_v, -limits.max_v), 0.0)
        vs = np.linspace(max(last.v - dv, lowest), min(last.v + dv, limits.max_v), c.vx_samples)
        ws = np.linspace(max(last.w - dw, -limits.max_w), min(last.w + dw, limits.max_w), c.vth_samples)
        # dwa_local_planner: an exact zero joins when the window straddles it.
        vs, ws = np.union1d(vs, [0.0] if vs[0] < 0.0 < vs[-1] else []), np.union1d(ws, [0.0])
        x, y, yaw = (costmap.T_grid_map @ pose).xyt.tolist()
        s = self.samples
        v, w = best_arc(
            costmap.clearance,
            self._to_goal,
            self._to_path,
            costmap.resolution,
            s.points,
            s.inscribed,
            s.circumscribed,
            x,
            y,
            yaw,
            vs,
            ws,
            np.array(
                [
                    c.sim_time,
                    c.sim_step,
                    0.8 * limits.max_dv,
                    c.goal_distance_bias,
                    c.path_distance_bias,
                    c.forward_point_distance,
                    c.clearance_bias,
                    c.comfort,
                    c.least_room,
                    c.backward_bias,
                ]
            ),
        )
        return Twist(v, w)


@njit(cache=True)
def _value(field: Field32, resolution: float, x: float, y: float, otherwise: float) -> float:
    rows, cols = field.shape
    row, col = math.floor(y / resolution), math.floor(x / resolution)
    if row < 0 or col < 0 or row >= rows or col >= cols or not math.isfinite(field[row, col]):
        return otherwise
    return field[row, col]


@njit(cache=True)
def best_arc(
    clearance: Field32,
    to_goal: Field32,
    to_path: Field32,
    resolution: float,
    points: Array,
    inscribed: float,
    circumscribed: float,
    x: float,
    y: float,
    yaw: float,
    vs: Array,
    ws: Array,
    settings: NDArray[np.float64],
) -> tuple[float, float]:
    """The (v, w) of least cost among vs x ws, in the grid frame; (0, 0) when none is admissible.

    `settings`: simulated time, step, braking, biases of goal and path, forward point, bias of room,
    comfortable room, least room, bias of backward driving. An arc is admissible when the robot can stop
    before the place
    where it would come nearer than the least room; one that starts too near may only get freer.
    """
    time, step, braking, k_goal, k_path, ahead, k_room, comfort, least, k_back = settings
    here = footprint_clearance(clearance, resolution, points, inscribed, circumscribed, x, y, yaw)
    base = _value(to_goal, resolution, x, y, 1.0e3)
    best_cost, best_v, best_w = np.inf, 0.0, 0.0
    for v in vs:
        for w in ws:
            # Long enough to see the stopping distance.
            horizon = max(time, abs(v) / braking + step)
            steps = math.ceil(horizon / step)
            room, stop_needed = np.inf, 0.5 * v * v / braking + abs(v) * step
            px, py, pyaw, admissible = x, y, yaw, True
            ex, ey, eyaw = x, y, yaw
            for i in range(1, steps + 1):
                px, py, pyaw = moved(x, y, yaw, v, w, i * step)
                d = footprint_clearance(clearance, resolution, points, inscribed, circumscribed, px, py, pyaw)
                if d < least and d <= here:
                    # It stops here at the latest: what counts is where it got to.
                    if abs(v) * (i - 1) * step < stop_needed or i <= 2:
                        admissible = False
                    break
                room = min(room, d)
                if i * step <= time + 1e-9:
                    ex, ey, eyaw = px, py, pyaw
            if not admissible:
                continue
            far = base + 1.0
            end = _value(to_goal, resolution, ex, ey, far)
            fx, fy = ex + ahead * math.cos(eyaw), ey + ahead * math.sin(eyaw)
            nose = _value(to_goal, resolution, fx, fy, far)
            off = _value(to_path, resolution, ex, ey, 1.0)
            back = max(-v, 0.0) * time
            cost = k_goal * (end + nose) + k_path * off + k_back * back - k_room * min(room, comfort)
            if cost < best_cost:
                best_cost, best_v, best_w = cost, v, w
    return best_v, best_w
