"""The self-check as a detector of bad maps: maps of unseen seeds, with scans and wheels disturbed.

Kinds of disturbance of the half `build` may be looked at while the self-check is made; those of `score` only
tell how good it is. A map is bad when a scan lies more than BAD_M off, or TIMES the median worst of
the undisturbed maps of its own world and robot; all after a rigid fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from benchmarks.disturb import KINDS, SCORED, disturbed
from benchmarks.known_logs import Known
from benchmarks.runner import Case, Row, grouped, share
from benchmarks.slam_logs import PLACES, ROBOTS, driven, mapped, world_of
from tests.helpers.made_logs import arena, office, rooms
from turtlebag.datasets.seeds import stream
from turtlebag.pipeline.stages.map_summary import BAD_M

TIMES = 5.0
PLAINS, TURNS = 4, 2
"""Undisturbed maps for one of each kind, and how often each kind comes in a world."""
HALVES = {kind: "score" if kind in SCORED else "build" for kind in KINDS}
"""The half that a kind belongs to; `plain` ones are of that of their case's number."""
SCRIPTS = ("fast", "random_walk", "wall_follow")
SYNTHETIC: dict[str, Callable[[int], Known]] = {
    "synthetic arena": lambda seed: arena(seed, ("slow", "fast", "spiral")[seed % 3]),
    "synthetic rooms": rooms,
    "synthetic office": office,
}


def detector_row(place: str, robot: str, seed: int, kind: str) -> Row:
    """A log that nobody has seen, with one kind of disturbance, against its truth."""
    if place in SYNTHETIC:
        log = SYNTHETIC[place](seed)
    else:
        log, _ = driven(world_of(place, seed), robot, SCRIPTS[seed % len(SCRIPTS)], seed)
    return mapped(log if kind == "plain" else disturbed(log, kind, seed))[1]


def detector_cases() -> list[Case]:
    """Every kind TURNS times in every world and with every robot, one world after the other."""
    groups = [(place, robot) for place in PLACES for robot in ROBOTS] + [(place, "") for place in SYNTHETIC]
    kinds = [*KINDS, *["plain"] * PLAINS] * TURNS
    orders = [stream(number, "detector cases").permutation(len(kinds)) for number in range(len(groups))]
    cases = []
    for turn in range(len(kinds)):
        for number, (place, robot) in enumerate(groups):
            kind, seed = kinds[orders[number][turn]], 7001 + turn * len(groups) + number
            half = HALVES.get(kind) or ("build", "score")[turn % 2]
            about = {"world": place, "robot": robot, "seed": seed, "kind": kind, "half": half}
            name = "-".join(str(part) for part in (place, robot, seed, kind) if part)
            cases.append(Case(name, partial(detector_row, place, robot, seed, kind), about))
    return cases


def judged(rows: Sequence[Row]) -> list[Row]:
    """The rows with `bad`, whether the map is, and its limit; a row without a map stays as it is.

    A world whose undisturbed maps are fewer than three is judged by BAD_M alone.
    """
    plains = [row for row in rows if row["kind"] == "plain" and "error" not in row]
    limits = {
        of: min(BAD_M, TIMES * float(np.median([row["worst_m"] for row in part])))
        for of, part in grouped(plains, "world", "robot").items()
        if len(part) >= 3
    }
    found = []
    for row in rows:
        limit = limits.get((row["world"], row["robot"]), BAD_M)
        bad = {} if "error" in row else {"limit_m": limit, "bad": row["worst_m"] > limit}
        found.append({**row, **bad})
    return found


def rate(rows: Sequence[Row], verdict: str) -> str:
    """How many have a verdict, and the interval of the share."""
    return share(sum(row["verdict"] == verdict for row in rows), len(rows))


def detection(rows: Sequence[Row]) -> list[Row]:
    """False "good" and false "doubtful" of judged rows, for all, each half and each kind."""
    found = [row for row in rows if "bad" in row]
    parts = {"all": found}
    for half in ("build", "score"):
        parts[half] = [row for row in found if row["half"] == half]
    for kind in ("plain", *KINDS):
        half = f"{HALVES[kind]}: " if kind in KINDS else ""
        parts[f"{half}{kind}"] = [row for row in found if row["kind"] == kind]
    return [
        {
            "maps": name,
            "n": len(part),
            'bad ones called "good"': rate([r for r in part if r["bad"]], "good"),
            f'beyond {BAD_M} m called "good"': rate([r for r in part if r["worst_m"] > BAD_M], "good"),
            'others called "doubtful"': rate([r for r in part if not r["bad"]], "doubtful"),
        }
        for name, part in parts.items()
        if part
    ]


def accuracy(rows: Sequence[Row]) -> Row:
    """Figures of many maps with exact truth; m after a rigid fit."""
    done = [row for row in rows if "error" not in row]
    if not done:
        return {"maps": 0, "errors": len(rows)}
    far = [row for row in done if row["worst_m"] > BAD_M]

    def under(limit: float, key: str) -> int:
        return sum(row[key] <= limit for row in done)

    return {
        "maps": len(done),
        "errors": len(rows) - len(done),
        "median m": float(np.median([row["m"] for row in done])),
        "under 2 cm": under(0.02, "m"),
        "median worst": float(np.median([row["worst_m"] for row in done])),
        "worst": max(row["worst_m"] for row in done),
        "worst under 5 cm": under(0.05, "worst_m"),
        "under 10 cm": under(0.1, "worst_m"),
        "under 10 cm, anchored": under(0.1, "anchored_worst_m"),
        f"beyond {BAD_M} m": len(far),
        "of these good": sum(row["verdict"] == "good" for row in far),
        "others doubtful": sum(row["verdict"] != "good" for row in done if row not in far),
    }


def by(*keys: str) -> Callable[[list[Row]], list[Row]]:
    """A table of `accuracy`: all rows, and those of each value of some columns."""

    def table(rows: list[Row]) -> list[Row]:
        parts = {"all": rows}
        for key in keys:
            for value in dict.fromkeys(row[key].partition(":")[0] for row in rows):
                parts[value] = [row for row in rows if row[key].partition(":")[0] == value]
        return [{"of": name, **accuracy(part)} for name, part in parts.items()]

    return table
