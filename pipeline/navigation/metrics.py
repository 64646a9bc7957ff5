"""The metrics of a run: its goals, and the floor it has seen."""

from __future__ import annotations

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.runlog import RunLog
from turtlebag.datasets.types import Trajectory
from turtlebag.planners.tasks.patrol import GoalOutcome, GoalSequence
from turtlebag.reports.metrics.navigation import Floor, Goal, RunMetrics, run_metrics
from turtlebag.sim.robots import RobotSpec
from turtlebag.sim.simulator import Simulator


def measured(
    task: str,
    log: RunLog,
    sequence: GoalSequence | None,
    truth: Trajectory,
    estimate: Trajectory | None,
    simulator: Simulator,
    grid: OccupancyGrid | None,
) -> RunMetrics:
    """The metrics of a run that has just ended; `estimate` is None without a map, `grid` the map it made."""
    goals = [goal_of(outcome) for outcome in sequence.outcomes] if sequence is not None else []
    floor, robot = None, simulator.robot
    if task in ("avoid", "explore"):
        world, height = simulator.world, robot.lidar_height
        true_grid = world.rasterize(height) if grid is None else world.rasterize(height, grid.resolution)
        floor = floor_of(robot, true_grid, grid)
    return run_metrics(task, log, goals, truth, estimate or None, floor)


def goal_of(outcome: GoalOutcome) -> Goal:
    """What became of a goal, for the metrics."""
    status, reason = outcome.status, outcome.reason
    return Goal(outcome.waypoint.written, status, reason, outcome.started_ns, outcome.ended_ns)


def floor_of(robot: RobotSpec, true_grid: OccupancyGrid, grid: OccupancyGrid | None) -> Floor:
    """The floor that a robot could see, and the map that it made of it, if it made one."""
    reach, radius = robot.lidar.range_max, robot.model.circumscribed_radius
    return Floor(true_grid, grid, robot.T_base_lidar, reach, radius)
