"""What mapping costs: the whole command by size of the log, and the mapper that works while the robot drives.

Grown are the time at one place (the arena gone round again and again), the area (a maze of more and more
cells) and a public log (ACES, there and back until it has 20,000 scans). The online mapper is compared with
the offline one: errors, time a scan, memory.
"""

from __future__ import annotations

import bz2
import json
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
import yaml

import turtlebag as tb
from benchmarks.runner import Case, Row, each, every, held_mb, public_log
from benchmarks.slam_logs import FAR, RADISH, by_name, mapped, read
from benchmarks.slam_scores import scored
from turtlebag.datasets.durations import seconds
from turtlebag.datasets.grid import UNKNOWN
from turtlebag.datasets.kernels import folder
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Recording, Trajectory
from turtlebag.pipeline.navigation.online_map import OnlineMap
from turtlebag.pipeline.slam.mapper import SlamConfig
from turtlebag.pipeline.slam.online.mapper import Mapper
from turtlebag.pipeline.slam.online.memory import heard
from turtlebag.sim.robots import load_robot
from turtlebag.sim.simulator import SimConfig, Simulator
from turtlebag.sim.teleop_scripts import Script, Step, commands
from turtlebag.sim.worlds import load_world

SCANS = 20_000
GROWN = f"ACES to {SCANS} scans"
LAPS = (1, 2, 4, 9, 18, 45, 90)
"""Of 1,107 scans each: up to 100,000."""
SIDES_M = (6, 12, 18)
V = {"burger": 0.2, "jackal": 0.6}
COSTS = ("scans", "keys", "area_m2", "cpu_s", "ms a scan", "peak_mb", "verdict")
HOURS = 2.0
ONLINE = (
    "case", "scans", "keys", "offline_m", "end_m", "driving_m", "ms median", "ms p99", "jump_worst_m",
    "mb after each quarter", "error",
)  # fmt: skip
PUBLIC = (*RADISH, "aces", "belgioioso", "fhw", "acapulco", "infinite-corridor")
DRIVES = (
    "turtlebot3_world-burger-tour-1", "turtlebot3_house-burger-fast-1001",
    "turtlebot3_house-burger-fast-1002", "office:5037-burger-tour-5037", "maze:5003-burger-spiral-5003",
)  # fmt: skip

# A process of a few megabytes starts the command: Linux counts what the starting process held as the peak of
# the one that it starts.
METER = """
import json, os, sys
child = os.posix_spawn(sys.argv[1], sys.argv[1:], os.environ)
_, status, used = os.wait4(child, 0)
code = os.waitstatus_to_exitcode(status)
print(json.dumps([code, used.ru_utime + used.ru_stime, used.ru_maxrss]))
"""


def metered(command: list[str]) -> tuple[float, float]:
    """CPU seconds (user and system) and peak memory [MB] of a command; RuntimeError where it fails."""
    meter = [sys.executable, "-I", "-S", "-c", METER]
    done = subprocess.run([*meter, *command], capture_output=True, text=True, check=True)
    code, cpu_s, peak_kb = json.loads(done.stdout.splitlines()[-1])
    if code:
        raise RuntimeError(done.stderr.strip() or f"exit code {code}")
    return cpu_s, peak_kb / 1e3


def map_cost(log: Path, scratch: Path) -> Row:
    """CPU seconds (user and system) and peak memory [MB] of mapping a file.

    A run that had to compile a kernel does not count: the map is made again. RuntimeError when there is none.
    """
    command = [sys.executable, "-m", "pipeline", "map", "-q", str(log), "--out"]
    while True:
        with tempfile.TemporaryDirectory(dir=scratch) as place:
            before, out = _compiled(), Path(place) / "map"
            cpu_s, peak_mb = metered([*command, str(out)])
            if _compiled() != before:
                continue
            said, grid = tb.Map(out).metrics, tb.Map(out).occupancy
            return {
                "scans": said["scans"],
                "keys": said["keyframes"],
                "area_m2": round(np.count_nonzero(grid.cells != UNKNOWN) * grid.resolution**2),
                "cpu_s": round(cpu_s, 1),
                "ms a scan": round(1e3 * cpu_s / said["scans"], 2),
                "peak_mb": round(peak_mb),
                "verdict": said["self_check"]["verdict"],
            }


