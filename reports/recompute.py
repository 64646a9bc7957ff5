"""Every number of a stage computed again from its bag and files, not from its metrics.json."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from turtlebag.datasets.bags.reader import bag_info, read_poses
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.relations import load_relations
from turtlebag.datasets.runlog import RunLog
from turtlebag.datasets.se2 import SE2, wrap
from turtlebag.datasets.types import Trajectory, yaw_difference
from turtlebag.reports.g2o import read_g2o, read_loops
from turtlebag.reports.metrics.map import map_metrics
from turtlebag.reports.metrics.navigation import (
    collisions,
    distance_driven,
    localisation_error,
    min_clearance,
    pose_error,
    takeovers,
    truly_reached,
)
from turtlebag.reports.metrics.recording import recording_metrics
from turtlebag.reports.metrics.relations import relations_metrics
from turtlebag.reports.metrics.trajectory import associate, summary, trajectory_metrics
from turtlebag.reports.numbers import leaves
from turtlebag.reports.stages import Group, Stage

# Files hold poses with 9 decimals and run logs with 6; metrics were made from unrounded ones.
ABSOLUTE, RELATIVE = 2e-6, 1e-6
# Truth at a scan is kept exactly; the bag's 30 Hz truth has to be interpolated to it.
TRUTH_AGREES_M = 0.003


@dataclass(frozen=True)
class Check:
    """One number: as reported and as computed again."""

    key: str
    reported: Any
    found: Any

    @property
    def agrees(self) -> bool:
        """Equal, up to the rounding of files."""
        return same(self.reported, self.found)


def same(a: Any, b: Any) -> bool:
    """Numbers equal up to rounding, anything else equal."""
    numbers = (int, float)
    if isinstance(a, numbers) and isinstance(b, numbers) and not isinstance(a, bool):
        return math.isclose(a, b, rel_tol=RELATIVE, abs_tol=ABSOLUTE)
    return bool(a == b)


def checks(stage: Stage, group: Group, reported: Mapping[str, Any]) -> Iterator[Check]:
    """Compare everything that can be computed again with what was reported."""
    prefix = f"{group.name}/{stage.label}:"
    told = dict(leaves(reported))
    for path, found in leaves(recomputed(stage, group)):
        if path in told:
            yield Check(prefix + path, told[path], found)


def recomputed(stage: Stage, group: Group) -> dict[str, Any]:
    """What can be said of a stage from its data files alone, keyed as in its metrics."""
    if stage.kind == "record":
        return _record(stage)
    if stage.kind == "map":
        return _map(stage, group)
    if stage.kind == "localise":
        return _localise(stage, group)
    return _run(stage) if stage.kind == "navigate" else {}


def _localise(stage: Stage, group: Group) -> dict[str, Any]:
    record = group.record_of(stage)
    if stage.trajectory is None:
        return {}
    found: dict[str, Any] = {"scans": len(stage.trajectory)}
    if "localisation_error_m" in stage.metrics and record is not None and record.truth is not None:
        pairs = associate(stage.trajectory, record.truth)
        found["localisation_error_m"] = summary(pairs.position_errors())
        found["localisation_error_rad"] = summary(pairs.yaw_errors())
        found["last_error_m"] = float(pairs.position_errors()[-1])
    return found


def _record(stage: Stage) -> dict[str, Any]:
    if stage.truth is None:
        return {}
    found = recording_metrics(stage.folder / "bag", stage.truth)
    found["scans"] = count_scans(stage)
    return found


def count_scans(stage: Stage) -> int:
    """Messages on /scan in the stage's bag."""
    return sum(topic.count for topic in bag_info(stage.folder / "bag").topics if topic.name == "/scan")


def _map(stage: Stage, group: Group) -> dict[str, Any]:
    found: dict[str, Any] = {}
    if stage.trajectory is None:
        return found
    found["scans"] = len(stage.trajectory)
    found["log_s"] = stage.trajectory.duration()
    if stage.has("graph.g2o"):
        found["keyframes"] = len(read_g2o(stage.folder / "graph.g2o").T_map_keys)
    if stage.has("graph.json"):
        loops = read_loops(stage.folder / "graph.json")
        accepted = int(loops.accepted.sum())
        counts = {"proposed": len(loops.i), "accepted": accepted, "rejected": len(loops.i) - accepted}
        found["loops"] = counts
    record = group.record_of(stage)
    if "ate_m" in stage.metrics and record is not None and record.truth is not None:
        found |= trajectory_metrics(stage.trajectory, record.truth)
        if stage.map is not None and record.true_map is not None:
            found["map"] = map_metrics(stage.map, record.true_map)
    relations = stage.input_paths().get("relations")
    if relations is not None and relations.is_file():
        found |= relations_metrics(stage.trajectory, load_relations(relations))
    return found


