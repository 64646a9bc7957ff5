"""The public logs of the mapper's campaign, as they are and disturbed, scored by their relations."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.disturb import MODES, disturbed
from benchmarks.known import NO_RELATIONS, Known, chosen, known
from benchmarks.rows import Case, Row
from benchmarks.slam_cases import PLACES, driven, mapped, picture
from benchmarks.slam_logs import LOGS
from benchmarks.slam_scores import by_relations, errors, scored
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.relations import load_relations
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.trajectories import load_tum
from turtlebag.datasets.types import Trajectory
from turtlebag.reports.metrics.trajectory import associate

RADISH = ("mit-csail", "fr079", "intel")
# The hospital is 430 m wide and 630 m long.
SETTINGS = {"fr-clinic_robotlaser": {"grid": {"resolution_m": 0.1}}}
ENOUGH_RELATIONS = 300
COLUMNS = ("scan matching", "RBPF", "Graph Mapping 2009", "Cartographer 2016")
# Mean translational [m] / rotational [deg] error as published: scan matching, gmapping (RBPF), Graph
# Mapping 2009, Cartographer 2016.
PUBLISHED = {
    "intel": ("0.220", "0.070", "0.031 / 1.3", "0.0229 / 0.453"),
    "fr079": ("0.258", "0.061", "0.056 / 0.6", "0.0452 / 0.538"),
    "mit-csail": ("0.106", "0.049", "0.004 / 0.05", "0.0319 / 0.369"),
    "aces": ("0.173", "0.060", "0.044 / 0.4", "0.0375 / 0.373"),
    "mit-killian": ("1.651", "0.122", "0.050 / 0.5", "0.0395 / 0.352"),
}


def stem(log: Path) -> str:
    """The name of a log's truth beside it, without what kind it is."""
    return log.name.split(".clf")[0]


@lru_cache(maxsize=1)
def read(log: Path) -> Known:
    """A log with the relations or the reference poses that lie beside it; the last one is kept at hand."""
    recording = load_recording(log)
    relations, reference = (log.with_name(f"{stem(log)}.{kind}") for kind in ("relations", "reference.tum"))
    places = np.full((len(recording), 3), np.nan)
    if reference.is_file():
        pairs = associate(Trajectory(recording.stamps_ns, SE2(places)), load_tum(reference))
        places[np.isin(recording.stamps_ns, pairs.stamps_ns)] = pairs.T_world_base.xyt
    return known(recording, SE2(places), load_relations(relations) if relations.is_file() else NO_RELATIONS)


def public_log(data: Path, name: str) -> Path:
    """Where a public log lies."""
    return data / ("radish" if name in RADISH else "wild") / f"{name}.clf.bz2"


def by_name(data: Path | None, name: str) -> Known:
    """A log with what is known of it.

    Names are those of LOGS, of worlds of PLACES (with `-robot-script-seed` where that is not a burger's first
    tour; sensors are realistic), and of the public logs in `data`.
    """
    if name in LOGS:
        return LOGS[name]()
    place, *drive = name.split("-")
    if place.partition(":")[0] in PLACES:
        robot, teleop, seed = drive or ("burger", "tour", "1")
        return driven(place, robot, teleop, int(seed), "realistic")[0]
    assert data is not None
    return read(public_log(data, name))


def log_row(
    data: Path | None, log: str, settings: dict[str, Any] | None = None, pictures: Path | None = None
) -> Row:
    """A log by its name, mapped with some settings."""
    made = by_name(data, log)
    result, row = mapped(made.recording, settings)
    if pictures is not None:
        picture(result.grid, pictures / "maps", log)
    return row | scored(made, result.trajectory)


@lru_cache(maxsize=len(RADISH))
def undisturbed(log: Path) -> Trajectory:
    """The trajectory that the log as it is gives, which all of its modes are compared with."""
    return mapped(read(log).recording)[0].trajectory


def disturbed_row(log: Path, mode: str) -> Row:
    """A log in one of MODES, beside the undisturbed one by the same relations.

    Where too few relations are left, the errors are those against the undisturbed map.
    """
    before, relations = undisturbed(log), read(log).relations
    harder = disturbed(replace(read(log), reference=before.poses), mode)
    result, row = mapped(harder.recording)
    if len(harder.which) < ENOUGH_RELATIONS:
        return row | errors(result.trajectory.poses, harder.reference) | {"scored by": "undisturbed map"}
    row |= by_relations(result.trajectory, harder.relations) | {"scored by": f"{len(harder.which)} relations"}
    same = by_relations(before, chosen(relations, harder.which))
    return row | {"before_m": same["m"], "before_deg": same["deg"], "ratio": row["m"] / same["m"]}


def log_cases(data: Path, pictures: Path) -> list[Case]:
    """The public logs there are."""
    found = [public_log(data, name) for name in RADISH] + sorted(data.glob("wild/*.clf.bz2"))
    cases = []
    for name in (stem(log) for log in found if log.is_file()):
        published = dict(zip(COLUMNS, PUBLISHED.get(name, ()), strict=False))
        cases.append(Case(name, partial(log_row, data, name, SETTINGS.get(name), pictures), published))
    return cases


def disturbed_cases(data: Path) -> list[Case]:
    """Each public log with relations in each mode; the first fifteen are each mode once."""
    logs = [log for name in RADISH if (log := public_log(data, name)).is_file()]
    cases = []
    for shift in range(len(logs)):
        for k, mode in enumerate(MODES):
            log = logs[(k + shift) % len(logs)]
            about = {"log": stem(log), "mode": mode}
            cases.append(Case(f"{stem(log)}-{mode}", partial(disturbed_row, log, mode), about))
    return cases
