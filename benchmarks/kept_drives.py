"""Simulated drives of two to three minutes, recorded once and kept, and what is made to go wrong with them.

A drive is known by its number: its world, robot, script, mishap and seed follow from that.
"""

from __future__ import annotations

import os
import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.disturb import disturbed
from benchmarks.known_logs import Known
from benchmarks.runner import Row, code_of
from benchmarks.slam_logs import PEOPLE, PLACES, ROBOTS, WORLDS, driven, world_of
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.maps import load_map

SCRIPTS = ("walk", "swift", "walls")
FAULTS: dict[str, dict[str, Any]] = {
    "slip": {"sim.faults.slip": [[20.0, 25.0, 0.7, 0.7], [90.0, 92.0, 0.3, 0.0]]},
    "silent": {"sim.faults.scan_silent": [[35.0, 38.0], [100.0, 103.0]]},
}
DRIVEN = ("plain", "people", "plain", "slip", "plain", "silent", "plain", "plain")
"""What goes wrong while a drive is recorded, by its number."""
AFTERWARDS = ("plain", "stuck", "jump", "late", "drop30")
"""What a drive that went well comes with, kinds of `disturb` in turn."""
KEPT_BY = ("sim", "datasets/types.py", "benchmarks/kept_drives.py", "benchmarks/known_logs.py")
"""Drives recorded by other code than this are recorded again."""
FIRST_SEED, DRIVES = 20001, 300


@dataclass(frozen=True, eq=False)
class Drive:
    """A drive as it was recorded, its true map, and what it is."""

    log: Known
    true_map: OccupancyGrid
    about: Row


def about(number: int) -> Row:
    """World, robot, script, seed, and mishap of a drive."""
    place, turn = PLACES[number % len(PLACES)], number // len(PLACES)
    return {
        "world": place,
        "robot": ROBOTS[turn % 2],
        "script": SCRIPTS[turn // 2 % len(SCRIPTS)],
        "seed": FIRST_SEED + number,
        "driven": DRIVEN[number % len(DRIVEN)],
    }


def drive(number: int, folder: Path) -> Drive:
    """A drive by its number, recorded when the folder does not have it of this simulator yet."""
    file = folder / code_of(KEPT_BY) / f"{number:03d}.pickle"
    if not file.is_file():
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(f".{os.getpid()}")
        part.write_bytes(pickle.dumps(_recorded(number)))
        part.rename(file)
    kept: Drive = pickle.loads(file.read_bytes())
    return kept


def _recorded(number: int) -> Drive:
    is_ = about(number)
    world = world_of(is_["world"], is_["seed"])
    if is_["driven"] == "people":
        world += PEOPLE
    script = str(WORLDS / f"{is_['script']}.yaml")
    log, bag = driven(world, is_["robot"], script, is_["seed"], **FAULTS.get(is_["driven"], {}))
    return Drive(log, load_map(bag.path / "truth/map.yaml"), is_)


def mishap_of(number: int) -> str:
    """What goes wrong in a drive, while it is recorded or afterwards."""
    driven_with = DRIVEN[number % len(DRIVEN)]
    if driven_with != "plain":
        return driven_with
    return AFTERWARDS[(number // len(DRIVEN) + (number % len(DRIVEN) + 1) // 2) % len(AFTERWARDS)]


def went_wrong(one: Drive, kind: str) -> Drive:
    """A drive that went well, in one of the kinds of `disturb`."""
    if kind == "plain" or one.about["driven"] != "plain":
        return one
    return Drive(disturbed(one.log, kind, one.about["seed"]), one.true_map, one.about)
