"""The self-check as a detector of bad maps: maps of unseen seeds, with scans and wheels disturbed.

Kinds of disturbance of the half `build` may be looked at while the self-check is made; those of `score` only
tell how good it is. A map is bad when a scan lies more than BAD_M off, or TIMES the median worst of
the undisturbed maps of its own world and robot; all after a rigid fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.disturb import (
    MODES,
    Known,
    Mask,
    Mode,
    around,
    mirrored,
    mirrored_scans,
    places,
    shortened,
    steps,
    times,
    with_odometry,
    with_ranges,
    with_scans,
    with_steps,
)
from benchmarks.rows import Case, Row, grouped, share
from benchmarks.slam_cases import PLACES, ROBOTS, driven, mapped, world_of
from benchmarks.slam_logs import arena, office, rooms
from benchmarks.slam_scores import errors
from turtlebag.datasets.se2 import SE2, wrap
from turtlebag.datasets.seeds import stream

BAD_M, TIMES = 0.2, 5.0
PLAINS, TURNS = 4, 2
"""Undisturbed maps for one of each kind, and how often each kind comes in a world."""
SCRIPTS = ("fast", "random_walk", "wall_follow")
SYNTHETIC: dict[str, Callable[[int], Known]] = {
    "synthetic arena": lambda seed: arena(seed, ("slow", "fast", "spiral")[seed % 3]),
    "synthetic rooms": rooms,
    "synthetic office": office,
}


def stretch(log: Known, share: float, rng: np.random.Generator) -> Mask:
    """Scans of one stretch of the log, (n,)."""
    return around(log, places(log, 1, rng), share * log.recording.duration())


def elsewhere(log: Known, rng: np.random.Generator) -> Known:
    """A tenth of the scans were taken at another time, half a log away."""
    there = stretch(log, 0.1, rng)
    other = np.roll(log.recording.ranges, len(there) // 2, axis=0)
    ranges = np.where(there[:, None], other, log.recording.ranges)
    reference = np.where(there[:, None], np.nan, log.reference.xyt)
    return replace(with_ranges(log, ranges), reference=SE2(reference))


def repeated(log: Known, rng: np.random.Generator) -> Known:
    """A lidar that says the same for 5 s, three times."""
    index = np.arange(len(log.recording))
    held = around(log, places(log, 3, rng), 5.0)
    return with_ranges(log, log.recording.ranges[np.maximum.accumulate(np.where(held, 0, index))])


def wheels_times(log: Known, rng: np.random.Generator, factor: float) -> Known:
    """Wheels that say so many times the way for a tenth of the log: spinning, or counting the wrong way."""
    moved = steps(log.odometry)
    moved[stretch(log, 0.1, rng)[:-1], :2] *= factor
    return with_steps(log, moved)


def carried(log: Known, rng: np.random.Generator) -> Known:
    """A robot that is carried for a tenth of the log: no scans meanwhile, and wheels that stand still."""
    away = stretch(log, 0.1, rng)
    moved = steps(log.odometry)
    moved[away[:-1]] = 0.0
    return with_scans(with_steps(log, moved), ~away)


def yaw_bias(log: Known, rng: np.random.Generator) -> Known:
    """Odometry that turns by 1.5 degrees a second, and no gyro to tell."""
    moved = steps(log.odometry)
    moved[:, 2] += np.deg2rad(1.5) * np.diff(times(log.recording))
    turned = with_steps(log, moved)
    return replace(turned, recording=replace(turned.recording, imu=None))


def mirrored_odometry(log: Known) -> Known:
    """Left and right wheel exchanged, and no gyro to tell."""
    log = replace(log, recording=replace(log.recording, imu=None))
    return with_odometry(log, log.odometry[0] @ mirrored(log.odometry[0].inverse() @ log.odometry))


def blocked(log: Known, rng: np.random.Generator) -> Known:
    """Half of the view is blocked by something 0.3 m away that rides along."""
    r = log.recording
    hidden = wrap(r.lidar.angles - rng.uniform(-np.pi, np.pi)) > 0.0
    return with_ranges(log, np.where(hidden, np.float32(0.3), r.ranges))


def jitter(log: Known, rng: np.random.Generator) -> Known:
    """Stamps of scans that are off by up to half the time between two."""
    r = log.recording
    away = rng.uniform(-0.5, 0.5, len(r)) * float(np.median(np.diff(r.stamps_ns)))
    away[[0, -1]] = 0.0
    stamps = np.maximum.accumulate(r.stamps_ns + away.astype(np.int64))
    return replace(log, recording=replace(r, stamps_ns=stamps + np.arange(len(r))))


def ghosts(log: Known, rng: np.random.Generator) -> Known:
    """People about: a fifth of all scans have a quarter of their beams end somewhere short."""
    ranges = log.recording.ranges.copy()
    for scan in np.flatnonzero(rng.random(len(ranges)) < 0.2):
        first, width = rng.integers(ranges.shape[1]), ranges.shape[1] // 4
        beams = np.arange(first, first + width) % ranges.shape[1]
        ranges[scan, beams] = np.fmin(ranges[scan, beams], rng.uniform(0.4, 2.0))
    return with_ranges(log, ranges)


def floor(log: Known, rng: np.random.Generator) -> Known:
    """A lidar that tips forward when it brakes: a tenth of the scans see the floor 1.5 m ahead."""
    r = log.recording
    ahead = np.cos(r.lidar.angles)
    strip = np.where(ahead > 0.5, 1.5 / np.maximum(ahead, 0.5), np.inf)
    tipped = rng.random(len(r)) < 0.1
    return with_ranges(log, np.where(tipped[:, None], np.fmin(r.ranges, strip), r.ranges))


KINDS: dict[str, Mode] = {
    **{name: MODES[name] for name in ("gap3", "half", "bias", "late", "stuck", "drop30")},
    "short sight": lambda log, rng: shortened(log, 0.4 * log.recording.lidar.range_max),
    "elsewhere": elsewhere,
    "slipped": lambda log, rng: wheels_times(log, rng, 3.0),
    "mirrored scans": lambda log, rng: mirrored_scans(log),
    **{name: MODES[name] for name in ("gap20", "third", "noisy", "jump", "fov120", "noise3")},
    "repeated": repeated,
    "counted back": lambda log, rng: wheels_times(log, rng, -1.0),
    "carried": carried,
    "yaw bias": yaw_bias,
    "mirrored odometry": lambda log, rng: mirrored_odometry(log),
    "long ranges": lambda log, rng: with_ranges(log, 1.05 * log.recording.ranges),
    "blocked": blocked,
    "jitter": jitter,
    "ghosts": ghosts,
    "floor": floor,
    "other odometry": lambda log, rng: with_odometry(log, log.odometry[::-1]),
    "steps of 5 cm": lambda log, rng: with_ranges(log, np.round(20.0 * log.recording.ranges) / 20.0),
}
"""How a log is disturbed, by kind; `plain` is undisturbed, and of the half of its case's number."""
SCORED = (
    "gap20", "third", "noisy", "fov120", "noise3", "counted back", "carried", "yaw bias", "long ranges",
    "blocked", "jitter", "ghosts", "floor", "other odometry", "steps of 5 cm",
)  # fmt: skip
"""Kinds that only tell how good the self-check is."""


