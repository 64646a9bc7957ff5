"""The mapper that works while the robot drives, beside the offline one: errors, time a scan, memory."""

from __future__ import annotations

import bz2
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.runner import Case, Row, held_mb
from benchmarks.slam_growth import GROWN, there_and_back
from benchmarks.slam_logs import RADISH, by_name, mapped, public_log, read
from benchmarks.slam_scores import scored
from turtlebag.datasets.durations import seconds
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Recording, Trajectory
from turtlebag.pipeline.navigation.online_map import OnlineMap
from turtlebag.pipeline.slam.growing_log import heard
from turtlebag.pipeline.slam.mapper import Mapper
from turtlebag.pipeline.slam.slam import SlamConfig
from turtlebag.sim.robots import load_robot
from turtlebag.sim.simulator import SimConfig, Simulator
from turtlebag.sim.teleop_scripts import Script, Step, commands
from turtlebag.sim.worlds import load_world

HOURS = 2.0
COLUMNS = (
    "case", "scans", "keys", "offline_m", "end_m", "driving_m", "ms median", "ms p99", "jump_median_m",
    "jump_worst_m", "lost", "mb after each quarter", "error",
)  # fmt: skip
PUBLIC = (*RADISH, "aces", "belgioioso", "fhw", "acapulco", "infinite-corridor")
DRIVES = (
    "turtlebot3_world-burger-tour-1", "turtlebot3_house-burger-fast-1001",
    "turtlebot3_house-burger-fast-1002", "office:5037-burger-tour-5037", "maze:5003-burger-spiral-5003",
)  # fmt: skip


def online(recording: Recording) -> tuple[Trajectory, Trajectory, Row]:
    """A log mapped scan by scan: poses as given on the way, poses as known at the end, and a row."""
    mapper, given, spent, lost, held = Mapper(recording.lidar, recording.T_base_lidar), [], [], 0, []
    for k, (scan, odometry) in enumerate(heard(recording)):
        start = time.process_time()
        given.append(mapper.add(scan, odometry).xyt)
        spent.append(time.process_time() - start)
        lost += mapper.lost
        if (4 * (k + 1)) % len(recording) < 4:
            held.append(held_mb())
    about = {"jump_median_m": float(np.median(mapper.jumps or [0.0])), "lost": lost}
    row = about | costs(mapper, spent, held)
    return Trajectory(recording.stamps_ns, SE2(np.array(given))), mapper.trajectory, row


def costs(mapper: Mapper, spent: list[float], held: list[float]) -> Row:
    """What a mapper took that was given scans in so many CPU seconds each, and how far its poses jumped.

    The first ten scans, when kernels are loaded, do not count.
    """
    return {
        "scans": len(spent),
        "keys": len(mapper.T_map_keys),
        "ms median": round(1e3 * float(np.median(spent[10:])), 2),
        "ms p99": round(1e3 * float(np.quantile(spent[10:], 0.99)), 1),
        "jump_worst_m": max(mapper.jumps, default=0.0),
        "mb after each quarter": " ".join(str(round(mb)) for mb in held),
    }


def online_row(data: Path | None, log: str) -> Row:
    """A log by its name, online beside offline."""
    made = by_name(data, log)
    result, offline = mapped(made.recording)
    given, end, row = online(made.recording)
    told = {"offline_m": result.trajectory, "end_m": end, "driving_m": given}
    return offline | row | {name: scored(made, trajectory)["m"] for name, trajectory in told.items()}


def long_row(log: Path) -> Row:
    """ACES there and back until it has 20,000 scans."""
    with tempfile.TemporaryDirectory() as place:
        longer = Path(place) / "aces.clf"
        longer.write_bytes(there_and_back(bz2.decompress(log.read_bytes())))
        return online(read(longer).recording)[2]


def hours_row() -> Row:
    """The arena driven at random for two simulated hours; errors of the poses given on the way."""
    world, robot = load_world("turtlebot3_world"), load_robot("burger")
    script = Script(name="hours", style="flowing", steps=[Step(random_walk=200.0)] * 100)
    mapped_so_far = OnlineMap(robot.T_base_lidar, SlamConfig())
    off, spent, held = [], [], []
    with Simulator(world, robot, SimConfig(), 1) as simulator:
        driver = commands(script, world, robot, 1)
        command, observation = next(driver), simulator.reset()
        while (now := seconds(observation.stamp_ns)) < HOURS * 3600.0:
            start = time.process_time()
            mapped_so_far.observe(observation)
            if observation.scan is not None:
                spent.append(time.process_time() - start)
                T_map_base = mapped_so_far.T_map_odom @ observation.odometry.T_odom_base
                off.append(np.hypot(*(simulator.truth.T_world_base.inverse() @ T_map_base).xy))
            if now >= (len(held) + 1) * 900.0 * HOURS:
                held.append(held_mb())
            command = driver.send(simulator.truth)
            observation = simulator.step(command)
    held.append(held_mb())
    assert mapped_so_far.mapper is not None
    driving_m = float(np.sqrt(np.mean(np.square(off))))
    return {"driving_m": driving_m} | costs(mapped_so_far.mapper, spent, held)


def online_cases(data: Path | None) -> list[Case]:
    """Public logs there are, drives, synthetic logs, 20,000 scans, two hours."""
    made = (*DRIVES, "hall-plain-1", "office-all-1")
    there = [name for name in PUBLIC if data and public_log(data, name).is_file()]
    cases = [Case(name, partial(online_row, data, name)) for name in (*there, *made)]
    cases.append(Case(f"arena, {HOURS:g} h", hours_row))
    if "aces" in there:
        cases.append(Case(GROWN, partial(long_row, public_log(data, "aces"))))
    return cases
