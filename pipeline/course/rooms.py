"""The worlds of the lessons, and what a lidar sees in the arena."""

from __future__ import annotations

from functools import cache

import numpy as np
from matplotlib.axes import Axes
from scipy.ndimage import distance_transform_edt

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.seeds import stream
from turtlebag.sim.lidar import Lidar, LidarConfig
from turtlebag.sim.robots import load_robot
from turtlebag.sim.worlds import load_world

WORLD, ROBOT = "turtlebot3_world", "burger"
HOUSE = "turtlebot3_house"
NOISE_M = 0.01
CELL_M = 0.05


@cache
def true_map(name: str = WORLD) -> OccupancyGrid:
    """The walls of a world at the height of the lidar."""
    world = load_world(name)
    return world.rasterize(load_robot(world.robot).lidar_height, CELL_M)


@cache
def clearance(name: str = WORLD) -> Array:
    """Distance of each free cell to the nearest one that is not [m], (rows, cols)."""
    return distance_transform_edt(true_map(name).cells == 0) * CELL_M


@cache
def _lidar() -> Lidar:
    config = LidarConfig(turning=False, noise="none")
    return Lidar(load_world(WORLD).shapes, load_robot(ROBOT), config, stream(0, "lidar"))


def angles() -> Array:
    """Directions of the beams at the robot [rad], (n_beams,)."""
    return _lidar().spec.angles


def true_ranges(pose: Array) -> Array:
    """Ranges (n_beams,) [m] without noise, inf where nothing is seen. The lidar sits at the base here."""
    T = SE2.from_array(pose) @ load_robot(ROBOT).T_base_lidar.inverse()
    ranges = _lidar().true_ranges(T.xyt[None])[0]
    return np.where(ranges < _lidar().spec.range_max, ranges, np.inf)


def points(pose: Array, rng: np.random.Generator) -> Array:
    """What the lidar sees from a pose, (n, 2) points at the robot [m], with noise."""
    ranges = true_ranges(pose)
    noisy = ranges + NOISE_M * rng.standard_normal(len(ranges))
    seen = np.isfinite(ranges)
    return noisy[seen, None] * np.stack([np.cos(angles()), np.sin(angles())], axis=-1)[seen]


def room_at(xy: Array) -> float:
    """Distance to the nearest wall [m]; 0 off the map."""
    cell = true_map().cell_of(xy)
    return float(clearance()[tuple(cell)]) if true_map().contains(cell) else 0.0


def draw_map(axes: Axes, name: str = WORLD) -> None:
    """The walls, in grey, and a frame around them."""
    grid = true_map(name)
    axes.imshow(
        grid.cells == 100,
        cmap="Greys",
        vmax=2.0,
        origin="lower",
        extent=grid.extent(),
        interpolation="nearest",
    )
    walls = grid.center_of(np.argwhere(grid.cells == 100))
    (x_min, y_min), (x_max, y_max) = walls.min(axis=0) - 0.3, walls.max(axis=0) + 0.3
    axes.set_xlim(x_min, x_max)
    axes.set_ylim(y_min, y_max)
    axes.grid(False)


def free_pose(rng: np.random.Generator, room_m: float = 0.3, name: str = WORLD) -> Array:
    """A random pose with that much room around it, (3,)."""
    free = np.argwhere(clearance(name) > room_m)
    x, y = true_map(name).center_of(free[rng.integers(len(free))])
    return np.array([x, y, rng.uniform(-np.pi, np.pi)])


def drive(rng: np.random.Generator, steps: int, step_m: float = 0.1) -> Array:
    """A path from a random place: ahead where there is room, else turning, (steps + 1, 3)."""
    poses, turn = [free_pose(rng)], float(rng.choice([-0.3, 0.3]))
    for _ in range(steps):
        ahead = SE2.from_array(poses[-1]) @ SE2.from_xyt(step_m, 0.0, rng.normal(0.0, 0.1))
        further = SE2.from_array(poses[-1]) @ np.array([0.25, 0.0])
        clear = room_at(ahead.xy) > 0.2 and room_at(further) > 0.2
        poses.append(ahead.xyt if clear else (SE2.from_array(poses[-1]) @ SE2.from_xyt(0.0, 0.0, turn)).xyt)
    return np.array(poses)


def noisy_steps(path: Array, rng: np.random.Generator) -> Array:
    """The motions of a path (n, 3) as wheels would measure them, (n - 1, 3)."""
    steps = SE2.from_array(path).steps()
    size = np.abs(steps[:, :1]) + 0.3 * np.abs(steps[:, 2:])
    return steps * 1.03 + size * rng.normal(0.0, [0.08, 0.03, 0.1], steps.shape)
