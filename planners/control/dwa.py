"""Dynamic window approach (Fox, Burgard, Thrun 1997) over a navigation function (Brock, Khatib 1999).

Every arc that can be reached within the acceleration limits is simulated with the whole
footprint; the admissible one that ends nearest to the goal (distance along the floor) and to the path wins.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.types import RobotModel, Twist
from turtlebag.planners.control.collision_monitor import moved
from turtlebag.planners.control.controller import ACCELERATION_SHARE, Ramped, ramped
from turtlebag.planners.control.pursuit import Phase, Pursuit
from turtlebag.planners.costmap import COST_SCALING, Costmap, distance_field, inflated_cost_at
from turtlebag.planners.footprint import (
    Field32,
    FootprintSamples,
    field_at,
    footprint_clearance,
    sample_footprint,
)
from turtlebag.planners.grid_distance import grid_distance


class DwaConfig(Settings):
    """The parameter preset."""

    preset: Literal["own", "tutorial"] = "own"
    """`tutorial`: turtlebot3_navigation's (noetic, dwa_local_planner_params)."""


class Window(NamedTuple):
    """The arcs that are tried; named as in dwa_local_planner where the idea is the same, SI units."""

    max_v: float = 1.4
    """At its top speed, the jackal scores 0.500 instead of 0.488 on 13 BARN worlds, with 1 cm less
    clearance."""
    min_v: float = -0.4
    """Driving backwards, up to the robot's own limit; if it were faster, turning round would not pay."""
    max_w: float = 2.0
    """At its top speed, the jackal gets stuck in one of 13 BARN worlds."""
    time: float = 0.25
    """Time over which the acceleration limits open the window [s]."""
    vx_samples: int = 9
    vth_samples: int = 21
    settle_distance: float = 0.45
    """Within this distance the robot settles on the goal's pose as pure pursuit does."""


class ArcFloor(NamedTuple):
    """Fields (rows, cols) [m] on the grid: clearance, and the distances to goal and path."""

    clearance: Field32
    to_goal: Field32
    to_path: Field32
    resolution: float


FORWARD_M = 0.325
"""Distance of the forward point ahead of the robot: dwa_local_planner's own."""
STEP_S = 0.1
"""Time step of the simulated arcs."""
WAYS_EVERY = 3
"""Control periods from one computation of the distances to goal and path to the next, where obstacles change:
they guide; the clearance, which keeps the robot from touching anything, is the newest in each period."""
COMFORT_M = 0.3
"""More clearance than this is worth nothing; with 0.2 the 13 BARN worlds take 9.4 s instead of 8.8."""


class ArcWeights(NamedTuple):
    """The simulated time of an arc and its cost; weights in metres of path per metre."""

    time: float = 1.2
    """Simulated time [s]."""
    braking: float = 0.0
    goal: float = 1.0
    path: float = 0.3
    ahead: float = FORWARD_M
    """Distance of the forward point ahead of the robot [m]."""
    room: float = 1.5
    """Value of a metre of clearance, up to COMFORT_M."""
    least: float = 0.06
    """With less clearance [m] an arc is not admissible."""
    back: float = 1.5
    """Metres of path that a metre driven backwards counts in addition: it is slow, and turning round pays."""
    nose: float = 0.0
    """The forward point's distance to the path."""
    occupied: float = 0.0
    """costmap_2d's inflated cost (0..252)."""
    least_v: float = 0.0
    least_w: float = 0.0


TURNING_M, PASSAGE_M = 0.04, 0.08
"""Passages wider than the circumscribed circle plus the first are preferred, however long the way; those
narrower than the inscribed circle plus the second are not used. With 0.04 for both the jackal almost touches
something (BARN 250: 0.0 m instead of 0.036), with 0.08 for both it gets stuck in one of 13 worlds."""


TUTORIAL_WINDOW = Window(
    max_v=0.26, min_v=-0.26, max_w=2.75, vx_samples=20, vth_samples=40, settle_distance=0.2
)
"""turtlebot3_navigation's. Within the settling distance, every arc at the least speed, half of the highest,
would end beyond the goal after the simulated time."""
TUTORIAL_BURGER = ArcWeights(
    time=1.5, goal=20.0, path=32.0, nose=32.0, room=0.0, least=0.0, back=0.0, occupied=0.02, least_w=1.37
)
"""turtlebot3_navigation's dwa_local_planner_params_burger.yaml."""
TUTORIAL_WAFFLE = TUTORIAL_BURGER._replace(time=2.0, least_w=0.9)
"""dwa_local_planner_params_waffle.yaml: longer simulated time, slower turns."""
OPENED_V = 0.25
"""The tutorial's acc_lim_x of 2.5 m/s^2 is not used, because a burger tips above 1.3; but the speeds that it
opens in 0.1 s are, because the least speed is out of reach from a standstill otherwise."""


