"""Drives through simulated worlds, and the maps that our own SLAM makes of them."""

from __future__ import annotations

import fcntl
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import turtlebag as tb
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.maps import save_map
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.types import Scan
from turtlebag.pipeline.navigation.recorder import trajectory_of
from turtlebag.sim.robots import RobotSpec, load_robot
from turtlebag.sim.routes import RoutePlanner, random_goals
from turtlebag.sim.script_driver import Driver
from turtlebag.sim.simulator import CONTROL_HZ, Sensors, SimConfig, Simulator
from turtlebag.sim.worlds import load_world

V, W = 0.22, 0.9
PLACES = {"arena": ("turtlebot3_world", "burger"), "house": ("turtlebot3_house", "waffle_pi")}
"""The tutorial's worlds, each with its robot."""


@dataclass(frozen=True)
class Sweep:
    """One scan with odometry at its first and last beam; the true pose beside it."""

    scan: Scan
    T_odom_base: SE2
    T_odom_base_end: SE2
    T_world_base: SE2


class Place:
    """A world with a robot in it, its true map, and drives through it."""

    def __init__(self, world: str, robot: str, sensors: Sensors = "realistic") -> None:
        self.sim = SimConfig(sensors=sensors)
        self.world = load_world(world)
        self.robot: RobotSpec = load_robot(robot)
        self.grid: OccupancyGrid = self.world.rasterize(self.robot.lidar_height)
        self._places = RoutePlanner(self.world, self.robot).places

    def drive(self, seed: int, seconds: float) -> list[Sweep]:
        """From random place to random place for a while, steered by the truth as by a person who watches."""
        rng = stream(seed, "wander")
        x, y = rng.choice(self._places)
        spawn = SE2.from_xyt(x, y, rng.uniform(-math.pi, math.pi))
        planner = RoutePlanner(replace(self.world, spawn=spawn), self.robot)
        route = random_goals(planner, rng, 1.5 * V * seconds)
        odometry, scans = [], []
        with Simulator(self.world, self.robot, self.sim, seed) as simulator:
            seen = simulator.reset(spawn)
            hands = Driver(min(self.robot.limits.max_v, V), W).flow(simulator.truth, route)
            command = next(hands)
            for _ in range(round(seconds * CONTROL_HZ)):
                odometry.append((seen.stamp_ns, seen.odometry.T_odom_base))
                if seen.scan is not None:
                    scans.append((seen.scan, seen.odometry.T_odom_base, simulator.scan_truth))
                seen = simulator.step(command)
                command = hands.send(simulator.truth)
        begun = trajectory_of(odometry).at(np.array([scan.stamp_ns for scan, _, _ in scans]))
        return [Sweep(scan, begun[k], end, truth) for k, (scan, end, truth) in enumerate(scans)]


def kidnapped(before: list[Sweep], after: list[Sweep]) -> list[Sweep]:
    """One drive, then another elsewhere, as if the robot were carried there with its wheels at rest."""
    T_odom_old = before[-1].T_odom_base_end @ after[0].T_odom_base.inverse()
    carried = [
        Sweep(s.scan, T_odom_old @ s.T_odom_base, T_odom_old @ s.T_odom_base_end, s.T_world_base)
        for s in after
    ]
    return before + carried


def built_map(source: Path, folder: Path) -> tb.Map:
    """Our map of a log, made once."""
    made = (folder / "manifest.json").exists()
    return tb.Map(folder) if made else tb.map(source, out=folder, force=True)


class Maps:
    """Maps made by our own SLAM from a recorded tour, kept below a folder by world, robot and sensors."""

    def __init__(self, folder: Path, sensors: Sensors) -> None:
        self._folder, self._sensors = folder, sensors

    def slam(self, world: str, robot: str) -> Path:
        """map.yaml of a world as mapped from the robot's own tour of it."""
        place = self._folder / "".join(c if c.isalnum() else "_" for c in f"{world} {robot} {self._sensors}")
        place.mkdir(parents=True, exist_ok=True)
        with (place / "lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # cases side by side share the map: the first one makes it
            if not (place / "map" / "manifest.json").exists():
                settings = {"sim.sensors": self._sensors}
                tb.record(world, robot, settings=settings, out=place / "record", force=True)
            return built_map(place / "record", place / "map").yaml

    def true(self, name: str, grid: OccupancyGrid) -> Path:
        """map.yaml of a world as it is."""
        self._folder.mkdir(parents=True, exist_ok=True)
        return save_map(grid, self._folder, name)
