"""metrics.json of a run: what became of each goal, measured against the truth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from turtlebag.datasets.runlog import RunLog
from turtlebag.datasets.types import Trajectory
from turtlebag.planners.tasks.sequence import GoalOutcome
from turtlebag.reports.metrics.navigation import (
    collision_episodes,
    collisions,
    distance_driven,
    localisation_error,
    min_clearance,
    pose_error,
    takeovers,
    truly_reached,
)


def run_metrics(
    task: str,
    log: RunLog,
    outcomes: Sequence[GoalOutcome],
    truth: Trajectory,
    estimate: Trajectory | None,
) -> dict[str, Any]:
    """The contract's keys, and whether the robot truly was where it took itself to be at each goal.

    `estimate` is None for a run without a map.
    """
    contact = log.contact_visible | log.contact_low
    touched = collision_episodes(log.t_ns, contact)
    counts = collisions(log.t_ns, log.contact_visible, log.contact_low)
    goals = [_goal(outcome, log, touched) for outcome in outcomes]
    reached = all(goal["status"] == "reached" for goal in goals)
    misses = [goal["error_m"] for goal in goals if goal["status"] == "reached"]
    success = reached and not touched
    known = estimate is not None and len(estimate) > 0
    return {
        "task": task,
        "success": success,
        "true_success": success and all(truly_reached(goal) for goal in goals),
        "goals": goals,
        "goal_error_m": {"mean": float(np.mean(misses)), "max": max(misses)} if misses else None,
        "collisions": counts,
        "min_clearance_m": min_clearance(log.clearance_m),
        "takeovers": takeovers(log.t_ns, log.owner),
        "distance_m": distance_driven(Trajectory(log.t_ns, log.T_world_base)),
        "time_s": round(float(log.t_ns[-1] - log.t_ns[0]) * 1e-9, 6),
        "localisation_error_m": localisation_error(estimate, truth) if known and estimate else None,
    }


def _goal(outcome: GoalOutcome, log: RunLog, touched: list[tuple[int, int]]) -> dict[str, Any]:
    x, y, yaw = outcome.waypoint.written
    status, reason = outcome.status, outcome.reason
    collided = any(outcome.started_ns <= first <= outcome.ended_ns for first, _ in touched)
    if collided and status in ("timeout", "unreachable"):
        status, reason = "collided", f"collided, then: {reason}"
    goal: dict[str, Any] = {"x": x, "y": y, "yaw": yaw, "status": status, "time_s": round(outcome.time_s, 6)}
    goal["error_m"] = goal["error_rad"] = None
    if outcome.waypoint.T_map_goal is not None and status != "rejected":
        row = min(int(np.searchsorted(log.t_ns, outcome.ended_ns)), len(log) - 1)
        T_world_base = log.T_world_base[row]
        goal["error_m"], goal["error_rad"] = pose_error(T_world_base, outcome.waypoint.T_map_goal)
    if reason:
        goal["reason"] = reason
    return goal