def _compiled() -> set[Path]:
    kept = folder()
    return set() if kept is None else set(kept.rglob("*.nbc"))


def growth_cases() -> list[Case]:
    """The public logs there are, then the arena and the floor in all sizes."""
    logs = {"Intel": public_log("intel"), GROWN: public_log("aces")}
    cases = [Case(name, partial(log_row, log, name == GROWN)) for name, log in logs.items() if log]
    drives = [("turtlebot3_world", "burger", laps) for laps in LAPS]
    drives += [(f"maze:1,cells={side}", "jackal", 1) for side in SIDES_M]
    return cases + each(driven_row, ("world", "robot", "laps"), drives)


def log_row(log: Path, grown: bool) -> Row:
    """A CARMEN log, as it is or there and back."""
    text = bz2.decompress(log.read_bytes())
    with tempfile.TemporaryDirectory() as place:
        file = Path(place) / "log.clf"
        file.write_bytes(there_and_back(text) if grown else text)
        return map_cost(file, Path(place))


def driven_row(world: str, robot: str, laps: int) -> Row:
    """A world with its tour driven so many times."""
    with tempfile.TemporaryDirectory() as place:
        script, drive = Path(place) / "laps.yaml", Path(place) / "drive"
        steps = [{"wait": 1.0}, *[{"route": "tour"}] * laps, {"wait": 1.0}]
        script.write_text(yaml.safe_dump({"name": "laps", "v": V[robot], "w": 0.6, "steps": steps}))
        tb.record(world, robot, teleop=script, settings=FAR if robot == "jackal" else None, out=drive)
        return map_cost(drive, Path(place))


def there_and_back(content: bytes, scans: int = SCANS) -> bytes:
    """A CARMEN log driven forwards, then backwards, and so on, until it has so many scans.

    Only so is the way from each scan to the next one that was driven: the log does not end where it
    begins. The wheels err backwards as they do forwards. The clock goes on.
    """
    lines = [line.split() for line in content.split(b"\n") if line.startswith(b"FLASER ")]
    there = list(range(len(lines)))
    order = [0]
    while len(order) < scans:
        order += there[1:] if order[-1] == 0 else there[-2::-1]
    order = order[:scans]
    stamps = np.array([float(words[-3]) for words in lines])
    clock = stamps[0] + np.concatenate([[0.0], np.cumsum(np.abs(np.diff(stamps[order])))])
    said = (
        b" ".join([*lines[k][:-3], b"%.6f" % t, lines[k][-2], b"%.6f" % t])
        for k, t in zip(order, clock.tolist(), strict=True)
    )
    return b"\n".join(said) + b"\n"


# While the robot drives.


def online(recording: Recording) -> tuple[Trajectory, Trajectory, Row]:
    """A log mapped scan by scan: poses as given on the way, poses as known at the end, and a row."""
    mapper, given, spent, held = Mapper(recording.lidar, recording.T_base_lidar), [], [], []
    for k, (scan, odometry) in enumerate(heard(recording)):
        start = time.process_time()
        given.append(mapper.add(scan, odometry).xyt)
        spent.append(time.process_time() - start)
        if (4 * (k + 1)) % len(recording) < 4:
            held.append(held_mb())
    driving = Trajectory(recording.stamps_ns, SE2(np.array(given)))
    return driving, mapper.trajectory, costs(mapper, spent, held)


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


def online_row(log: str) -> Row:
    """A log by its name, online beside offline."""
    made = by_name(log)
    offline = mapped(made)[1]
    given, end, row = online(made.recording)
    driving_m, end_m = (scored(made, trajectory)["m"] for trajectory in (given, end))
    return offline | row | {"offline_m": offline["m"], "end_m": end_m, "driving_m": driving_m}


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
    off, spent = [], []
    held: list[float] = []
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


def online_cases() -> list[Case]:
    """Public logs there are, drives, synthetic logs, 20,000 scans, two hours."""
    made = (*DRIVES, "hall-plain-1", "office-all-1")
    cases = every(online_row, log=(*filter(public_log, PUBLIC), *made))
    cases.append(Case(f"arena, {HOURS:g} h", hours_row))
    if aces := public_log("aces"):
        cases.append(Case(GROWN, partial(long_row, aces)))
    return cases
