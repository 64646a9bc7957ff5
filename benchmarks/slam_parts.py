"""What each part of the mapper is worth (switched off, one at a time)."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.slam_cases import errors, mapped
from benchmarks.slam_logs import LOGS
from benchmarks.slam_public import by_relations, read
from benchmarks.slam_rows import Case, Row
from datasets.relations import load_relations

OFF = {"enabled": False}
ABLATIONS: dict[str, dict[str, Any]] = {
    "everything": {},
    "no KISS-ICP": {"tracking": {"kiss": OFF}},
    "no Open3D": {"loops": {"open3d": False}, "refine": {"open3d": False}},
    "no loop closure": {"loops": OFF},
    "graph not robust": {"loops": {"soft": 0.0}, "refine": {"soft": 0.0}},
    "no joint refinement": {"refine": {"rounds": 0}},
    "no odometry calibration": {"tracking": {"calibration": False}},
    "no re-posing": {"posing": OFF},
    "no deskewing": {"deskew": False},
    "lidar only": {"sensors": "lidar"},
    "odometry only": {"sensors": "odometry"},
}
ABLATED = ("mit-csail", "fr079", "intel", "posts-1", "hall-2", "office-all-1", "rooms-1", "arena-fast-1")


def ablated_row(data: Path | None, log: str, variant: str) -> Row:
    """A log with one of ABLATIONS: relations of a public log, or the exact truth of a synthetic one."""
    if log in LOGS:
        made = LOGS[log]()
        result, row = mapped(made.recording, ABLATIONS[variant])
        return row | errors(result.trajectory.poses, made.truth.poses)
    assert data is not None
    result, row = mapped(read(data / "radish" / f"{log}.clf.bz2"), ABLATIONS[variant])
    relations = load_relations(data / "radish" / f"{log}.relations")
    return row | by_relations(result.trajectory, relations)


def ablation_cases(data: Path | None) -> list[Case]:
    """Every variant on every log there is."""
    logs = [log for log in ABLATED if log in LOGS or data is not None]
    return [
        Case(f"{log}, {variant}", partial(ablated_row, data, log, variant), {"log": log, "variant": variant})
        for variant in ABLATIONS
        for log in logs
    ]


def ablation_table(rows: list[Row]) -> list[Row]:
    """A line a variant: mean errors, degrees of near relations where the truth is exact, CPU seconds."""
    table = {row["variant"]: {"variant": row["variant"]} for row in rows}
    for row in rows:
        degrees = row.get("near_deg", row.get("deg"))
        found = row.get("error") or f"{row['m']:.4f} / {degrees:.3f} ({row['cpu_s']:.0f} s)"
        table[row["variant"]][row["log"]] = found
    return list(table.values())
