"""Logs of the mapper's campaign by name, public, simulated and disturbed, and how their maps are measured."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from itertools import product
from pathlib import Path
from typing import Any, get_args

import numpy as np
from PIL import Image

import turtlebag as tb
from benchmarks.disturb import MODES, disturbed
from benchmarks.known_logs import NO_RELATIONS, Known, chosen, known
from benchmarks.runner import Case, Row, each, every, public, public_log
from benchmarks.slam_scores import by_relations, errors, scored
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.maps import load_map, save_map
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.relations import load_relations
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.trajectories import load_tum
from turtlebag.datasets.types import Trajectory
from turtlebag.pipeline.slam.mapper import SlamConfig, SlamResult, run_slam
from turtlebag.reports.metrics.map import map_metrics, occupied, visible_surface
from turtlebag.reports.metrics.trajectory import associate
from turtlebag.sim.simulator import Sensors
from turtlebag.sim.teleop_scripts import script_names

PLACES = ("turtlebot3_house", "office", "maze", "forest", "turtlebot3_world")
ROBOTS = ("burger", "waffle_pi")
ROUNDS = 5
DRIVE = ("world", "robot", "teleop", "seed", "sensors")
SENSORS: tuple[Sensors, ...] = get_args(Sensors)
TUTORIAL = [(world, robot) for world in (PLACES[4], PLACES[0]) for robot in ROBOTS]
DOCUMENTED = (
    *((world, robot, teleop, 1) for world, robot in TUTORIAL for teleop in ("tour", "fast", "spiral")),
    *((world, robot, "tour", seed) for world, robot in TUTORIAL for seed in (2, 3)),
    *((f"office:{seed}", "burger", "tour", seed) for seed in (31, 32, 33)),
)
"""The drives whose figures the lab notes show."""
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

WORLDS = Path(__file__).with_name("worlds")
BRISK = str(WORLDS / "brisk.yaml")
ROUND = str(WORLDS / "round.yaml")
FAR: dict[str, Any] = {"sim.lidar.rate_hz": 5.0}
"""A Jackal's lidar, which sees 30 m far, at the rate of the others."""
SLIP = {"sim.faults.slip": [[20.0, 25.0, 0.7, 0.7], [90.0, 92.0, 0.3, 0.0]]}
SILENT = {"sim.faults.scan_silent": [[35.0, 38.0], [120.0, 123.0]]}
PEOPLE = "+clutter:1,boxes=0,movers=3"
MISHAPS: dict[str, tuple[str, dict[str, Any], tuple[str, ...]]] = {
    "plain": ("", {}, ()),
    "slip": ("", SLIP, ()),
    "silent": ("", SILENT, ()),
    "people": (PEOPLE, {}, ()),
    "stuck": ("", {}, ("stuck",)),
    "jump": ("", {}, ("jump",)),
    "backwards": ("", {}, ("counted back",)),
    "all": (PEOPLE, SLIP | SILENT, ("counted back", "jump")),
}
"""What goes wrong in an office: people, faults of the simulator's, and kinds of `disturb`."""
BARE = ("corridors", "hall")
"""Worlds of `benchmarks/worlds`: for most of the way a burger's lidar sees nothing but two bare walls."""

MADE: dict[str, tuple[str, str, int]] = {
    f"{place}-{what}-{seed}": (place, what, seed)
    for seed in (1, 2)
    for place, whats in {**dict.fromkeys((*BARE, "maze", "forest"), ("plain",)), "office": MISHAPS}.items()
    for what in whats
}
"""Logs with mishaps by name: place, mishap, and seed."""


# One map, measured.


def mapped(log: Known, settings: dict[str, Any] | None = None) -> tuple[SlamResult, Row]:
    """The map of a log, and its row.

    CPU seconds are those of mapping alone, with everything loaded and compiled.
    """
    run_slam(log.with_scans(slice(60)).recording, SlamConfig())  # so that no row pays for what is compiled
    start = time.process_time()
    result = run_slam(log.recording, SlamConfig.model_validate(settings or {}))
    spent = time.process_time() - start
    return result, {
        "scans": len(log.recording),
        "cpu_s": round(spent, 2),
        "verdict": result.check.verdict,
        "reasons": list(result.check.reasons),
        "loops": sum(loop.accepted for loop in result.loops),
        **scored(log, result.trajectory),
    }


def picture(grid: OccupancyGrid, out: Path | None, *name: object) -> None:
    """A map as pgm, yaml and png, when there is a folder for it."""
    if out is not None:
        (out / "maps").mkdir(parents=True, exist_ok=True)
        file = save_map(grid, out / "maps", re.sub("[:/ ]", "_", "-".join(map(str, name))))
        Image.open(file.with_suffix(".pgm")).save(file.with_suffix(".png"))


