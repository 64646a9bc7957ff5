"""Every number of a stage computed again from its bag and files, by the functions the stage calls."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from turtlebag.datasets.bags.reader import bag_info, read_poses
from turtlebag.datasets.errors import InputError, if_there
from turtlebag.datasets.relations import load_relations
from turtlebag.datasets.runlog import RunLog
from turtlebag.datasets.se2 import SE2, wrap
from turtlebag.datasets.types import Trajectory, yaw_difference
from turtlebag.pipeline.navigation.metrics import floor_of
from turtlebag.pipeline.stages.map_summary import loop_counts
from turtlebag.planners.tasks.waypoints import load_waypoints, tutorial_patrol
from turtlebag.reports.g2o import read_g2o, read_loops
from turtlebag.reports.metrics.navigation import Floor, Goal, goal_counts, localisation_errors, run_metrics
from turtlebag.reports.metrics.references import References
from turtlebag.reports.metrics.trajectory import associate, recording_metrics
from turtlebag.reports.numbers import leaves
from turtlebag.reports.provenance import rename
from turtlebag.reports.stages import Group, Stage
from turtlebag.sim.robots import RobotSpec, load_robot

# Files hold poses with 9 decimals and run logs with 6; metrics were made from unrounded ones.
ABSOLUTE, RELATIVE = 2e-6, 1e-6
# Truth at a scan is kept exactly; the bag's 30 Hz truth has to be interpolated to it.
TRUTH_AGREES_M = 0.003
Pose = tuple[float, float, float]


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


def checks(name: str, reported: Mapping[str, Any], found: Mapping[str, Any]) -> Iterator[Check]:
    """What was computed again of a stage beside what was reported; words are not compared."""
    told = dict(leaves(reported))
    for path, value in leaves(found):
        if path in told and not isinstance(value, str):
            yield Check(f"{name}:{path}", told[path], value)


def recomputed(stage: Stage, group: Group, places: Mapping[str, str]) -> Mapping[str, object]:
    """What can be said of a stage from its data files alone, keyed as in its metrics.

    `places` are where the outputs named in the recorded commands lie now.
    """
    if stage.kind == "record":
        return _record(stage)
    if stage.kind == "map":
        return _map(stage, group)
    if stage.kind == "localise":
        return _localise(stage, group)
    return _run(stage, places) if stage.kind == "navigate" else {}


def _record(stage: Stage) -> Mapping[str, object]:
    if stage.truth is None:
        return {}
    topics = bag_info(stage.folder / "bag").topics
    scans = sum(topic.count for topic in topics if topic.name == "/scan")
    return {**recording_metrics(stage.driven, stage.odometry, stage.truth), "scans": scans}


def _map(stage: Stage, group: Group) -> Mapping[str, object]:
    if stage.trajectory is None:
        return {}
    found: dict[str, object] = {"scans": len(stage.trajectory), "log_s": stage.trajectory.duration()}
    if stage.has("graph.g2o"):
        found["keyframes"] = len(read_g2o(stage.folder / "graph.g2o").T_map_keys)
    if stage.has("graph.json"):
        found["loops"] = loop_counts(read_loops(stage.folder / "graph.json").accepted)
    record = group.record_of(stage) if "ate_m" in stage.metrics else None
    path = stage.input_paths().get("relations")
    relations = load_relations(path) if path is not None and path.is_file() else None
    truth, true_grid = (None, None) if record is None else (record.truth, record.true_map)
    return {**found, **References(truth, true_grid, relations).errors(stage.trajectory, stage.map)}


def _localise(stage: Stage, group: Group) -> Mapping[str, object]:
    if stage.trajectory is None:
        return {}
    record, scans = group.record_of(stage), len(stage.trajectory)
    if "localisation_error_m" not in stage.metrics or record is None or record.truth is None:
        return {"scans": scans}
    believed = bool(stage.metrics.get("success"))
    return {"scans": scans, **localisation_errors(stage.trajectory, record.truth, believed)}


def _run(stage: Stage, places: Mapping[str, str]) -> Mapping[str, object]:
    log = stage.runlog
    if log is None or len(log) == 0:
        return {}
    truth = stage.truth or Trajectory(np.zeros(0, dtype=np.int64), SE2.identity(0))  # it ended before a scan
    # The bag holds every digit of the truth, the run log six decimals.
    log = replace(log, T_world_base=stage.driven.at(log.t_ns))
    goals = _Goals(stage, log, places)
    estimate = stage.trajectory if stage.metrics.get("localisation_error_m") else None
    ends = [goals.end(number) for number in range(len(goals.reported))]
    task = stage.fact("task") or ""
    found = run_metrics(task, log, ends, truth, estimate, _floor(stage))
    known = [
        {key: value for key, value in goal.items() if key in goals.known(number)}
        for number, goal in enumerate(found["goals"])
    ]
    return {**found, **goal_counts(found["goals"]), "goals": known}


def robot_of(stage: Stage) -> RobotSpec | None:
    """The robot of a stage; None where it is not known here."""
    return if_there(load_robot, stage.option("robot") or stage.fact("robot") or "")


def _floor(stage: Stage) -> Floor | None:
    robot = robot_of(stage) if "area" in stage.metrics else None
    return None if robot is None or stage.true_map is None else floor_of(robot, stage.true_map, stage.map)


class _Goals:
    """The goals of a run, by its bag, its run log and what it was asked for.

    How a goal ended is the run's own word, but reached is one only where the log says so too.
    """

    def __init__(self, stage: Stage, log: RunLog, places: Mapping[str, str]) -> None:
        self.reported: Sequence[Mapping[str, Any]] = stage.metrics.get("goals") or []
        self._log, self._asked = log, _asked(stage, places)
        sent = if_there(read_poses, stage.folder / "bag", "/goal_pose")
        self._sent = SE2.identity(0) if sent is None else sent.poses
        states = zip(log.goal_index.tolist(), log.state, strict=True)
        self._reached = {number for number, state in states if state == "reached"}
        self._pursued = set(log.goal_index.tolist())

    def end(self, number: int) -> Goal:
        """A goal as it was asked for, and its time by the run log."""
        goal, log = self.reported[number], self._log
        status = "reached" if number in self._reached else str(goal.get("status")).replace("reached", "")
        rows = np.flatnonzero(log.goal_index == number)
        if not len(rows) or goal.get("error_m") is None:
            return Goal(self._pose(number), status, "", 0, 0)
        # A goal that timed out is replaced within the tick that closes it.
        last = int(rows[-1]) if status == "reached" else min(int(rows[-1]) + 1, len(log) - 1)
        return Goal(self._pose(number), status, "", int(log.t_ns[rows[0]]), int(log.t_ns[last]))

    def known(self, number: int) -> list[str]:
        """What of a goal does not rest on its own report."""
        pose = ["x", "y", "yaw"]
        if number not in self._pursued:
            return [*pose, "time_s"] if self._asked else []
        if self.reported[number].get("error_m") is None:
            return []
        return [*(pose if len(self._sent) else []), "time_s", "error_m", "error_rad"]

    def _pose(self, number: int) -> Pose:
        """By the bag or the command line; else as reported."""
        goal = self.reported[number]
        x, y, yaw = (goal.get(key, math.nan) for key in ("x", "y", "yaw"))
        if number not in self._pursued and self._asked:
            return self._asked[number % len(self._asked)]
        if number not in self._pursued or not len(self._sent):
            return x, y, yaw
        wanted = SE2.from_xyt(x, y, yaw)
        distances = np.linalg.norm(self._sent.xy - wanted.xy, axis=1)
        nearest = self._sent[int(np.argmin(distances + yaw_difference(self._sent.yaw, wanted.yaw)))]
        # A yaw may be written beyond half a turn.
        return float(nearest.x), float(nearest.y), yaw + float(wrap(nearest.yaw - yaw))


def _asked(stage: Stage, places: Mapping[str, str]) -> Sequence[Pose]:
    """The goals of the command line or its waypoints file: no bag holds one that was never pursued."""
    try:
        if (goal := stage.option("goal")) is not None:
            x, y, yaw = (float(part) for part in goal.split(","))
            return [(x, y, yaw)]
        if stage.fact("task") != "patrol":
            return []
        file = stage.option("waypoints")
        found = tutorial_patrol() if file is None else load_waypoints(Path(rename(file, places)))
    except (InputError, ValueError):
        return []
    return [waypoint.written for waypoint in found.waypoints]


def truth_disagreement(stage: Stage) -> float | None:
    """Largest distance between truth/trajectory.tum and the bag's /ground_truth/odom [m]."""
    if stage.truth is None or not stage.has("bag"):
        return None
    return float(associate(stage.truth, stage.driven).position_errors().max())
