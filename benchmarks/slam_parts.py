"""What each part of the mapper is worth (switched off or exchanged)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.rows import Case, Row
from benchmarks.slam_cases import PLACES, driven, errors, mapped
from benchmarks.slam_logs import LOGS
from benchmarks.slam_public import RADISH, by_relations, read
from turtlebag.datasets.relations import load_relations

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


def ablated_row(data: Path | None, log: str, variant: str) -> Row:
    """A log with one of ABLATIONS."""
    return mapped_row(data, log, ABLATIONS[variant])


def mapped_row(data: Path | None, log: str, settings: dict[str, Any]) -> Row:
    """A log by its name: relations of a public one, or the exact truth of a made one or a drive."""
    if log in LOGS or log in PLACES:
        made = LOGS[log]() if log in LOGS else driven(log, "burger", "tour", 1, "realistic")[0]
        result, row = mapped(made.recording, settings)
        return row | errors(result.trajectory.poses, made.reference)
    assert data is not None
    folder = data / ("radish" if log in RADISH else "wild")
    result, row = mapped(read(folder / f"{log}.clf.bz2"), settings)
    return row | by_relations(result.trajectory, load_relations(folder / f"{log}.relations"))


def ablation_cases(
    data: Path | None, variants: Iterable[str] = ABLATIONS, logs: Sequence[str] = ABLATED
) -> list[Case]:
    """Every variant on every log there is."""
    there = [log for log in logs if log in LOGS or log in PLACES or data is not None]
    return [
        Case(f"{log}, {variant}", partial(ablated_row, data, log, variant), {"log": log, "variant": variant})
        for variant in variants
        for log in there
    ]


def parts_cases(data: Path | None) -> list[Case]:
    """The exchangeable parts on public logs and drives."""
    return ablation_cases(data, CHOICES, PARTS)


def ablation_table(rows: list[Row]) -> list[Row]:
    """A line a variant: mean errors, degrees of near relations where the truth is exact, CPU seconds."""
    table = {row["variant"]: {"variant": row["variant"]} for row in rows}
    for row in rows:
        degrees = row.get("near_deg", row.get("deg"))
        found = row.get("error") or f"{row['m']:.4f} / {degrees:.3f} ({row['cpu_s']:.0f} s)"
        table[row["variant"]][row["log"]] = found
    return list(table.values())
