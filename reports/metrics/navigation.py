"""What a run did: localisation error, clearance and collisions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.runlog import OWNER
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Stamps, Trajectory, yaw_difference
from turtlebag.reports.metrics.trajectory import associate, summary

MOST_SPEED = 10.0
"""Nothing on wheels here is faster [m/s]."""
THERE_M = 0.25
"""A robot that is farther than this from where it believes to be is not there."""


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


def localisation_error(estimate: Trajectory, truth: Trajectory) -> dict[str, float]:
    """Distance of the estimate from the truth at its own stamps, unaligned: {rmse, max} [m]."""
    return summary(associate(estimate, truth).position_errors())


def pose_error(T_map_base: SE2, T_world_goal: SE2) -> tuple[float, float]:
    """Distance [m] and absolute yaw difference [rad] of one pose from another."""
    distance = float(np.linalg.norm(T_map_base.xy - T_world_goal.xy))
    return distance, float(yaw_difference(T_map_base.yaw, T_world_goal.yaw))


def collision_episodes(
    stamps_ns: Stamps, contact: NDArray[np.bool_], *, gap_s: float = 0.5
) -> list[tuple[int, int]]:
    """First and last stamp of each contact episode [ns]; contacts less than `gap_s` apart are one."""
    touching = stamps_ns[contact]
    if len(touching) == 0:
        return []
    breaks = np.flatnonzero(np.diff(touching) > gap_s * 1e9)
    firsts = touching[np.concatenate([[0], breaks + 1])]
    lasts = touching[np.concatenate([breaks, [len(touching) - 1]])]
    return [(int(first), int(last)) for first, last in zip(firsts, lasts, strict=True)]


def collisions(
    stamps_ns: Stamps, visible: NDArray[np.bool_], low: NDArray[np.bool_], *, gap_s: float = 0.5
) -> dict[str, int]:
    """Contact episodes with things that cross the lidar plane (`visible`) and lower ones (`low`)."""
    return {
        "visible": len(collision_episodes(stamps_ns, visible, gap_s=gap_s)),
        "low": len(collision_episodes(stamps_ns, low, gap_s=gap_s)),
    }


def takeovers(stamps_ns: Stamps, owner: Sequence[str]) -> dict[str, float]:
    """`count` of the times that someone took over from navigation, and the `time_s` it had the robot then."""
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
