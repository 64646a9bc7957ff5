"""What a run is measured by: the goals it was given, and the floor it went over."""

from __future__ import annotations

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.planners.tasks.sequence import GoalOutcome
from turtlebag.reports.metrics.navigation import Floor, Goal
from turtlebag.sim.robots import RobotSpec


def goal_of(outcome: GoalOutcome) -> Goal:
    """What became of a goal, for the metrics."""
    status, reason = outcome.status, outcome.reason
    return Goal(outcome.waypoint.written, status, reason, outcome.started_ns, outcome.ended_ns)


def floor_of(robot: RobotSpec, true_grid: OccupancyGrid, grid: OccupancyGrid | None) -> Floor:
    """The floor that a robot could see, and the map that it made of it, if it made one."""
    reach, radius = robot.lidar.range_max, robot.model.circumscribed_radius
    return Floor(true_grid, grid, robot.T_base_lidar, reach, radius)
