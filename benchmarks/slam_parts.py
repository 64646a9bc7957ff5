"""What each part of the mapper is worth (switched off or exchanged)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import yaml

from benchmarks.rows import Case, Row
from benchmarks.slam_cases import PLACES, mapped
from benchmarks.slam_logs import LOGS
from benchmarks.slam_public import by_name

Variants = dict[str, dict[str, Any]]
"""Settings of a mapper by name."""
VARIANTS: dict[str, Variants] = yaml.safe_load(Path(__file__).with_name("variants.yaml").read_text())
CHOICES = VARIANTS["exchanged"]
ABLATIONS = CHOICES | VARIANTS["switched_off"]
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
