"""Accuracy and cost of 3D mapping, and what each package is worth in it.

Simulated worlds with a Waffle Pi that carries a 16-beam lidar (exact truth; errors without alignment, those
of clouds alone with the first pose as the only anchor), and drives through a made room and a ring of
corridors with everything switched off once. Times are CPU seconds of one process, reading and writing
included.
"""

from __future__ import annotations

import time
from functools import cache, lru_cache, partial
from pathlib import Path

import turtlebag as tb
from benchmarks.runner import Case, Row, every
from benchmarks.slam_parts import VARIANTS
from benchmarks.slam_scores import errors
from tests.helpers.drives3d import Drive3d, changed, make_drive
from turtlebag.pipeline.slam3d.slam3d import Slam3dConfig, run_slam_3d
from turtlebag.reports.metrics.trajectory import ate

WORLDS = ("turtlebot3_world", "turtlebot3_house", "office:3")


@lru_cache(maxsize=1)
def tour(world: str) -> tb.Bag:
    """A tour of a world; the last one is kept at hand."""
    return tb.record(world, "waffle_pi_3d")


def world_row(world: str, sensors: str, out: Path) -> Row:
    """A tour of a simulated world, with wheels or without; the map is kept."""
    bag, place = tour(world), out / f"{world.replace(':', '_')}-{sensors}"
    start = time.process_time()
    kept = tb.map(bag, topic="/points", settings={"sensors": sensors}, truth=bag, out=place, force=True)
    spent, found, driven = time.process_time() - start, kept.metrics, kept.trajectory
    assert bag.truth is not None
    off = errors(driven.poses, bag.truth.at(driven.stamps_ns))
    wheels = sensors == "both"
    anchored = {"rmse": off["anchored_m"], "max": off["anchored_worst_m"]}
    flat, walls = found["ate_m"] if wheels else anchored, found["map"]
    return {
        "clouds": found["scans"],
        "ATE rmse [m]": flat["rmse"],
        "max": flat["max"],
        "fitted": off["m"],
        "height rms [m]": found["out_of_plane"]["z_m"],
        "within one cell": walls["occupied_error_m"]["within_one_cell"] if wheels else "-",
        "coverage": walls["coverage"] if wheels else "-",
        "loops": found["loops"]["accepted"],
        "check": found["self_check"]["verdict"],
        "clouds/CPU s": round(found["scans"] / spent),
    }


@cache
def drive(world: str) -> Drive3d:
    """A drive through a world of `benchmarks/worlds`, with everything compiled that maps it."""
    made = make_drive(world, v=0.6, w=1.2)
    run_slam_3d(changed(made, lambda k, cloud: cloud if k < 20 else None).recording, Slam3dConfig())
    return made


def worth_row(log: str, variant: str) -> Row:
    """A drive mapped with some parts switched off."""
    made, start = drive(log), time.process_time()
    result = run_slam_3d(made.recording, Slam3dConfig.model_validate(VARIANTS["space"][variant]))
    spent = round(time.process_time() - start, 1)
    found = ate(result.trajectory, made.truth, align=False)["rmse"]
    return {"m": found, "cpu_s": spent, "verdict": result.check.verdict}


def space_cases(out: Path) -> list[Case]:
    """Every world, with wheels and without."""
    return every(partial(world_row, out=out), world=WORLDS, sensors=("both", "lidar"))


def worth_cases() -> list[Case]:
    """Every variant in the made room, then in the corridors."""
    return every(worth_row, log=("room", "corridors"), variant=VARIANTS["space"])