def numbers(config: DwaConfig, model: RobotModel) -> tuple[Window, ArcWeights]:
    """The arcs that are tried, and their cost."""
    if config.preset == "own":
        return Window(), ArcWeights()
    window = TUTORIAL_WINDOW._replace(time=OPENED_V / (ACCELERATION_SHARE * model.max_dv))
    costs = TUTORIAL_BURGER if model.max_v < window.max_v else TUTORIAL_WAFFLE
    return window, costs._replace(least_v=0.5 * min(model.max_v, window.max_v))


class Dwa(Ramped):
    """A controller (see turtlebag.planners.control.controller)."""

    def __init__(self, model: RobotModel, config: DwaConfig, period: float) -> None:
        self.window, self.weights = numbers(config, model)
        super().__init__(model, period, max_v=self.window.max_v, max_w=self.window.max_w)
        self.samples = sample_footprint(model, 0.05)
        self.state: str = Phase.IDLE
        self._settler = Pursuit(model, period)
        self._path = SE2.identity(0)
        self._costmap: Costmap | None = None  # of the floor
        self._floor: ArcFloor | None = None
        self._age = 0  # of the floor, in control periods
        self._to_path: tuple[SE2, Field32] | None = None  # and the frame of its grid

    def set_path(self, poses: SE2) -> None:
        """Follow a new path; the last pose is the goal."""
        self._path = poses
        self._floor = self._to_path = None
        self._settler.set_path(poses)
        self.state = Phase.FOLLOW

    def command(self, pose: SE2, last: Twist, costmap: Costmap) -> Twist:
        """The next command: the best arc, or the settling on the goal."""
        if len(self._path) < 2:
            return self.brake(last)
        gap = math.dist(self._path.xy[-1], pose.xy)
        if gap < self.window.settle_distance:
            if self._settler.state in (Phase.TURN, Phase.FOLLOW):
                self._settler.state = Phase.SETTLE
            command = self._settler.command(pose, last, costmap)
            self.state = self._settler.state
            return command
        self.state = Phase.FOLLOW
        return ramped(self._best_arc(pose, last, costmap), last, self.limits)

    def floor(self, pose: SE2, costmap: Costmap) -> ArcFloor:
        """Clearance, and distances to goal and path over the floor. Those are computed again with a new path,
        on another grid, and from time to time where the costmap has changed."""
        self._age += 1
        was = self._costmap
        moved_on = was is None or costmap.T_map_grid is not was.T_map_grid
        if self._floor is None or moved_on or (costmap is not was and self._age >= WAYS_EVERY):
            self._costmap, self._floor, self._age = costmap, self._new_floor(pose, costmap), 0
        return self._floor._replace(clearance=costmap.clearance)

    def _new_floor(self, pose: SE2, costmap: Costmap) -> ArcFloor:
        res = costmap.resolution
        cells = np.floor((costmap.T_grid_map @ self._path.xy)[:, ::-1] / res).astype(np.int64)
        cells = np.clip(cells, 0, np.array(costmap.lethal.shape) - 1)
        here = np.floor((costmap.T_grid_map @ pose.xy)[::-1] / res).astype(np.int64)
        here = np.clip(here, 0, np.array(costmap.lethal.shape) - 1)
        s = self.samples
        for radius in (
            s.circumscribed + TURNING_M,
            s.inscribed + PASSAGE_M,
        ):
            free = costmap.clearance > radius
            to_goal = grid_distance(free, int(cells[-1, 0]), int(cells[-1, 1]), np.inf) * np.float32(res)
            if np.isfinite(to_goal[here[0], here[1]]):
                break
        if self._to_path is None or self._to_path[0] is not costmap.T_map_grid:
            on = np.zeros(costmap.lethal.shape, dtype=bool)
            on[cells[:, 0], cells[:, 1]] = True
            self._to_path = costmap.T_map_grid, distance_field(on, res)
        return ArcFloor(costmap.clearance, to_goal, self._to_path[1], res)

    def speeds(self, last: Twist) -> tuple[Array, Array]:
        """The dynamic window: speeds (n,) and turning speeds (m,) that are tried after a command."""
        c, limits = self.window, self.limits
        dv, dw = limits.max_dv * c.time, limits.max_dw * c.time
        lowest = min(max(c.min_v, -limits.max_v), 0.0)
        vs = np.linspace(max(last.v - dv, lowest), min(last.v + dv, limits.max_v), c.vx_samples)
        ws = np.linspace(max(last.w - dw, -limits.max_w), min(last.w + dw, limits.max_w), c.vth_samples)
        # as in dwa_local_planner, an exact zero is added when the window straddles it
        return with_zero(vs) if vs[0] < 0.0 < vs[-1] else vs, with_zero(ws)

    def _best_arc(self, pose: SE2, last: Twist, costmap: Costmap) -> Twist:
        # nearer to the goal than that, the forward point would hold the robot back
        near = math.dist(self._path.xy[-1], pose.xy) < FORWARD_M
        ahead = 0.0 if near else FORWARD_M
        weights = self.weights._replace(braking=ACCELERATION_SHARE * self.limits.max_dv, ahead=ahead)
        at = tuple((costmap.T_grid_map @ pose).xyt.tolist())
        return Twist(*best_arc(self.floor(pose, costmap), self.samples, at, *self.speeds(last), weights))


