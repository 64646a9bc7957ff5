"""Simulated drives and synthetic logs of the mapper's campaign, and how a map is measured."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, get_args

import numpy as np
from PIL import Image

import turtlebag as tb
from benchmarks.known import Known, known
from benchmarks.rows import Case, Row
from benchmarks.slam_logs import LOGS
from benchmarks.slam_scores import errors, scored
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.maps import load_map, save_map
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.slam import SlamConfig, SlamResult, run_slam
from turtlebag.reports.metrics.map import map_metrics, occupied, visible_surface
from turtlebag.sim.simulator import Sensors
from turtlebag.sim.teleop_scripts import script_names

PLACES = ("turtlebot3_house", "office", "maze", "forest", "turtlebot3_world")
ROBOTS = ("burger", "waffle_pi")
ROUNDS = 5
SENSORS: tuple[Sensors, ...] = get_args(Sensors)
TUTORIAL = [(world, robot) for world in (PLACES[4], PLACES[0]) for robot in ROBOTS]
DOCUMENTED = (
    *((world, robot, teleop, 1) for world, robot in TUTORIAL for teleop in ("tour", "fast", "spiral")),
    *((world, robot, "tour", seed) for world, robot in TUTORIAL for seed in (2, 3)),
    *((f"office:{seed}", "burger", "tour", seed) for seed in (31, 32, 33)),
)
"""The drives whose figures the documentation shows."""


# One map, measured.


def mapped(recording: Recording, settings: dict[str, Any] | None = None) -> tuple[SlamResult, Row]:
    """The map of a log, and what its row says whatever is known of the truth.

    CPU seconds are those of mapping alone, with everything loaded and compiled.
    """
    warm_up()
    start = time.process_time()
    result = run_slam(recording, SlamConfig.model_validate(settings or {}))
    spent = time.process_time() - start
    check = result.check.as_metrics()
    return result, {
        "scans": len(recording),
        "cpu_s": round(spent, 2),
        "verdict": check["verdict"],
        "reasons": check["reasons"],
        "loops": sum(loop.accepted for loop in result.loops),
    }


@cache
def warm_up() -> None:
    """Compile the kernels and load the libraries, so that no row pays for it."""
    for name in ("posts-1", "arena-slow-1"):
        run_slam(LOGS[name]().with_scans(slice(60)).recording, SlamConfig())


def picture(grid: OccupancyGrid, folder: Path, name: str) -> None:
    """A map as pgm, yaml and png."""
    folder.mkdir(parents=True, exist_ok=True)
    name = name.replace(":", "_").replace("/", "_")
    save_map(grid, folder, name)
    Image.open(folder / f"{name}.pgm").save(folder / f"{name}.png")


# Simulated drives.


def driven(
    world: str, robot: str, teleop: str, seed: int, sensors: Sensors
) -> tuple[Known, OccupancyGrid, bool]:
    """A simulated drive: log and truth, the true map, and whether the robot got stuck."""
    bag = tb.record(world, robot, teleop=teleop, seed=seed, settings={"sim.sensors": sensors})
    log = known(bag.recording, bag.truth.at(bag.recording.stamps_ns))
    return log, load_map(bag.path / "truth/map.yaml"), any("ended early" in note for note in bag.notes)


def drive_row(drive: Row, pictures: Path | None) -> Row:
    """A simulated drive, its trajectory and its map against the exact truth."""
    log, true_map, stuck = driven(**drive)
    result, row = mapped(log.recording)
    if pictures is not None:
        picture(result.grid, pictures / "maps", "-".join(map(str, drive.values())))
    found: Any = map_metrics(result.grid, true_map)
    row |= scored(log, result.trajectory)
    seen = max(int(visible_surface(true_map, result.grid).sum()), 1)
    return row | {
        "within": found["occupied_error_m"]["within_one_cell"],
        "iou": found["iou"],
        "walls": float(occupied(result.grid).sum() / seen),
        "stuck": stuck,
    }


def drive_case(
    world: str, robot: str, teleop: str, seed: int, sensors: Sensors, pictures: Path | None = None
) -> Case:
    """The case of a simulated drive."""
    about = {"world": world, "robot": robot, "teleop": teleop, "seed": seed, "sensors": sensors}
    return Case("-".join(map(str, about.values())), partial(drive_row, about, pictures), about)


def drive_cases() -> list[Case]:
    """Drives of every place, robot and script; of each number of them from the first as many of each kind.

    Every drive has a seed of its own, and so has the world where worlds are made of seeds.
    """
    scripts, cases = script_names(), []
    for number in range(ROUNDS * len(PLACES) * len(ROBOTS) * len(scripts)):
        (turn, place), seed = divmod(number, len(PLACES)), 5001 + number
        robot, teleop = ROBOTS[(turn + place) % 2], scripts[(turn // 2 + place) % len(scripts)]
        cases.append(drive_case(world_of(PLACES[place], seed), robot, teleop, seed, "realistic"))
    return cases


def world_of(place: str, seed: int) -> str:
    """The world of a seed; the tutorial's two are always the same."""
    return place if place.startswith("turtlebot3") else f"{place}:{seed}"


def fast_cases() -> list[Case]:
    """Fifty fast drives through the house, with either set of sensors."""
    return [drive_case(PLACES[0], "burger", "fast", seed, s) for seed in range(1001, 1051) for s in SENSORS]


def world_cases(out: Path) -> list[Case]:
    """The drives of the documentation, with either set of sensors."""
    return [drive_case(*drive, sensors, out) for drive in DOCUMENTED for sensors in SENSORS]


# Synthetic logs.


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


VARIANTS: dict[str, Callable[[Known], Known]] = {
    "as it is": lambda log: log,
    "3.5 m": lambda log: lidar_of(log, 3.5),
    "120 deg": narrow,
    "1 Hz": lambda log: slower(log, 1.0),
    "range_max": at_range_max,
}


def synthetic_row(log: str, lidar: str, pictures: Path) -> Row:
    """A synthetic log with one of VARIANTS of its lidar, against the exact truth."""
    made = LOGS[log]()
    heard = VARIANTS[lidar](made)
    result, row = mapped(heard.recording)
    picture(result.grid, pictures / "maps", f"{log}-{lidar}".replace(" ", "_"))
    wheels = {"driven_m": made.truth.length(), "odometry_m": errors(heard.odometry, heard.reference)["m"]}
    return row | scored(heard, result.trajectory) | wheels


def synthetic_cases(out: Path) -> list[Case]:
    """Every synthetic log in every variant, in an order drawn once and for all."""
    pairs = [{"log": log, "lidar": lidar} for log in LOGS for lidar in VARIANTS]
    order = stream(1, "synthetic cases").permutation(len(pairs))
    return [
        Case("{log}, {lidar}".format(**pairs[k]), partial(synthetic_row, pictures=out, **pairs[k]), pairs[k])
        for k in order
    ]