# Simulated drives.


def driven(
    world: str,
    robot: str = "burger",
    teleop: str = "tour",
    seed: int = 1,
    sensors: str = "realistic",
    **more: Any,
) -> tuple[Known, tb.Bag]:
    """A simulated drive, its log with the true poses; `more` are settings of the simulator."""
    settings = {"sim.sensors": sensors, **more}
    bag = tb.record(world, robot, teleop=teleop, seed=seed, settings=settings)
    assert bag.truth is not None
    return known(bag.recording, bag.truth.at(bag.recording.stamps_ns)), bag


def drive_row(
    world: str, robot: str, teleop: str, seed: int, sensors: Sensors, out: Path | None = None
) -> Row:
    """A simulated drive, its trajectory and its map against the exact truth."""
    log, bag = driven(world, robot, teleop, seed, sensors)
    true_map = load_map(bag.path / "truth/map.yaml")
    result, row = mapped(log)
    picture(result.grid, out, world, robot, teleop, seed, sensors)
    found: Any = map_metrics(result.grid, true_map)
    seen = max(int(visible_surface(true_map, result.grid).sum()), 1)
    return row | {
        "within": found["occupied_error_m"]["within_one_cell"],
        "iou": found["iou"],
        "walls": float(occupied(result.grid).sum() / seen),
        "stuck": any("ended early" in note for note in bag.notes),
    }


