"""What a run did: its goals, localisation error, clearance and collisions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NotRequired, TypedDict

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.runlog import OWNER, RunLog
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Stamps, Trajectory, yaw_difference
from turtlebag.reports.metrics.map import AreaMetrics, MapMetrics, map_metrics
from turtlebag.reports.metrics.trajectory import Extremes, associate, ate, summary

MOST_SPEED = 10.0
"""Nothing on wheels here is faster [m/s]."""
GAP_NS = 500_000_000
"""A robot that is free of a thing for half a second and touches it again has collided twice."""
THERE_M = 0.25
"""A robot that is farther than this from where it believes to be is not there."""


@dataclass(frozen=True)
class Goal:
    """A goal as it was asked for - x, y [m], yaw [rad] - and what became of it while it was pursued."""

    pose: tuple[float, float, float]
    status: str
    reason: str
    started_ns: int
    ended_ns: int


@dataclass(frozen=True, eq=False)
class Floor:
    """What a run without a map is measured against: the true map, the one it made, and what its lidar sees.

    `reach` of the lidar and `radius` of the robot in metres.
    """

    true_grid: OccupancyGrid
    grid: OccupancyGrid | None
    T_base_lidar: SE2
    reach: float
    radius: float


class GoalMetrics(TypedDict):
    """One goal of a metrics.json; errors are None where the robot never set out to it."""

    x: float
    y: float
    yaw: float
    status: str
    time_s: float
    error_m: float | None
    error_rad: float | None
    reason: NotRequired[str]


class Collisions(TypedDict):
    """Contact episodes with things that cross the lidar plane (`visible`) and lower ones (`low`)."""

    visible: int
    low: int


class Overrides(TypedDict):
    """Teleop overrides: their number and total duration."""

    count: int
    time_s: float


class GoalErrors(TypedDict):
    """Distances from the goals that the robot took to be reached [m]."""

    mean: float
    max: float


class RunMetrics(TypedDict):
    """The metrics.json of a run."""

    task: str
    success: bool
    true_success: bool
    goals: list[GoalMetrics]
    goal_error_m: GoalErrors | None
    collisions: Collisions
    min_clearance_m: float | None
    overrides: Overrides
    distance_m: float
    time_s: float
    localisation_error_m: Extremes | None
    area: NotRequired[AreaMetrics]
    map: NotRequired[MapMetrics]


def run_metrics(
    task: str,
    log: RunLog,
    goals: Sequence[Goal],
    truth: Trajectory,
    estimate: Trajectory | None,
    floor: Floor | None = None,
) -> RunMetrics:
    """The contract's keys, and whether the robot truly was where it took itself to be at each goal.

    `truth` is at the scans. `estimate` is None for a run without a map, `floor` for one with it.
    """
    touched = collision_episodes(log.t_ns, log.contact_visible | log.contact_low)
    ended = [_goal_metrics(goal, log, touched) for goal in goals]
    believed = [goal for goal in ended if goal["status"] == "reached"]
    misses = [goal["error_m"] for goal in believed if goal["error_m"] is not None]
    success = not touched and len(believed) == len(ended)
    if task == "explore" and floor is not None and floor.grid is None:
        success = False  # the map is what it was sent for
    found: RunMetrics = {
        "task": task,
        "success": success,
        "true_success": success and all(truly_reached(goal) for goal in ended),
        "goals": ended,
        "goal_error_m": {"mean": float(np.mean(misses)), "max": max(misses)} if misses else None,
        "collisions": {
            "visible": len(collision_episodes(log.t_ns, log.contact_visible)),
            "low": len(collision_episodes(log.t_ns, log.contact_low)),
        },
        "min_clearance_m": min_clearance(log.clearance_m),
        "overrides": overrides(log.t_ns, log.owner),
        "distance_m": distance_driven(Trajectory(log.t_ns, log.T_world_base)),
        "time_s": round(float(log.t_ns[-1] - log.t_ns[0]) * 1e-9, 6),
        "localisation_error_m": ate(estimate, truth, align=False) if estimate else None,
    }
    if floor is not None:
        from turtlebag.reports.metrics.seen_area import area_metrics  # a kernel: numba is slow to import

        found["area"] = area_metrics(
            floor.true_grid, truth.poses, floor.T_base_lidar, floor.reach, floor.radius
        )
        if floor.grid is not None:
            found["map"] = map_metrics(floor.grid, floor.true_grid)
    return found


def _goal_metrics(goal: Goal, log: RunLog, touched: Sequence[tuple[int, int]]) -> GoalMetrics:
    x, y, yaw = goal.pose
    status, reason = goal.status, goal.reason
    collided = any(goal.started_ns <= first <= goal.ended_ns for first, _ in touched)
    if collided and status in ("timeout", "unreachable"):
        status, reason = "collided", f"collided, then: {reason}"
    error_m = error_rad = None
    if status != "rejected":
        row = min(int(np.searchsorted(log.t_ns, goal.ended_ns)), len(log) - 1)
        error_m, error_rad = pose_error(log.T_world_base[row], SE2.from_xyt(x, y, yaw))
    found: GoalMetrics = {
        "x": x,
        "y": y,
        "yaw": yaw,
        "status": status,
        "time_s": round((goal.ended_ns - goal.started_ns) * 1e-9, 6),
        "error_m": error_m,
        "error_rad": error_rad,
    }
    if reason:
        found["reason"] = reason
    return found


def outcome(goal: Mapping[str, Any]) -> str:
    """A goal's status by the truth: `elsewhere` where the robot took it to be reached and was not there.

    Where no truth is known, the robot's own word.
    """
    error_m = goal.get("error_m")
    if goal.get("status") == "reached" and error_m is not None and error_m > THERE_M:
        return "elsewhere"
    return str(goal.get("status"))


def truly_reached(goal: Mapping[str, Any]) -> bool:
    """Whether the robot was at a goal that it took to be reached."""
    return outcome(goal) == "reached"


def placed_goals(goals: Sequence[Mapping[str, Any]]) -> list[tuple[int, float, float, Mapping[str, Any]]]:
    """Number from 1 on, x and y [m] of each goal that lies somewhere, and the goal: one that was rejected may
    have no place.
    """
    return [
        (number, goal["x"], goal["y"], goal)
        for number, goal in enumerate(goals, start=1)
        if all(isinstance(goal.get(name), (int, float)) for name in ("x", "y"))
    ]


def goal_counts(goals: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """`goals_truly_reached` and, by the robot's own word, `goals_reached`."""
    return {
        "goals_truly_reached": sum(truly_reached(goal) for goal in goals),
        "goals_reached": sum(goal.get("status") == "reached" for goal in goals),
    }