def half_of(kind: str) -> str:
    """The half that a kind belongs to."""
    return "score" if kind in SCORED else "build"


def source(place: str, robot: str, seed: int) -> Known:
    """A log nobody has seen, short enough for many of them."""
    if place in SYNTHETIC:
        return SYNTHETIC[place](seed)
    return driven(world_of(place, seed), robot, SCRIPTS[seed % len(SCRIPTS)], seed, "realistic")[0]


def detector_row(place: str, robot: str, seed: int, kind: str) -> Row:
    """A log with one kind of disturbance, against its truth."""
    log = source(place, robot, seed)
    if kind != "plain":
        log = KINDS[kind](log, stream(seed, kind))
    result, row = mapped(log.recording)
    return row | errors(result.trajectory.poses, log.reference)


def detector_cases() -> list[Case]:
    """Every kind TURNS times in every world and with every robot, one world after the other."""
    groups = [(place, robot) for place in PLACES for robot in ROBOTS] + [(place, "") for place in SYNTHETIC]
    kinds = [*KINDS, *["plain"] * PLAINS] * TURNS
    orders = [stream(number, "detector cases").permutation(len(kinds)) for number in range(len(groups))]
    cases = []
    for turn in range(len(kinds)):
        for number, (place, robot) in enumerate(groups):
            kind, seed = kinds[orders[number][turn]], 7001 + turn * len(groups) + number
            half = half_of(kind) if kind in KINDS else ("build", "score")[turn % 2]
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
    """False "good" and false "doubtful", for all, each half and each kind."""
    found = [row for row in judged(rows) if "bad" in row]
    parts = {"all": found}
    for half in ("build", "score"):
        parts[half] = [row for row in found if row["half"] == half]
    for kind in ("plain", *KINDS):
        half = f"{half_of(kind)}: " if kind in KINDS else ""
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


def spread(rows: Sequence[Row]) -> Row:
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
        "CPU s": float(np.sum([row["cpu_s"] for row in done])),
    }


def by(*keys: str) -> Callable[[list[Row]], list[Row]]:
    """A table of `spread`: all rows, and those of each value of some columns."""

    def table(rows: list[Row]) -> list[Row]:
        parts = {"all": rows}
        for key in keys:
            for value in dict.fromkeys(row[key].partition(":")[0] for row in rows):
                parts[value] = [row for row in rows if row[key].partition(":")[0] == value]
        return [{"of": name, **spread(part)} for name, part in parts.items()]

    return table
