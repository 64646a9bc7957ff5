"""What a stage is called: what was done, and what tells it from the others of its kind in its world."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

from turtlebag.reports.kinds import KINDS
from turtlebag.reports.stages import Stage

TASKS = {
    "goal": "Goal",
    "patrol": "Patrol",
    "avoid": "Obstacle avoidance",
    "explore": "Exploration",
    "run": KINDS["navigate"].title,
}
"""Titles of runs by their task."""
# Options of the command lines that tell stages apart, the first that do so first, and their wording.
DISTINGUISHING = {
    "robot": "{}",
    "teleop": "{}",
    "goal": "at {}",
    "waypoints": "by {}",
    "start": "from {}",
    "initial-pose": "initial pose {}",
    "mode": "{}",
    "laps": "{} laps",
    "duration": "{} s",
    "planner": "{}",
    "recording": "of recording {}",
    "config": "with {}",
    "set": "with {}",
    "seed": "seed {}",
}


def slug(text: str) -> str:
    """A text as a name for files and anchors."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-") or "x"


def names_of(stages: Sequence[Stage], record_of: Callable[[Stage], Stage | None]) -> list[tuple[str, str]]:
    """(label, title) of each stage of one world: `goal`, `Goal (5.5, −4.5)`; recordings come first in it.

    Labels are for keys and files and unique. Of several stages of a kind, all say in what they differ.
    """
    named: dict[int, tuple[str, str]] = {}
    bases = [(one.fact("task") or "run") if one.kind == "navigate" else one.kind for one in stages]
    for base in dict.fromkeys(bases):
        alike = [stage for stage, other in zip(stages, bases, strict=True) if other == base]
        recordings = [
            None if (record := record_of(stage)) is None or base == "record" else named[id(record)][0]
            for stage in alike
        ]
        for stage, name in zip(alike, _names_alike(base, alike, recordings), strict=True):
            named[id(stage)] = name
    return [named[id(stage)] for stage in stages]


def _names_alike(
    base: str, stages: Sequence[Stage], recordings: Sequence[str | None]
) -> list[tuple[str, str]]:
    """Names of all the stages of one kind, or task."""
    told = _differences(stages, recordings)
    # In a label a minus would be lost.
    labels = [slug(" ".join([base, *entry.values()]).replace("\u2212", "minus ")) for entry in told]
    names = []
    for stage, label, unique, differences in zip(stages, labels, unique_names(labels), told, strict=True):
        words = [text for name, text in differences.items() if (base, name) != ("goal", "goal")]
        number = [] if unique == label else [f"no. {unique.rpartition('-')[2]}"]
        names.append((unique, ", ".join([_title(stage, base), *words, *number])))
    return names


def unique_names(names: Sequence[str]) -> list[str]:
    """The names, with -2, -3 ... added to those that came before."""
    seen: Counter[str] = Counter()
    out = []
    for name in names:
        seen[name] += 1
        out.append(name if seen[name] == 1 else f"{name}-{seen[name]}")
    return out


def _title(stage: Stage, base: str) -> str:
    title = KINDS[base].title if base in KINDS else TASKS.get(base, base.capitalize())
    goal = _value(stage, "goal") if base == "goal" else None
    return f"{title} {','.join(goal.split(',')[:2])})" if goal else title


def _differences(stages: Sequence[Stage], recordings: Sequence[str | None]) -> list[dict[str, str]]:
    """For each stage what tells it from the others, by option: as few as tell them all apart."""
    told: list[dict[str, str]] = [{} for _ in stages]
    for name, template in DISTINGUISHING.items():
        if name == "recording":
            values = [label and label.removeprefix("record-").replace("-", " ") for label in recordings]
        else:
            values = [_value(stage, name) for stage in stages]
        before = len({tuple(entry.items()) for entry in told})
        if len({(tuple(entry.items()), value) for entry, value in zip(told, values, strict=True)}) == before:
            continue
        for entry, value in zip(told, values, strict=True):
            if value is not None:
                entry[name] = template.format(value)
    return told


def _value(stage: Stage, name: str) -> str | None:
    """What a stage was told by an option: numbers as a pose, of a file its name alone."""
    if name == "seed":
        return None if stage.manifest.seed is None else str(stage.manifest.seed)
    if name == "set":
        return ", ".join(stage.options("set")) or None
    text = stage.fact(name) if name in ("robot", "teleop") else stage.option(name)
    if text is None or name in ("laps", "duration"):
        return text
    if re.fullmatch(r"[-+.\deE, ]+", text):
        return f"({', '.join(part.strip() for part in text.split(','))})".replace("-", "\u2212")
    return Path(text).stem
