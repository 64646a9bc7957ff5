"""A short trial run of every stage in a temporary folder: checks the installation and compiles the
kernels."""

from __future__ import annotations

import logging
import tempfile
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from turtlebag.datasets.maps import save_map
from turtlebag.datasets.outputs import Output, Stopwatch
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.navigation.mission import Request
from turtlebag.pipeline.stages.map import build_map
from turtlebag.pipeline.stages.navigate import navigate
from turtlebag.pipeline.stages.record import Scene, record
from turtlebag.pipeline.stages.requests.maps import MapRequest
from turtlebag.pipeline.terminal.messages import log
from turtlebag.sim.robots import load_robot
from turtlebag.sim.worlds import load_world

WORLD, ROBOT = "turtlebot3_world", "burger"
SCRIPT = """\
name: trial
v: 0.2
w: 0.8
steps:
  - {spin: 1}
  - {through: [[-1.5, -1.5], [-2, 0], [-2, -0.5]]}
"""


def trial() -> float:
    """Record, map and navigate for a few simulated seconds; returns the wall time [s].

    Most of it is compiling, on one core, so driving on the true map is tried at the same time, in another
    process.
    """
    watch = Stopwatch()
    with (
        tempfile.TemporaryDirectory() as name,
        ProcessPoolExecutor(
            1, get_context("spawn"), initializer=log.setLevel, initargs=(logging.ERROR,)
        ) as other,
    ):
        driven = other.submit(_navigate, Path(name))
        before = log.level
        log.setLevel(logging.ERROR)
        try:
            _record_and_map(Path(name))
        finally:
            log.setLevel(before)
        driven.result()
    return watch.seconds()


def _record_and_map(folder: Path) -> None:
    script = folder / "trial.yaml"
    script.write_text(SCRIPT)
    record(Scene.load(WORLD, ROBOT, 0), str(script), Output(folder / "record"))
    build_map(MapRequest.checked(source=folder / "record", truth=folder / "record"), Output(folder / "map"))


def _navigate(folder: Path) -> None:
    place = folder / "true"
    place.mkdir()
    world, robot = load_world(WORLD), load_robot(ROBOT)
    goal = Request(
        task="goal",
        seed=0,
        map_path=save_map(world.rasterize(robot.lidar_height), place),
        initial_pose="start",
        goal=SE2.from_xyt(-1.8, -0.5, 0.0),
    )
    if navigate(world, robot, goal, Output(folder / "run"), say=lambda line: None) != 0:
        raise RuntimeError("the trial drive did not reach its goal 0.2 m ahead")