def drive_cases() -> list[Case]:
    """Drives of every place, robot and script; of each number of them from the first as many of each kind.

    Every drive has a seed of its own, and so has the world where worlds are made of seeds.
    """
    scripts, drives = script_names(), []
    for number in range(ROUNDS * len(PLACES) * len(ROBOTS) * len(scripts)):
        (turn, place), seed = divmod(number, len(PLACES)), 5001 + number
        robot, teleop = ROBOTS[(turn + place) % 2], scripts[(turn // 2 + place) % len(scripts)]
        drives.append((world_of(PLACES[place], seed), robot, teleop, seed, "realistic"))
    return each(drive_row, DRIVE, drives)


def world_of(place: str, seed: int) -> str:
    """The world of a seed; the tutorial's two are always the same."""
    return place if place.startswith("turtlebot3") else f"{place}:{seed}"


def fast_cases() -> list[Case]:
    """Fifty fast drives through the house, with either set of sensors."""
    drives = product(PLACES[:1], ROBOTS[:1], ["fast"], range(1001, 1051), SENSORS)
    return each(drive_row, DRIVE, drives)


def world_cases(out: Path) -> list[Case]:
    """The drives of the documentation, with either set of sensors."""
    drives = [(*drive, sensors) for drive in DOCUMENTED for sensors in SENSORS]
    return each(partial(drive_row, out=out), DRIVE, drives)


# Simulated logs with mishaps, and with other lidars.


@lru_cache(maxsize=1)
def mishap(place: str, what: str, seed: int) -> Known:
    """A log of a place with one of MISHAPS; the last one is kept at hand."""
    people, faults, kinds = MISHAPS[what]
    if place in BARE:
        log, _ = driven(str(WORLDS / f"{place}.yaml"), teleop=ROUND, seed=seed)
    else:
        log, _ = driven(f"{place}:{40 + seed}{people}", "jackal", BRISK, seed, **FAR, **faults)
    for kind in kinds:
        log = disturbed(log, kind, seed)
    return log


def lidar_of(log: Known, metres: float) -> Known:
    """The log of a lidar that reaches so far."""
    lidar = log.recording.lidar
    reach = min(metres, lidar.range_max)
    return log.shortened(metres).recorded(lidar=replace(lidar, range_max=reach))


def slower(log: Known, period: float) -> Known:
    """The log of a lidar that takes a scan every so many seconds."""
    every = round(period / float(np.median(np.diff(log.times))))
    return log.with_scans(slice(None, None, max(1, every)))


def at_range_max(log: Known) -> Known:
    """The log of a driver that says range_max where nothing came back."""
    ranges = log.recording.ranges
    return log.with_ranges(np.where(np.isposinf(ranges), log.recording.lidar.range_max, ranges))


def narrow(log: Known) -> Known:
    """The log of a lidar that sees 120 degrees."""
    return log.with_ranges(np.where(log.outside(120.0), np.nan, log.recording.ranges))


LIDARS: dict[str, Callable[[Known], Known]] = {
    "as it is": lambda log: log,
    "3.5 m": lambda log: lidar_of(log, 3.5),
    "120 deg": narrow,
    "1 Hz": lambda log: slower(log, 1.0),
    "range_max": at_range_max,
}


def mishap_row(log: str, lidar: str, out: Path) -> Row:
    """A log with mishaps, by its name, and one of LIDARS, against the exact truth."""
    return lidar_row(by_name(log), log, lidar, out)


def lidar_row(made: Known, log: str, lidar: str, out: Path) -> Row:
    """A log as one of LIDARS hears it, against the exact truth."""
    heard = LIDARS[lidar](made)
    result, row = mapped(heard)
    picture(result.grid, out, log, lidar)
    wheels = {"driven_m": made.truth.length(), "odometry_m": errors(heard.odometry, heard.reference)["m"]}
    return row | wheels


def mishap_cases(out: Path) -> list[Case]:
    """Every log of MADE with every lidar; a burger's sees no farther than 3.5 m anyway."""
    cases = every(partial(mishap_row, out=out), log=MADE, lidar=LIDARS)
    return [c for c in cases if c.about["lidar"] != "3.5 m" or MADE[c.about["log"]][0] not in BARE]


# Public logs.


@lru_cache(maxsize=1)
def read(log: Path) -> Known:
    """A log with the relations or the reference poses that lie beside it; the last one is kept at hand."""
    recording = load_recording(log)
    stem = log.name.split(".clf")[0]
    relations, reference = (log.with_name(f"{stem}.{kind}") for kind in ("relations", "reference.tum"))
    places = np.full((len(recording), 3), np.nan)
    if reference.is_file():
        pairs = associate(Trajectory(recording.stamps_ns, SE2(places)), load_tum(reference))
        places[np.isin(recording.stamps_ns, pairs.stamps_ns)] = pairs.T_world_base.xyt
    return known(recording, SE2(places), load_relations(relations) if relations.is_file() else NO_RELATIONS)


def by_name(name: str) -> Known:
    """A log with what is known of it.

    Names are those of MADE, of worlds of PLACES (with `-robot-script-seed` where that is not a burger's first
    tour), and of the public logs.
    """
    if name in MADE:
        return mishap(*MADE[name])
    place, *drive = name.split("-")
    if place.partition(":")[0] in PLACES:
        robot, teleop, seed = drive or ("burger", "tour", "1")
        return driven(place, robot, teleop, int(seed))[0]
    log = public_log(name)
    assert log is not None
    return read(log)


def log_row(log: str, settings: dict[str, Any] | None = None, out: Path | None = None) -> Row:
    """A log by its name, mapped with some settings."""
    result, row = mapped(by_name(log), settings)
    picture(result.grid, out, log)
    return row


@lru_cache(maxsize=len(RADISH))
def undisturbed(log: str) -> Trajectory:
    """The trajectory that the log as it is gives, which all of its modes are compared with."""
    return mapped(by_name(log))[0].trajectory


def disturbed_row(log: str, mode: str) -> Row:
    """A log in one of MODES, beside the undisturbed one by the same relations.

    Where too few relations are left, the errors are those against the undisturbed map.
    """
    before, relations = undisturbed(log), by_name(log).relations
    harder = disturbed(replace(by_name(log), reference=before.poses), mode)
    if len(harder.which) < ENOUGH_RELATIONS:
        return mapped(replace(harder, relations=NO_RELATIONS))[1] | {"scored by": "undisturbed map"}
    row = mapped(harder)[1] | {"scored by": f"{len(harder.which)} relations"}
    same = by_relations(before, chosen(relations, harder.which))
    return row | {"before_m": same["m"], "before_deg": same["deg"], "ratio": row["m"] / same["m"]}


def log_cases(out: Path) -> list[Case]:
    """The public logs there are."""
    wild = public("wild")
    names = sorted(log.name.split(".clf")[0] for log in wild.glob("*.clf.bz2")) if wild else []
    cases = []
    for name in [*filter(public_log, RADISH), *names]:
        published = dict(zip(COLUMNS, PUBLISHED.get(name, ()), strict=False))
        cases.append(Case(name, partial(log_row, name, SETTINGS.get(name), out), published))
    return cases


def disturbed_cases() -> list[Case]:
    """Each public log with relations in each mode; the first fifteen are each mode once."""
    logs = [*filter(public_log, RADISH)]
    turns = product(range(len(logs)), enumerate(MODES))
    shifted = [(logs[(k + shift) % len(logs)], mode) for shift, (k, mode) in turns]
    return each(disturbed_row, ("log", "mode"), shifted)
