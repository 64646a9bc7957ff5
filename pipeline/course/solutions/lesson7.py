"""Lesson 7 solved: A* that keeps its distance, and a controller that turns to a point ahead on the path."""

from __future__ import annotations

import heapq
import itertools
import math

import numpy as np

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import RobotModel, Twist
from turtlebag.planners.control.controller import Ramped
from turtlebag.planners.costmap import Costmap
from turtlebag.planners.planner import NoPath, Plan, PlanConfig
from turtlebag.planners.smoothing import path_length, with_headings

MARGIN_M, PUSH, PUSH_M = 0.04, 3.0, 0.1
NEIGHBOURS = [step for step in itertools.product((-1, 0, 1), repeat=2) if step != (0, 0)]


class GlobalPlanner:
    """A* over the cells, dearer near obstacles."""

    def __init__(self, config: PlanConfig) -> None:
        pass

    def plan(self, costmap: Costmap, model: RobotModel, T_map_start: SE2, T_map_goal: SE2, seed: int) -> Plan:
        """The cheapest path; NoPath if there is none."""
        start, goal = costmap.T_grid_map @ T_map_start, costmap.T_grid_map @ T_map_goal
        room = costmap.clearance - model.circumscribed_radius
        cost = np.where(room > MARGIN_M, 1.0 + PUSH * np.exp(-room / PUSH_M), np.inf)
        first, last = (
            tuple(np.floor(T.xy[::-1] / costmap.resolution).astype(int).tolist()) for T in (start, goal)
        )
        cost[first] = 1.0  # it may stand too near something
        cells = np.array(self.search(cost, first, last))[1:-1, ::-1]
        points = np.vstack([start.xy, (cells + 0.5) * costmap.resolution, goal.xy])
        poses = with_headings(points, float(start.yaw), float(goal.yaw))
        return Plan(costmap.T_map_grid @ poses, path_length(points), MARGIN_M, "lesson 7")

    def search(self, cost: Array, first: tuple[int, int], last: tuple[int, int]) -> list[tuple[int, int]]:
        """The cells from first to last."""
        queue, came, spent = [(0.0, first)], {first: first}, {first: 0.0}
        closed = set()
        while queue:
            cell = heapq.heappop(queue)[1]
            if cell == last:
                path = [cell]
                while cell != first:
                    path.append(cell := came[cell])
                return path[::-1]
            if cell in closed:
                continue
            closed.add(cell)
            for step in NEIGHBOURS:
                to = (cell[0] + step[0], cell[1] + step[1])
                if not (0 <= to[0] < cost.shape[0] and 0 <= to[1] < cost.shape[1]):
                    continue
                total = spent[cell] + math.hypot(*step) * float(cost[to])
                if total < spent.get(to, math.inf):
                    came[to], spent[to] = cell, total
                    heapq.heappush(queue, (total + math.dist(to, last), to))
        raise NoPath("no path leads there")


class Controller(Ramped):
    """Pure pursuit, and a turn at the goal."""

    def __init__(self, model: RobotModel, period: float) -> None:
        super().__init__(model, period, max_v=0.2, max_w=1.2)
        self.state, self.nearest, self.arrived = "idle", 0, False
        self.path: SE2 | None = None

    def set_path(self, poses: SE2) -> None:
        """Follow a new path."""
        self.path, self.nearest, self.arrived = poses, 0, False

    def command(self, pose: SE2, last: Twist, costmap: Costmap) -> Twist:
        """Steer for the point 0.2 m ahead, turn on the spot to a large bearing, align at the end."""
        if self.path is None:
            return self.ramp(Twist(), last)
        away = np.linalg.norm(self.path.xy[self.nearest : self.nearest + 10] - pose.xy, axis=1)
        self.nearest += int(away.argmin())
        ahead = self.path[min(self.nearest + 4, len(self.path) - 1)]
        x, y, yaw = (pose.inverse() @ self.path[-1]).xyt.tolist()
        self.arrived = math.hypot(x, y) < (0.06 if self.arrived else 0.02)
        if self.arrived:
            self.state = "align"
            return self.ramp(Twist(0.0, 1.5 * yaw), last)
        forward, left = (pose.inverse() @ ahead.xy).tolist()
        bearing, self.state = math.atan2(left, forward), "follow"
        if abs(bearing) > 0.8:
            return self.ramp(Twist(0.0, 1.2 * np.sign(bearing)), last)
        v = min(0.2, max(0.03, math.hypot(x, y)))
        return self.ramp(Twist(v * math.cos(bearing) ** 2, 2.0 * bearing), last)
