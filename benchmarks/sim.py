"""Simulated seconds per second of `record`, for each world and robot.

python -m benchmarks.sim [--quick] [--sensors SET] [--out DIR]

CPU time of the process is what counts (a shared machine's wall clock says little); the drive is a
planned tour, cut off after a while.
"""

from __future__ import annotations

import tempfile
import time
from argparse import Namespace
from functools import partial
from pathlib import Path
from typing import get_args

from benchmarks.runner import Case, Row, Suite, options, parsed, run
from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.sim.robots import load_robot
from turtlebag.sim.simulator import CONTROL_HZ, Sensors, SimConfig, Simulator
from turtlebag.sim.teleop_scripts import commands, load_script
from turtlebag.sim.worlds import load_world

CASES = (
    ("turtlebot3_world", "burger"), ("turtlebot3_world", "waffle_pi"), ("turtlebot3_house", "burger"),
    ("turtlebot3_house", "waffle_pi"), ("maze:1", "burger"), ("office:1", "burger"), ("forest:1", "burger"),
    ("forest:1", "jackal"), ("empty", "burger"),
)  # fmt: skip


def drive(world_name: str, robot_name: str, sensors: Sensors, duration: float) -> tuple[float, float]:
    """Simulated seconds and CPU seconds of recording the first part of a tour."""
    world, robot = load_world(world_name), load_robot(robot_name)
    with (
        tempfile.TemporaryDirectory() as folder,
        Simulator(world, robot, SimConfig(sensors=sensors), 1) as simulator,
        BagWriter(Path(folder) / "bag", custom={}) as bag,
    ):
        driver = commands(load_script("tour"), world, robot, 1)
        next(driver)
        observation = simulator.reset()
        start = time.process_time()
        for _ in range(round(duration * CONTROL_HZ)):
            bag.observation(observation)
            truth = simulator.truth
            bag.truth(truth.stamp_ns, truth.T_world_base, truth.twist)
            try:
                command = driver.send(truth)
            except StopIteration:
                break
            bag.command(observation.stamp_ns, command)
            observation = simulator.step(command)
        spent = time.process_time() - start
    return observation.stamp_ns * 1e-9, spent


def measure(world: str, robot: str, sensors: Sensors, duration: float, repeats: int) -> Row:
    """One row of the table: the fastest of some repeats."""
    drive(world, robot, sensors, 2.0)  # compile first
    drives = [drive(world, robot, sensors, duration) for _ in range(repeats)]
    speed = max(simulated / spent for simulated, spent in drives)
    return {"simulated_s": round(drives[0][0], 1), "x_real_time": round(speed, 1)}


def suites(args: Namespace) -> dict[str, Suite]:
    """One table."""
    abouts = [{"sensors": args.sensors, "world": world, "robot": robot} for world, robot in CASES]
    measured = partial(measure, duration=20.0 if args.quick else 60.0, repeats=1 if args.quick else 3)
    cases = [Case(" ".join(about.values()), partial(measured, **about), about) for about in abouts]
    return {"sim": Suite(cases, quick=3, kept=False)}


if __name__ == "__main__":
    parser = options(__doc__, quick="three places, 20 s of each, once")
    parser.add_argument("--sensors", choices=get_args(Sensors), default="realistic")
    run(parsed(parser, suites), suites)
