"""What each part of the mapper is worth (switched off or exchanged)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.rows import Case, Row
from benchmarks.slam_cases import PLACES, mapped
from benchmarks.slam_logs import LOGS
from benchmarks.slam_public import by_name

OFF = {"enabled": False}
OPEN3D = {"match": "open3d"}
CHOICES: dict[str, dict[str, Any]] = {
    "everything": {},
    "KISS-ICP front end": {"front_end": "kiss_icp"},
    "wheels front end": {"front_end": "wheels"},
    "point ICP front end": {"front_end": "docs.examples.point_icp:PointIcp"},
    "Open3D loops": {"loops": OPEN3D},
    "KISS-ICP, Open3D": {"front_end": "kiss_icp", "loops": OPEN3D},
    "libraries alone": {
        "front_end": "kiss_icp",
        "loops": OPEN3D,
        "tracking": {"calibration": False},
        "refine": {"rounds": 0},
        "posing": OFF,
    },
}
"""The exchangeable parts; `libraries alone` is KISS-ICP, Open3D and GTSAM without any alignment of ours."""
ABLATIONS: dict[str, dict[str, Any]] = {
    **CHOICES,
    "no loop closure": {"loops": OFF},
    "no joint refinement": {"refine": {"rounds": 0}},
    "no odometry calibration": {"tracking": {"calibration": False}},
    "no re-posing": {"posing": OFF},
    "no deskewing": {"deskew": False},
    "lidar only": {"sensors": "lidar"},
    "odometry only": {"sensors": "odometry"},
}
ABLATED = ("mit-csail", "fr079", "intel", "posts-1", "hall-2", "office-all-1", "rooms-1", "arena-fast-1")
PARTS = ("turtlebot3_world", "turtlebot3_house", "mit-csail", "intel", "fr079", "aces")
"""Drives (burger, `tour`, seed 1, realistic sensors) and public logs."""


def mapped_row(data: Path | None, log: str, settings: dict[str, Any]) -> Row:
    """A log by its name, mapped with some settings."""
    recording, scored = by_name(data, log)
    result, row = mapped(recording, settings)
    return row | scored(result.trajectory)


def ablation_cases(
    data: Path | None, variants: Iterable[str] = ABLATIONS, logs: Sequence[str] = ABLATED
) -> list[Case]:
    """Every variant on every log there is."""
    there = [log for log in logs if log in LOGS or log in PLACES or data is not None]
    cases = []
    for variant in variants:
        for log in there:
            measure = partial(mapped_row, data, log, ABLATIONS[variant])
            cases.append(Case(f"{log}, {variant}", measure, {"log": log, "variant": variant}))
    return cases


def ablation_table(rows: list[Row]) -> list[Row]:
    """A line a variant: mean errors, degrees of near relations where the truth is exact, CPU seconds."""
    table = {row["variant"]: {"variant": row["variant"]} for row in rows}
    for row in rows:
        degrees = row.get("near_deg", row.get("deg"))
        found = row.get("error") or f"{row['m']:.4f} / {degrees:.3f} ({row['cpu_s']:.0f} s)"
        table[row["variant"]][row["log"]] = found
    return list(table.values())
