"""What each part of the mapper is worth (switched off or exchanged), and each number (halved and doubled)."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import reduce
from itertools import product
from pathlib import Path
from typing import Any

import yaml

from benchmarks.runner import SPAWN, Case, Row, each, every, public_log
from benchmarks.slam_logs import MADE, PLACES, log_row
from turtlebag.pipeline.slam.mapper import SlamConfig

Variants = dict[str, dict[str, Any]]
"""Settings of a mapper by name."""
VARIANTS: dict[str, Variants] = yaml.safe_load(Path(__file__).with_name("variants.yaml").read_text())
CHOICES = VARIANTS["exchanged"]
ABLATIONS = CHOICES | VARIANTS["switched_off"]
ABLATED = ("mit-csail", "fr079", "intel", "hall-plain-1", "office-all-1")
PARTS = ("turtlebot3_world", "turtlebot3_house", "mit-csail", "intel", "fr079", "aces")
"""Drives (burger, `tour`, seed 1, realistic sensors) and public logs."""

NUMBERS = {
    "weight of the prior": "scans.align.PRIOR_SHARE",
    "variance of surfaces": "scans.align.SURFACE_VAR",
    "shared errors of points": "scans.align.STEP_COVARIANCE_SCALE",
    "kernel, rough poses": "scans.correspondences.ROUGH.sigma",
    "kernel, good poses": "scans.correspondences.FINE.sigma",
    "weight of the odometry's NIS": "odometry.line_icp.NIS_WEIGHT",
    "odometry's noise": "tracking.odometry: floor share",
    "way between key scans": "tracking: key_distance_m key_turn_rad",
    "drift of the steps": "graph.drift.HONEST",
    "reach of loops": "loops: reach_m",
    "trust in loops": "loops: covariance_scale",
}
"""Constants of modules of `pipeline/slam`, and settings by their section: those named change together."""
FACTORS = (0.5, 2.0)
AS_IT_IS = "as it is"
LOGS_OF_NUMBERS = ("mit-csail", "turtlebot3_house", "fr079", "aces", "intel")


def there(logs: Sequence[str]) -> list[str]:
    """The logs that are there, or can be made."""
    return [log for log in logs if log in MADE or log in PLACES or public_log(log)]


def ablation_row(variant: str, log: str) -> Row:
    """A log mapped by one of ABLATIONS."""
    return log_row(log, ABLATIONS[variant])


def ablation_cases(variants: Iterable[str] = ABLATIONS, logs: Sequence[str] = ABLATED) -> list[Case]:
    """Every variant on every log there is."""
    return every(ablation_row, variant=variants, log=there(logs))


def ablation_table(rows: list[Row]) -> list[Row]:
    """A line a variant: errors of each log [m], of the heading [deg] where they are known, CPU seconds."""
    table = {row["variant"]: {"variant": row["variant"]} for row in rows}
    for row in rows:
        table[row["variant"]][row["log"]] = row.get("error") or _told(row)
    return list(table.values())


def _told(row: Row) -> str:
    turned = f" / {row['deg']:.3f}" if "deg" in row else ""
    return f"{row['m']:.4f}{turned}{'' if row['verdict'] == 'good' else ' d'} ({row['cpu_s']:.0f} s)"


def number_row(log: str, number: str, factor: float) -> Row:
    """`multiplied_row` in a process of its own: kernels take a constant's value when they are compiled."""
    with ProcessPoolExecutor(1, SPAWN) as pool:
        return pool.submit(multiplied_row, log, number, factor).result()


def multiplied_row(log: str, number: str, factor: float) -> Row:
    """A log with a number multiplied, for this process too."""
    if number == AS_IT_IS:
        return log_row(log)
    section, _, fields = NUMBERS[number].partition(": ")
    settings: dict[str, Any] = {}
    if fields:
        config: Any = reduce(getattr, section.split("."), SlamConfig())
        settings = {field: factor * getattr(config, field) for field in fields.split()}
        for part in reversed(section.split(".")):
            settings = {part: settings}
    else:
        multiply_constant(section, factor, setattr)
    return log_row(log, settings)


def multiply_constant(where: str, factor: float, change: Callable[[object, str, Any], None]) -> None:
    """A constant of the mapper (room.module.NAME, or a field of it) multiplied wherever it is read."""
    room, name, constant, *field = where.split(".")
    was = getattr(importlib.import_module(f"turtlebag.pipeline.slam.{room}.{name}"), constant)
    now = was._replace(**{field[0]: factor * getattr(was, field[0])}) if field else factor * was
    for module in [module for name, module in sys.modules.items() if name.startswith("turtlebag.pipeline.")]:
        if getattr(module, constant, None) is was:
            change(module, constant, now)


def number_cases() -> list[Case]:
    """Every number halved and doubled on every log there is, log by log; and once as it is."""
    changes = [(AS_IT_IS, 1.0), *product(NUMBERS, FACTORS)]
    cases = [(log, *change) for log in there(LOGS_OF_NUMBERS) for change in changes]
    return each(number_row, ("log", "number", "factor"), cases)


def number_table(rows: Sequence[Row]) -> list[Row]:
    """A line a number: its error on each log over that with the number as it is, halved / doubled."""
    found = {(row["log"], row["number"], row["factor"]): row.get("m", float("nan")) for row in rows}
    table = []
    for number in NUMBERS:
        line: Row = {"number": number, "what": NUMBERS[number]}
        for log in dict.fromkeys(row["log"] for row in rows):
            usual = found.get((log, AS_IT_IS, 1.0), float("nan"))
            ratios = [found.get((log, number, factor), float("nan")) / usual for factor in FACTORS]
            line[log] = " / ".join(f"{ratio:.2f}" for ratio in ratios)
        table.append(line)
    return table