def with_zero(speeds: Array) -> Array:
    """Rising speeds (n,) and a zero, if there is none."""
    at = int(np.searchsorted(speeds, 0.0))
    there = at < len(speeds) and speeds[at] == 0.0
    return speeds if there else np.concatenate([speeds[:at], [0.0], speeds[at:]])


@njit(cache=True)
def value_at(field: Field32, resolution: float, x: float, y: float, otherwise: float) -> float:
    """The field's value in the cell of a point; `otherwise` off the field, or where it is not finite."""
    (rows, cols), per_metre = field.shape, 1.0 / resolution  # one division for many points
    row, col = math.floor(y * per_metre), math.floor(x * per_metre)
    if row < 0 or col < 0 or row >= rows or col >= cols or not math.isfinite(field[row, col]):
        return otherwise
    return field[row, col]


class ArcPose(NamedTuple):
    """A pose on an arc."""

    x: float
    y: float
    yaw: float
    cos: float
    sin: float


@njit(cache=True)
def unit_arcs(yaw: float, ws: Array, steps: int) -> Array:
    """Arcs at 1 m/s, (len(ws), steps + 1, 5), a pose every STEP_S: way in x and y, yaw, its cosine and sine.

    At other speeds, the way is longer or shorter, and nothing else changes.
    """
    out = np.empty((len(ws), steps + 1, 5))
    for k in range(len(ws)):
        for i in range(steps + 1):
            x, y, end = moved(0.0, 0.0, yaw, 1.0, ws[k], i * STEP_S)
            out[k, i] = x, y, end, math.cos(end), math.sin(end)
    return out


@njit(cache=True)
def pose_on(pose: tuple[float, float, float], v: float, unit: Array) -> ArcPose:
    """Where an arc's pose (5,) at 1 m/s is at `v`, begun at a pose."""
    return ArcPose(pose[0] + v * unit[0], pose[1] + v * unit[1], unit[2], unit[3], unit[4])