def _run(stage: Stage) -> dict[str, Any]:
    log = stage.runlog
    if log is None or len(log) == 0:
        return {}
    truth = read_poses(stage.folder / "bag", "/ground_truth/odom")
    found: dict[str, Any] = {
        "time_s": float(truth.stamps_ns[-1] - truth.stamps_ns[0]) * 1e-9,
        "distance_m": distance_driven(truth),
        "collisions": collisions(log.t_ns, log.contact_visible, log.contact_low),
        "min_clearance_m": min_clearance(log.clearance_m),
        "takeovers": takeovers(log.t_ns, log.owner),
    }
    if "map" in stage.metrics and stage.map is not None and stage.true_map is not None:
        found["map"] = map_metrics(stage.map, stage.true_map)
    if stage.metrics.get("localisation_error_m") and stage.trajectory is not None and stage.truth is not None:
        found["localisation_error_m"] = localisation_error(stage.trajectory, stage.truth)
    goals = stage.metrics.get("goals") or []
    if goals:
        found |= _goals(stage, goals, log, truth)
    done = found.get("goals_reached", 0) == len(goals) and not any(found["collisions"].values())
    # What an exploration is sent for is the map.
    found["success"] = done and (stage.metrics.get("task") != "explore" or stage.map is not None)
    found["true_success"] = found["success"] and found.get("goals_truly_reached", 0) == len(goals)
    return found


def _goals(stage: Stage, goals: list[dict[str, Any]], log: RunLog, truth: Trajectory) -> dict[str, Any]:
    sent = _goal_poses(stage)
    again = [_goal(number, goal, log, truth) | _sent(goal, sent) for number, goal in enumerate(goals)]
    reached = {int(i) for i, state in zip(log.goal_index, log.state, strict=True) if state == "reached"}
    found: dict[str, Any] = {
        "goals": again,
        "goals_reached": len(reached - {-1}),
        "goals_truly_reached": sum(truly_reached(a | b) for a, b in zip(goals, again, strict=True)),
    }
    misses = [
        mine["error_m"]
        for goal, mine in zip(goals, again, strict=True)
        if goal["status"] == "reached" and "error_m" in mine
    ]
    if misses:
        found["goal_error_m"] = {"mean": float(np.mean(misses)), "max": max(misses)}
    return found


def _goal_poses(stage: Stage) -> SE2:
    """Goals published on /goal_pose, (n,)."""
    try:
        return read_poses(stage.folder / "bag", "/goal_pose").poses
    except InputError:
        return SE2.identity(0)


def _sent(goal: Mapping[str, Any], sent: SE2) -> dict[str, Any]:
    """The published goal nearest to the reported one; nothing for a goal that was never pursued."""
    if len(sent.xyt) == 0 or goal.get("error_m") is None:
        return {}
    wanted = SE2.from_xyt(goal["x"], goal["y"], goal["yaw"])
    distances = np.linalg.norm(sent.xy - wanted.xy, axis=1) + yaw_difference(sent.yaw, wanted.yaw)
    x, y, yaw = sent[int(np.argmin(distances))].xyt.tolist()
    # A yaw may be written beyond half a turn.
    return {"x": x, "y": y, "yaw": goal["yaw"] + float(wrap(yaw - goal["yaw"]))}


def _goal(number: int, goal: Mapping[str, Any], log: RunLog, truth: Trajectory) -> dict[str, Any]:
    """Duration and true error of one goal, from when the run log says it was pursued."""
    rows = np.flatnonzero(log.goal_index == number)
    if len(rows) == 0 or goal.get("error_m") is None:
        return {}
    last = int(rows[-1])
    if goal.get("status") != "reached":
        # A goal that timed out is replaced within the tick that closes it.
        last = min(last + 1, len(log) - 1)
    T_world_base = truth.at(log.t_ns[last : last + 1])[0]
    error_m, error_rad = pose_error(T_world_base, SE2.from_xyt(goal["x"], goal["y"], goal["yaw"]))
    duration = float(log.t_ns[last] - log.t_ns[rows[0]]) * 1e-9
    return {"time_s": duration, "error_m": error_m, "error_rad": error_rad}


def truth_disagreement(stage: Stage) -> float | None:
    """Largest distance between truth/trajectory.tum and the bag's /ground_truth/odom [m]."""
    if stage.truth is None or not stage.has("bag"):
        return None
    bag_truth = read_poses(stage.folder / "bag", "/ground_truth/odom")
    return float(associate(stage.truth, bag_truth).position_errors().max())
