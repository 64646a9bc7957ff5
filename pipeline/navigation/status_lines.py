"""Status lines on the terminal during a run, and at its end.

If the robot believes that it has reached a goal and ground truth says otherwise, the line says `reported as
reached`: `reached` alone is the truth.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import groupby

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.plurals import counted
from turtlebag.pipeline.navigation.command_owner import CommandOwner
from turtlebag.pipeline.terminal.messages import Simulated, length
from turtlebag.planners.tasks.patrol import GoalOutcome, GoalSequence
from turtlebag.planners.tasks.sector_rule import in_words
from turtlebag.planners.tasks.waypoints import Waypoint
from turtlebag.reports.metrics.navigation import THERE_M, RunMetrics, pose_error, truly_reached
from turtlebag.sim.simulator import Truth


class News:
    """Reports the start and end of goals and overrides, one line each, as they happen.

    `tell` receives the lines, first `opening`; `clock` receives the simulated time at each tick.
    """

    def __init__(self, opening: str, tell: Callable[[str], None], clock: Simulated) -> None:
        self._opening, self._tell, self._clock = opening, tell, clock
        self._heading, self._told = -1, 0
        self._owner, self._touched = "navigation", False

    def begin(self) -> None:
        """Another task begins."""
        self._heading, self._told, self._touched = -1, 0, False

    def tick(self, stamp_ns: int, owner: CommandOwner, sequence: GoalSequence | None, truth: Truth) -> None:
        """One control period, after the command was chosen."""
        if self._opening:
            self._tell(self._opening)
            self._opening = ""
        if owner.owner != self._owner:
            self._owner = owner.owner
            does = "takes over" if owner.owner == "teleop" else "hands back"
            self._tell(f"{seconds(stamp_ns):.1f} s: teleop {does}")
        doing = in_words(owner.state)
        if sequence is not None:
            self._touched |= truth.contact_visible or truth.contact_low
            self._goals(sequence, truth)
            doing = f"goal {sequence.index + 1} of {sequence.total}: {doing}" if sequence.goal else doing
        self._clock(stamp_ns, doing)

    def _goals(self, sequence: GoalSequence, truth: Truth) -> None:
        ended = [(o.index + 1, _ended(o, truth, self._touched)) for o in sequence.outcomes[self._told :]]
        self._told += len(ended)
        for line, alike in groupby(ended, key=lambda item: item[1]):
            numbers = [number for number, _ in alike]
            which = f"goals {numbers[0]} to {numbers[-1]}" if len(numbers) > 1 else f"goal {numbers[0]}"
            self._tell(f"{which} of {sequence.total}: {line}")
        if sequence.goal is not None and sequence.index != self._heading:
            self._heading, self._touched = sequence.index, False
            place = _place(sequence.waypoint)
            self._tell(f"goal {sequence.index + 1} of {sequence.total}: heading to {place}")


def _place(waypoint: Waypoint) -> str:
    x, y, _ = waypoint.written
    return f"({x:g}, {y:g})"


def _ended(outcome: GoalOutcome, truth: Truth, touched: bool) -> str:
    status, after = outcome.status, f" after {outcome.time_s:.1f} s" if outcome.time_s > 0.0 else ""
    if status != "reached" or outcome.waypoint.T_map_goal is None:
        status = "collided" if touched and status in ("timeout", "unreachable") else status
        return f"{status}{after}: {outcome.reason}"
    error, _ = pose_error(truth.T_world_base, outcome.waypoint.T_map_goal)
    if error > THERE_M:
        return f"reported as reached{after}, but the robot is {length(error)} away from it"
    return f"reached{after}, {length(error)} off"


def verdict(metrics: RunMetrics) -> str:
    """The outcome of a run by ground truth, in one line, from its metrics."""
    return f"{'succeeded' if metrics['true_success'] else 'failed'}: {tally(metrics)}"


def tally(metrics: RunMetrics) -> str:
    """What a run came to by ground truth, without a verdict: one that was broken off has none."""
    parts = []
    if goals := metrics["goals"]:
        believed = [goal for goal in goals if goal["status"] == "reached"]
        true = sum(truly_reached(goal) for goal in goals)
        parts.append(f"{true} of {len(goals)} goals reached")
        if true < len(believed):
            parts[-1] += f" (the robot reported {len(believed)})"
    parts += [_collisions(**metrics["collisions"])]
    if "area" in metrics:
        parts.append(f"{metrics['area']['seen_m2']:.1f} m2 of floor seen")
    parts.append(f"{metrics['distance_m']:.2f} m in {metrics['time_s']:.1f} simulated seconds")
    return ", ".join(parts)


def _collisions(visible: int, low: int) -> str:
    if not visible and not low:
        return "no collisions"
    where = f"{visible} visible to the lidar, {low} below its plane"
    return f"{counted(visible + low, 'collision')} ({where})"