class LocalisationErrors(TypedDict):
    """What a truth adds to the metrics of `localise`."""

    localisation_error_m: Extremes
    localisation_error_rad: Extremes
    last_error_m: float
    true_success: bool


def localisation_errors(estimate: Trajectory, truth: Trajectory, success: bool) -> LocalisationErrors:
    """Errors of the estimate at its own stamps, unaligned; `success` is what the filter said at the end."""
    pairs = associate(estimate, truth)
    last_m = float(pairs.position_errors()[-1])
    return {
        "localisation_error_m": summary(pairs.position_errors()),
        "localisation_error_rad": summary(pairs.yaw_errors()),
        "last_error_m": last_m,
        "true_success": success and last_m <= THERE_M,
    }


def pose_error(T_map_base: SE2, T_world_goal: SE2) -> tuple[float, float]:
    """Distance [m] and absolute yaw difference [rad] of one pose from another."""
    distance = float(np.linalg.norm(T_map_base.xy - T_world_goal.xy))
    return distance, float(yaw_difference(T_map_base.yaw, T_world_goal.yaw))


def collision_episodes(stamps_ns: Stamps, contact: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last stamp of each contact episode [ns]; contacts less than `GAP_NS` apart are one."""
    touching = stamps_ns[contact]
    if len(touching) == 0:
        return []
    breaks = np.flatnonzero(np.diff(touching) > GAP_NS)
    firsts = touching[np.concatenate([[0], breaks + 1])]
    lasts = touching[np.concatenate([breaks, [len(touching) - 1]])]
    return [(int(first), int(last)) for first, last in zip(firsts, lasts, strict=True)]


def overrides(stamps_ns: Stamps, owner: Sequence[str]) -> Overrides:
    """The times that someone had the robot in place of navigation."""
    taken = np.array([name != OWNER for name in owner], dtype=bool)
    begins = taken & ~np.concatenate([[False], taken[:-1]])
    periods = np.append(np.diff(stamps_ns), 0)
    return {"count": int(begins.sum()), "time_s": round(float(periods[taken].sum()) * 1e-9, 6)}


def min_clearance(clearance_m: Array) -> float | None:
    """Least finite footprint clearance of a run [m]; None when there was nothing to be near."""
    finite = clearance_m[np.isfinite(clearance_m)]
    return float(finite.min()) if len(finite) else None


def distance_driven(trajectory: Trajectory) -> float:
    """Length of the path [m], without the steps that no wheel takes: those of a robot that was carried."""
    steps = np.linalg.norm(np.diff(trajectory.poses.xy, axis=0), axis=1)
    seconds = np.diff(trajectory.stamps_ns) * 1e-9
    return float(steps[steps <= MOST_SPEED * seconds].sum())
