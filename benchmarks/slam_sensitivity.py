"""The numbers that matter most, halved and doubled: how much the error of each log grows.

Each case is mapped in a process of its own, for kernels take a constant's value when they are compiled.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.rows import Case, Row
from benchmarks.workers import SPAWN

NUMBERS = {
    "weight of the prior": "align.PRIOR_SHARE",
    "variance of surfaces": "align.SURFACE_VAR",
    "shared errors of points": "align.STEP_INFLATION",
    "kernel, rough poses": "align.ROUGH_SIGMA_M",
    "kernel, good poses": "align.FINE_SIGMA_M",
    "weight of a surprise": "line_tracking.SURPRISE",
    "odometry's noise": "tracking.odometry: floor share",
    "way between key scans": "tracking: key_distance_m key_turn_rad",
    "drift of the steps": "drift.HONEST",
    "reach of loops": "loops: reach_m",
    "trust in loops": "loops: inflation",
}
"""Constants of modules of `pipeline/slam`, and settings by their section: those named change together."""
LOGS = ("mit-csail", "turtlebot3_house", "rooms-1", "fr079", "aces", "intel")
FACTORS = (1.0, 0.5, 2.0)


def measured(name: str, factor: float, data: Path | None, log: str) -> Row:
    """The row of a log with a number multiplied. To be called once in a process, before anything else."""
    section, _, fields = NUMBERS[name].partition(": ")
    settings: dict[str, Any] = {}
    if fields:
        from turtlebag.pipeline.slam.slam import SlamConfig

        config: Any = SlamConfig()
        for part in section.split("."):
            config = getattr(config, part)
        settings = {field: factor * getattr(config, field) for field in fields.split()}
        for part in reversed(section.split(".")):
            settings = {part: settings}
    else:
        module_name, _, constant = section.partition(".")
        module = importlib.import_module(f"turtlebag.pipeline.slam.{module_name}")
        setattr(module, constant, factor * getattr(module, constant))
    from benchmarks.slam_parts import mapped_row

    return mapped_row(data, log, settings)


def sensitivity_row(name: str, factor: float, data: Path | None, log: str) -> Row:
    """`measured` in a process of its own."""
    with ProcessPoolExecutor(1, SPAWN) as pool:
        return pool.submit(measured, name, factor, data, log).result()


def sensitivity_cases(data: Path | None) -> list[Case]:
    """Every number halved and doubled on every log there is, log by log; and once as it is."""
    public = ("mit-csail", "fr079", "aces", "intel")
    cases = []
    for log in LOGS if data else [log for log in LOGS if log not in public]:
        for name in NUMBERS:
            for factor in FACTORS if name == next(iter(NUMBERS)) else FACTORS[1:]:
                number = name if factor != 1.0 else "as it is"
                about = {"log": log, "number": number, "factor": factor}
                measure = partial(sensitivity_row, name, factor, data, log)
                cases.append(Case(f"{log}, {number}, {factor}", measure, about))
    return cases


def sensitivity_table(rows: Sequence[Row]) -> list[Row]:
    """A line a number: its error on each log over that with the number as it is, halved / doubled."""
    found = {(row["log"], row["number"], row["factor"]): row.get("m", float("nan")) for row in rows}
    table = []
    for number in NUMBERS:
        line: Row = {"number": number, "what": NUMBERS[number]}
        for log in dict.fromkeys(row["log"] for row in rows):
            usual = found.get((log, "as it is", 1.0), float("nan"))
            ratios = [found.get((log, number, factor), float("nan")) / usual for factor in FACTORS[1:]]
            line[log] = " / ".join(f"{ratio:.2f}" for ratio in ratios)
        table.append(line)
    return table
