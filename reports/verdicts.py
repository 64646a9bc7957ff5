"""What a report says of an output in one sentence, and whether it was good."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from turtlebag.datasets.plurals import counted
from turtlebag.reports.metrics.navigation import outcome, truly_reached
from turtlebag.reports.numbers import lookup, shown

GOOD, BAD, NEUTRAL = "good", "bad", "neutral"
GOOD_WALLS = 0.99
"""A map is good when this share of its wall cells lies within one cell of a true surface."""
Verdict = tuple[str, str]
"""Good, bad or neutral; one sentence."""
Metrics = Mapping[str, Any]


def record_verdict(metrics: Metrics, odometry_m: float | None) -> Verdict:
    """Of a recording: how long it is, and how far its odometry drifted."""
    drift = lookup(metrics, "odometry_ate_m.max")
    length, duration = metrics.get("distance_m"), metrics.get("duration_s")
    sentence = f"{metrics.get('scans', 'No')} scans over {shown(duration, 's')} and {shown(length, 'm')}"
    return NEUTRAL, f"{sentence}; the wheel odometry drifted by up to {shown(drift, 'cm')}."


def run_verdict(metrics: Metrics, odometry_m: float | None) -> Verdict:
    """Of a run, by the truth where it is known; what the robot took to be so stands beside it where it
    differs."""
    goals = metrics.get("goals") or []
    hits = collision_count(metrics)
    what = [_goals_sentence(goals)] if goals else []
    what.append("no collision" if hits == 0 else counted(hits, "collision"))
    believed = bool(metrics.get("success", hits == 0))
    good = believed and bool(metrics.get("true_success", True)) and not _elsewhere(goals)
    sentence = ("; " if _elsewhere(goals) else ", ").join(what)
    return GOOD if good else BAD, f"{sentence[0].upper()}{sentence[1:]}."


def _elsewhere(goals: Sequence[Metrics]) -> list[float]:
    """How far the robot truly was [m] from each goal that it took to be reached and was not at."""
    return [float(goal["error_m"]) for goal in goals if outcome(goal) == "elsewhere"]


def _goals_sentence(goals: Sequence[Metrics]) -> str:
    """`7 of 8 goals reached (1 timeout)`; what the robot believed and the truth denies is said too."""
    reached = sum(truly_reached(goal) for goal in goals)
    away = _elsewhere(goals)
    ends = Counter(
        f"{goal.get('status')}{f': {reason}' if (reason := goal.get('reason')) else ''}"
        for goal in goals
        if goal.get("status") != "reached"
    )
    asides = [f"{count} {end}" for end, count in ends.items()]
    if len(goals) == 1:
        if away:
            return f"goal not reached: the robot reported it as reached, but was {shown(away[0], 'm')} away"
        return "goal reached" if reached else f"goal not reached ({', '.join(asides).removeprefix('1 ')})"
    if away:
        asides.insert(
            0, f"the robot reported {reached + len(away)}, but was up to {shown(max(away), 'm')} away"
        )
    return f"{reached} of {len(goals)} goals reached" + (f" ({'; '.join(asides)})" if asides else "")


def identify_verdict(metrics: Metrics, odometry_m: float | None) -> Verdict:
    """Of a robot: how much of it shows."""
    total = len(metrics.get("parameters") or {})
    return NEUTRAL, f"{metrics.get('observable', '?')} of {total} parameters are shown by the recording."


def twin_verdict(metrics: Metrics, odometry_m: float | None) -> Verdict:
    """Of a twin: what differs from the real drive, the largest first."""
    known = metrics.get("quantities") or {}
    labels = [one["label"] for one in known.values() if one["told_apart"]]
    most = f", most of all: {', '.join(labels[:3])}" if labels else ""
    return NEUTRAL, f"Real and simulated differ in {len(labels)} of {len(known)} quantities{most}."


def map_verdict(metrics: Metrics, odometry_m: float | None) -> Verdict:
    """Of a map; `odometry_m` is the error that it had to put right."""
    scans = metrics.get("scans", "?")
    near = lookup(metrics, "map.occupied_error_m.within_one_cell")
    fitted = metrics.get("fitted")
    ate = lookup(metrics, "ate_m.rmse" if fitted is None else "ate_aligned_m.rmse")
    relations = lookup(metrics, "relations.trans_m.mean")
    if near is not None and ate is not None:
        after = "" if fitted is None else f" after a fit: {fitted}"
        alone = f" (odometry alone: {shown(odometry_m, 'cm')})" if odometry_m is not None else ""
        sentence = (
            f"{shown(near, 'percent')} of the wall cells lie within one cell of a true surface; "
            f"trajectory error {shown(ate, 'cm')} RMSE{alone}{after}."
        )
        return (GOOD if near >= GOOD_WALLS else BAD), sentence
    if relations is not None:
        return NEUTRAL, f"{scans} scans; mean relations error {shown(relations, 'm4')}."
    sentence = f"{scans} scans; no ground truth was given, so the error is unknown"
    check, size = lookup(metrics, "self_check.verdict"), lookup(metrics, "self_check.scale.said")
    said = size if size and check == "good" else check
    return NEUTRAL, sentence + (f"; self-check: {said}." if said else ".")


def plan_verdict(metrics: Metrics, odometry_m: float | None) -> Verdict:
    """Of a plan, or of several planners."""
    compared = metrics.get("planners") or []
    if compared:
        found = sum(bool(entry.get("success")) for entry in compared)
        good = bool(metrics.get("success", found))
        sentence = f"{found} of {len(compared)} planners found a path; the chosen one "
        return GOOD if good else BAD, sentence + ("did." if good else "did not.")
    if not metrics.get("success", True):
        return BAD, f"No path was found: {metrics.get('reason') or 'no reason is given'}."
    length = metrics.get("length_m")
    return GOOD, f"A path of {shown(length, 'm')} was found." if length is not None else "A path was found."


def localise_verdict(metrics: Metrics, odometry_m: float | None) -> Verdict:
    """Of a localisation: what the filter says, unless the truth says otherwise."""
    error = lookup(metrics, "localisation_error_m.rmse")
    known = f", {shown(error, 'cm')} RMSE from the truth" if error is not None else ""
    believed = bool(metrics.get("success", True))
    good = believed and bool(metrics.get("true_success", True))
    status = str(metrics.get("status", "localised"))
    if believed and not good:
        off = shown(metrics.get("last_error_m"), "m")
        status = f"not localised: the filter reported success, but was {off} off at the end"
    reason = f": {metrics['reason']}" if metrics.get("reason") else ""
    return (GOOD if good else BAD), f"{status[0].upper()}{status[1:]}{reason}{known}."


def overall_mood(moods: Iterable[str]) -> str:
    """Bad where one is, else good where one is."""
    found = set(moods)
    return next((mood for mood in (BAD, GOOD) if mood in found), NEUTRAL)


def collision_count(metrics: Metrics) -> int:
    """All contact episodes of a run."""
    collisions = metrics.get("collisions", 0)
    if isinstance(collisions, Mapping):
        return int(collisions.get("visible", 0)) + int(collisions.get("low", 0))
    return int(collisions or 0)
