"""A back end, a global planner, a controller, a task and a world: the smallest that pass their checks."""

import math

import numpy as np

from turtlebag.datasets.se2 import SE2, compose
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.navigation.driver import Driver
from turtlebag.pipeline.slam.graph.cost import residuals
from turtlebag.planners.control.controller import Ramped
from turtlebag.planners.grid_distance import descend, grid_distance
from turtlebag.planners.planner import NoPath, Plan
from turtlebag.planners.smoothing import path_length, with_headings
from turtlebag.sim.shapes import box
from turtlebag.sim.simulator import CONTROL_HZ
from turtlebag.sim.world import World


class GaussNewton:
    """Back end: Gauss-Newton with a dense matrix, constraints reweighted in each round (Cauchy)."""

    def optimise(self, T_map_keys, constraints, iterations=30):
        """As in `turtlebag.pipeline.slam.graph.back_end.BackEnd`."""
        poses, n = T_map_keys.xyt.copy(), len(T_map_keys)
        for _ in range(iterations):
            H, b = 1e-9 * np.eye(3 * n), np.zeros(3 * n)
            H[:3, :3] += 1e12 * np.eye(3)
            for c, e in zip(constraints, residuals(SE2(poses), constraints), strict=True):
                squared = e @ c.information @ e
                weight = 1.0 / (1.0 + squared / c.cauchy**2) if c.cauchy else 1.0
                A, B = _jacobians(poses[c.i], poses[c.j])
                for a, row in ((c.i, A), (c.j, B)):
                    b[3 * a : 3 * a + 3] += row.T @ (weight * c.information) @ e
                    for d, column in ((c.i, A), (c.j, B)):
                        block = row.T @ (weight * c.information) @ column
                        H[3 * a : 3 * a + 3, 3 * d : 3 * d + 3] += block
            step = np.linalg.solve(H, -b).reshape(n, 3)
            poses = np.array([compose(pose, move) for pose, move in zip(poses, step, strict=True)])
            if np.abs(step).max() < 1e-7:
                break
        return SE2(poses)


def _jacobians(T_i, T_j):
    """Jacobians of a constraint's error by small motions (3,) of poses i and j in their own frames."""
    x, y, yaw = (SE2(T_j).inverse() @ SE2(T_i)).xyt
    c, s = np.cos(yaw), np.sin(yaw)
    return -np.array([[c, -s, y], [s, c, -x], [0.0, 0.0, 1.0]]), np.eye(3)


class OverCells:
    """Global planner: the shortest grid path for the disc around the footprint."""

    def __init__(self, config):
        self._config = config

    def plan(self, costmap, model, T_map_start, T_map_goal, seed):
        """As in `turtlebag.planners.planner.GlobalPlanner`."""
        start, goal = costmap.T_grid_map @ T_map_start, costmap.T_grid_map @ T_map_goal
        free = costmap.clearance > model.circumscribed_radius + 0.1
        (row, col), to = (tuple(np.floor(T.xy[::-1] / costmap.resolution).astype(int)) for T in (start, goal))
        from_goal = grid_distance(free, *to, np.inf)
        if not np.isfinite(from_goal[row, col]):
            raise NoPath("no path leads there")
        cells = descend(from_goal, row, col)[1:-1, ::-1]
        points = np.vstack([start.xy, (cells + 0.5) * costmap.resolution, goal.xy])
        poses = with_headings(points, float(start.yaw), float(goal.yaw))
        return Plan(costmap.T_map_grid @ poses, path_length(points), 0.0, "over cells")


class Carrot(Ramped):
    """Controller: turns towards a lookahead point on the path, then drives to it."""

    def __init__(self, model, period):
        super().__init__(model, period, max_v=0.2, max_w=1.0, acceleration_share=0.5)
        self.state, self._path = "idle", None

    def set_path(self, poses):
        """As in `turtlebag.planners.control.controller.Controller`."""
        self._path = poses

    def command(self, pose, last, costmap):
        """As in `Controller`."""
        if self._path is None:
            return self.ramp(Twist(), last)
        at = np.linalg.norm(self._path.xy - pose.xy, axis=1)
        ahead = self._path[min(int(at.argmin()) + 5, len(self._path) - 1)]
        x, y, yaw = (pose.inverse() @ ahead).xyt.tolist()
        if math.hypot(x, y) < 0.02:
            self.state = "align"
            return self.ramp(Twist(0.0, yaw), last)
        self.state, bearing = "follow", math.atan2(y, x)
        v = min(0.2, math.hypot(x, y)) * max(0.0, math.cos(bearing)) ** 4
        return self.ramp(Twist(v, 1.5 * bearing), last)


class Wander(Driver):
    """Task: drives straight for eight seconds, turning away from near obstacles."""

    def __init__(self, kit, mission):
        super().__init__(kit.sensing)
        self._limits = Carrot(kit.robot.model, 1.0 / CONTROL_HZ)

    def step(self, observation):
        """As in `turtlebag.pipeline.navigation.driver.Task`."""
        self.stand_by(observation)
        near = self.sensing.sweep is None or self.sensing.sweep.sectors.front < 0.6
        wanted = Twist() if self.finished else Twist(0.0, 0.8) if near else Twist(0.2, 0.0)
        self.state = "turn" if near else "drive"
        self._last = self._limits.ramp(wanted, self._last)
        return self._last

    def stand_by(self, observation):
        """As in `Task`."""
        self.sensing.observe(observation)
        self.finished = observation.stamp_ns >= 8_000_000_000


class Hall:
    """World: a hall with a row of pillars; the options are their number."""

    def __init__(self, options):
        self._pillars = int(options or 2)

    def world(self):
        """As in `turtlebag.sim.world.WorldMaker`."""
        walls = ((2, -1.6, 6.2, 0.2), (2, 1.6, 6.2, 0.2), (-1.1, 0, 0.2, 3), (5.1, 0, 0.2, 3))
        pillars = tuple((1.0 + k, 0.3 * (-1) ** k, 0.3, 0.3) for k in range(self._pillars))
        shapes = tuple(
            box(f"box {k}", (x, y), (w, d), 0.0, (0.0, 1.0)) for k, (x, y, w, d) in enumerate(walls + pillars)
        )
        routes = {"tour": np.array([[0.0, -1.0], [3.8, -1.0], [3.8, 0.9]])}
        name = f"hall of {self._pillars}"
        return World(name, "burger", SE2.from_xyt(-0.4, 0, 0), shapes, (-1.5, 5.5, -2, 2), (), routes)
