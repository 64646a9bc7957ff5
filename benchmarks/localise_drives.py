"""Simulated drives for judging localisation: a robot wandering between random places of a world."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from turtlebag.datasets.grid import FREE, OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.types import Scan, Trajectory, Twist, wrap
from turtlebag.sim.robots import RobotSpec, load_robot
from turtlebag.sim.simulator import CONTROL_HZ, Sensors, SimConfig, Simulator
from turtlebag.sim.world import World
from turtlebag.sim.worlds import load_world

KEPT = 15  # control steps that surely reach back to a scan's stamp
MARGIN_M = 0.12  # kept from walls and low things, beyond the robot's own radius


@dataclass(frozen=True)
class Sweep:
    """One scan with odometry at its first and last beam; the true pose beside it."""

    scan: Scan
    T_odom_base: SE2
    T_odom_base_end: SE2
    T_world_base: SE2


class Wanderer:
    """Ways through the free floor of a world, kept clear of everything by the robot's radius and a margin."""

    def __init__(self, world_name: str, robot_name: str, sensors: Sensors = "realistic") -> None:
        self.sim = SimConfig(sensors=sensors)
        self.world: World = load_world(world_name)
        self.robot: RobotSpec = load_robot(robot_name)
        self.grid: OccupancyGrid = self.world.rasterize(self.robot.lidar_height)
        blocked = self.grid.cells != FREE
        centers = self.grid.center_of(np.stack(np.indices(self.grid.shape), axis=-1))
        for outline in self.world.keepout:
            low, high = np.min(outline, axis=0), np.max(outline, axis=0)
            blocked |= np.all((centers >= low) & (centers <= high), axis=-1)
        clearance = distance_transform_edt(~blocked) * self.grid.resolution
        self._open = clearance > self.robot.model.circumscribed_radius + MARGIN_M
        self._number = np.full(self.grid.shape, -1)
        self._cells = np.argwhere(self._open)
        self._number[self._open] = np.arange(len(self._cells))
        self._graph = self._connect()

    def _connect(self) -> coo_matrix:
        rows, cols, costs = [], [], []
        for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
            there = self._cells + np.array([dr, dc])
            inside = self.grid.contains(there)
            number = np.full(len(there), -1)
            number[inside] = self._number[there[inside, 0], there[inside, 1]]
            ok = number >= 0
            rows.append(np.flatnonzero(ok))
            cols.append(number[ok])
            costs.append(np.full(int(ok.sum()), math.hypot(dr, dc)))
        size = len(self._cells)
        parts = [np.concatenate(part) for part in (costs, rows, cols)]
        return coo_matrix((parts[0], (parts[1], parts[2])), shape=(size, size)).tocsr()

    def start(self, rng: np.random.Generator) -> SE2:
        """A random pose on the open floor connected with the spawn."""
        spawn = self._nearest(self.world.spawn.xy)
        reach = np.flatnonzero(np.isfinite(dijkstra(self._graph, directed=False, indices=spawn)))
        x, y = self.grid.center_of(self._cells[rng.choice(reach)])
        return SE2.from_xyt(x, y, rng.uniform(-math.pi, math.pi))

    def way(self, xy: Array, rng: np.random.Generator) -> list[Array]:
        """Points 0.3 m apart to a random place at least 3 m of way off (if there is one)."""
        distance, before = dijkstra(
            self._graph, directed=False, indices=self._nearest(xy), return_predecessors=True
        )
        reach = np.flatnonzero(np.isfinite(distance))
        far = reach[distance[reach] > 3.0 / self.grid.resolution]
        at = rng.choice(far if len(far) else reach)
        cells = []
        while at >= 0:
            cells.append(at)
            at = before[at]
        points = self.grid.center_of(self._cells[cells[::-1]])
        return [*points[6::6], points[-1]]

    def _nearest(self, xy: Array) -> int:
        return int(np.argmin(np.linalg.norm(self._cells - self.grid.cell_of(np.asarray(xy)), axis=1)))

    def drive(self, seed: int, seconds: float, start: SE2 | None = None) -> list[Sweep]:
        """Wander for a while from a random pose; steered by the truth, as a person who watches would."""
        rng = stream(seed, "wander")
        sweeps: list[Sweep] = []
        stamps: list[int] = []
        odometry: list[SE2] = []
        points: list[Array] = []
        v = w = 0.0
        limit = min(self.robot.model.max_v, 0.22)
        with Simulator(self.world, self.robot, self.sim, seed) as simulator:
            seen = simulator.reset(self.start(rng) if start is None else start)
            for _ in range(round(seconds * CONTROL_HZ)):
                stamps.append(seen.stamp_ns)
                odometry.append(seen.odometry.T_odom_base)
                if seen.scan is not None:
                    driven = Trajectory(np.array(stamps[-KEPT:]), SE2.stack(odometry[-KEPT:]))
                    at_start = driven.at(np.array([seen.scan.stamp_ns]))[0]
                    sweeps.append(Sweep(seen.scan, at_start, seen.odometry.T_odom_base, simulator.scan_truth))
                pose = simulator.truth.T_world_base
                while points and np.linalg.norm(points[0] - pose.xy) < 0.2:
                    points.pop(0)
                if not points:
                    points = self.way(pose.xy, rng)
                dx, dy = points[0] - pose.xy
                bearing = float(wrap(math.atan2(dy, dx) - pose.yaw))
                wanted = 0.0 if abs(bearing) > 0.6 else limit * (1.0 - abs(bearing) / 0.6)
                v += min(max(wanted - v, -0.02), 0.02)
                w += min(max(min(max(2.0 * bearing, -0.9), 0.9) - w, -0.1), 0.1)
                seen = simulator.step(Twist(v, w))
        return sweeps


def kidnapped(before: list[Sweep], after: list[Sweep]) -> list[Sweep]:
    """One drive, then another elsewhere, as if the robot were carried there with its wheels at rest."""
    T_odom_old = before[-1].T_odom_base_end @ after[0].T_odom_base.inverse()
    carried = [
        Sweep(s.scan, T_odom_old @ s.T_odom_base, T_odom_old @ s.T_odom_base_end, s.T_world_base)
        for s in after
    ]
    return before + carried
