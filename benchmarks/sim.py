"""Simulated seconds per second of `record`, for each world and robot, and where the time goes.

python -m benchmarks.sim [--quick] [--sensors SET ...] [--out DIR]

CPU time of the process is what counts (a shared machine's wall clock says little); the drive is a
planned tour, cut off after a while. `rays` is the lidar, `bag` the writing, `physics` Bullet, the
rest is odometry, IMU, contacts, the driver and Python between them.
"""

from __future__ import annotations

import argparse
import csv
import tempfile
import time
from pathlib import Path

from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.sim.lidar import Lidar
from turtlebag.sim.physics import Physics
from turtlebag.sim.robots import load_robot
from turtlebag.sim.simulator import CONTROL_HZ, Sensors, SimConfig, Simulator
from turtlebag.sim.teleop import commands, load_script
from turtlebag.sim.worlds import load_world

CASES = (
    ("turtlebot3_world", "burger"),
    ("turtlebot3_world", "waffle_pi"),
    ("turtlebot3_house", "burger"),
    ("turtlebot3_house", "waffle_pi"),
    ("maze:1", "burger"),
    ("office:1", "burger"),
    ("forest:1", "burger"),
    ("forest:1", "jackal"),
    ("empty", "burger"),
)
COLUMNS = (
    "sensors",
    "world",
    "robot",
    "simulated_s",
    "x_real_time",
    "physics_%",
    "rays_%",
    "bag_%",
    "rest_%",
)


class Clock:
    """CPU seconds spent in wrapped methods."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = {}

    def wrap(self, owner: type, method: str, name: str) -> None:
        inner = getattr(owner, method)

        def timed(*args, **kwargs):
            start = time.process_time()
            try:
                return inner(*args, **kwargs)
            finally:
                self.spent[name] = self.spent.get(name, 0.0) + time.process_time() - start

        setattr(owner, method, timed)


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


def measure(world: str, robot: str, sensors: Sensors, duration: float, repeats: int) -> list[object]:
    """One row of the table: the fastest of some repeats, the shares from a last one with clocks."""
    speed, simulated = 0.0, 0.0
    for _ in range(repeats):
        simulated, spent = drive(world, robot, sensors, duration)
        speed = max(speed, simulated / spent)
    clock = Clock()
    kept = [(Physics, "step"), (Lidar, "measure")]
    kept += [(BagWriter, name) for name in ("observation", "truth", "command")]
    before = [getattr(owner, name) for owner, name in kept]
    for (owner, name), part in zip(kept, ("physics", "rays", "bag", "bag", "bag"), strict=True):
        clock.wrap(owner, name, part)
    _, spent = drive(world, robot, sensors, duration)
    for (owner, name), inner in zip(kept, before, strict=True):
        setattr(owner, name, inner)
    shares = [100.0 * clock.spent.get(part, 0.0) / spent for part in ("physics", "rays", "bag")]
    numbers = [*shares, 100.0 - sum(shares)]
    return [sensors, world, robot, round(simulated, 1), round(speed, 1), *(round(n) for n in numbers)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--sensors", nargs="+", choices=["realistic", "clean"], default=["realistic"])
    parser.add_argument("--out", type=Path, default=Path("data/benchmarks"))
    args = parser.parse_args()
    duration, repeats = (20.0, 1) if args.quick else (60.0, 3)
    drive("turtlebot3_world", "burger", "realistic", 2.0)  # compile first
    args.out.mkdir(parents=True, exist_ok=True)
    with (args.out / "sim.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        print("  ".join(COLUMNS))
        for world, robot in CASES[:3] if args.quick else CASES:
            for sensors in args.sensors:
                row = measure(world, robot, sensors, duration, repeats)
                writer.writerow(row)
                print("  ".join(str(value) for value in row), flush=True)


if __name__ == "__main__":
    main()