@njit(cache=True)
def best_arc(
    floor: ArcFloor,
    footprint: FootprintSamples,
    pose: tuple[float, float, float],
    vs: Array,
    ws: Array,
    c: ArcWeights,
) -> tuple[float, float]:
    """The (v, w) of least cost among vs x ws from a pose in the grid frame; (0, 0) if none is admissible."""
    x, y, yaw = pose
    inscribed, circumscribed, outline = footprint.inscribed, footprint.circumscribed, footprint.outline
    edge = FootprintSamples(footprint.points[:outline], inscribed, circumscribed, outline)
    here = footprint_clearance(floor.clearance, floor.resolution, footprint, x, y, yaw)
    # Distance from where no way leads to the goal: longer than any way over the cells.
    base = value_at(floor.to_goal, floor.resolution, x, y, floor.clearance.size * floor.resolution)
    n, far = len(vs) * len(ws), base + 1.0
    arcs = unit_arcs(yaw, ws, max(steps_of(vs[0], c), steps_of(vs[-1], c)))
    bounds = np.full(n, np.inf)
    for k in range(n):
        v, w = vs[k // len(ws)], ws[k % len(ws)]
        if abs(v) >= c.least_v or abs(w) >= c.least_w:
            bounds[k] = least_cost(floor, pose, v, arcs[k % len(ws)], inscribed, far, c)
    best_cost, best = np.inf, -1
    # The most promising ones first: the others need no look at what is around them.
    for k in np.argsort(bounds):
        if bounds[k] > best_cost or bounds[k] == np.inf:
            break
        v, arc = vs[k // len(ws)], arcs[k % len(ws)]
        room, last = along_arc(floor, footprint, edge, pose, v, arc, c, here)
        if room == -np.inf:
            continue
        cost = arc_cost(floor, pose_on(pose, v, arc[last]), v, room, inscribed, far, c)
        if cost < best_cost or (cost == best_cost and k < best):
            best_cost, best = cost, k
    return (0.0, 0.0) if best < 0 else (vs[best // len(ws)], ws[best % len(ws)])


@njit(cache=True)
def steps_of(v: float, c: ArcWeights) -> int:
    """How many steps an arc is looked at: long enough to include the stopping distance."""
    return math.ceil(max(c.time, abs(v) / c.braking + STEP_S) / STEP_S)


@njit(cache=True)
def least_cost(
    floor: ArcFloor,
    pose: tuple[float, float, float],
    v: float,
    arc: Array,
    inscribed: float,
    far: float,
    c: ArcWeights,
) -> float:
    """The cost of an arc where there is all the room in the world, wherever it may have to end."""
    least, judged = np.inf, round(c.time / STEP_S)
    for i in range(min(2, judged), judged + 1):
        least = min(least, arc_cost(floor, pose_on(pose, v, arc[i]), v, np.inf, inscribed, far, c))
    return least


@njit(cache=True)
def along_arc(
    floor: ArcFloor,
    footprint: FootprintSamples,
    edge: FootprintSamples,
    pose: tuple[float, float, float],
    v: float,
    arc: Array,
    c: ArcWeights,
    here: float,
) -> tuple[float, int]:
    """Least room along an arc [m], and the step at which it is judged; -inf if the arc is not admissible.

    It is admissible if the robot can stop before its clearance falls below the least one; an arc that starts
    with less (`here`) may only gain clearance.
    """
    clearance, resolution, circumscribed = floor.clearance, floor.resolution, footprint.circumscribed
    # More room than this makes no difference.
    enough = COMFORT_M + resolution if c.occupied == 0.0 else np.inf
    room, stop_needed, last = np.inf, 0.5 * v * v / c.braking + abs(v) * STEP_S, 0
    for i in range(1, steps_of(v, c) + 1):
        at = pose_on(pose, v, arc[i])
        center = field_at(clearance, resolution, at.x, at.y)
        if center - circumscribed > enough:
            d = center - circumscribed
        else:
            # If nothing is within the circle, nothing is within the polygon: its outline decides.
            checked = edge if center > circumscribed + resolution else footprint
            d = footprint_clearance(clearance, resolution, checked, at.x, at.y, at.yaw)
        if d < c.least and d <= here:
            # It stops here at the latest, so this is the end of the arc.
            if abs(v) * (i - 1) * STEP_S < stop_needed or i <= 2:
                return -np.inf, last
            break
        room, last = min(room, d), min(i, round(c.time / STEP_S))
    return room, last


@njit(cache=True)
def arc_cost(
    floor: ArcFloor, end: ArcPose, v: float, room: float, inscribed: float, far: float, c: ArcWeights
) -> float:
    """The cost of an arc with its `end` and its least `room` [m]; `far` [m] is the way from off the floor."""
    resolution = floor.resolution
    fx, fy = end.x + c.ahead * end.cos, end.y + c.ahead * end.sin
    way = value_at(floor.to_goal, resolution, end.x, end.y, far)
    nose = value_at(floor.to_goal, resolution, fx, fy, far)
    off = value_at(floor.to_path, resolution, end.x, end.y, 1.0)
    back = max(-v, 0.0) * c.time
    cost = c.goal * (way + nose) + c.path * off + c.back * back - c.room * min(room, COMFORT_M)
    if c.nose > 0.0:
        cost += c.nose * value_at(floor.to_path, resolution, fx, fy, 1.0)
    if c.occupied > 0.0:
        cost += c.occupied * inflated_cost_at(room - inscribed, COST_SCALING)
    return float(cost)
