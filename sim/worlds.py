"""Worlds: YAML files of upright solids with a spawn pose, and the true map of each."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import get_args

import numpy as np

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import FREE, FREE_TO, OccupancyGrid
from turtlebag.datasets.maps import map_files
from turtlebag.datasets.number_text import decimals
from turtlebag.datasets.parts import find, is_own, source_files
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.trajectories import load_tum
from turtlebag.datasets.yaml_files import checked, find_named, known_names, read_mapping
from turtlebag.sim.clutter import cluttered
from turtlebag.sim.generators import GENERATORS, LIMITS, seeded
from turtlebag.sim.plans import load_plan, roomiest_place
from turtlebag.sim.raycast import first_with_room
from turtlebag.sim.sdf import load_sdf
from turtlebag.sim.shapes import Solid, contains, sections
from turtlebag.sim.world import World, WorldMaker
from turtlebag.sim.world_files import MOST_SHAPES, GeneratorSpec, Unknown, WorldSpec

TRAJECTORY = "trajectory.tum"
FOLDER = Path(__file__).parent / "worlds"
MARGIN_M = 0.5
"""Free border around the outermost solid in a true map."""
MOST_M2 = 160_000.0
"""Largest world: its true map has as many cells as can be read again."""


def load_world(name_or_path: str) -> World:
    """A built-in world by name or a YAML file by path; InputError for unknown names lists the known.

    Options of a world follow its name: `turtlebot3_house:gate=open`. Generated worlds are named by
    generator and seed: `maze:7`, `office:3`, `forest:5,density=0.5`. A .world or .sdf file is imported.
    A map yaml, which has the key `image`, is a world of its walls: `map.yaml:unknown=free,spawn=1/2/0`.
    `module:Class` or `module:Class:options` is a `WorldMaker` of the user's own.
    Any of them may be followed by `+clutter:SEED,boxes=3,movers=2`: things that no map of it shows.
    """
    base, plus, clutter = name_or_path.partition("+clutter:")
    if plus:
        return cluttered(load_world(base), clutter)
    name, _, settings = name_or_path.partition(":")
    if name.endswith((".world", ".sdf")):
        return _from_sdf(Path(name), settings)
    if name in GENERATORS:
        return _generated(name_or_path, name, settings)
    if name not in world_names() and not name.endswith((".yaml", ".yml")) and "/" not in name:
        if own := own_world(name_or_path):
            return _own(*own)
        raise InputError(
            f"unknown world '{name_or_path}'; known: {', '.join(world_names())}, "
            f"{', '.join(f'{generator}:SEED' for generator in GENERATORS)}, a .yaml, .world or .sdf file, "
            "a map's yaml, or your own class (module:Class)"
        )
    path = find_named(name, FOLDER, "world")
    data = read_mapping(path)
    if "generator" in data:
        given = checked(GeneratorSpec, data, where=str(path))
        settings = ",".join([str(given.seed), *(f"{key}={value}" for key, value in given.options.items())])
        return _generated(str(path), given.generator, settings)
    if "image" in data:
        return _from_map(path, settings)
    if "shapes" not in data:
        raise InputError(f"{path}: not a world file: it has no 'shapes'")
    spec = checked(WorldSpec, data, where=str(path))
    options = _chosen(spec, settings)
    shapes = [shape for shape in spec.shapes if all(options.get(k) == v for k, v in shape.when.items())]
    try:
        solids = tuple(shape.solid(path.parent) for shape in shapes)
        movers = tuple(mover.mover() for mover in spec.movers)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    return World(
        name=spec.name,
        robot=spec.robot,
        spawn=SE2.from_xyt(*spec.spawn),
        shapes=solids,
        bounds=_mappable(spec.bounds or bounds_of(solids, MARGIN_M), str(path)),
        keepout=tuple(np.array(outline, dtype=np.float64) for outline in spec.keepout),
        routes={name: np.array(points, dtype=np.float64) for name, points in spec.routes.items()},
        movers=movers,
    )


def own_world(name: str) -> tuple[str, str] | None:
    """`module:Class` and its options, if a world's name could be that of a user's class."""
    module, _, rest = name.partition("+clutter:")[0].partition(":")
    part, _, options = rest.partition(":")
    theirs = module in (*GENERATORS, *world_names()) or module.endswith((".yaml", ".yml", ".world", ".sdf"))
    return None if theirs or not is_own(f"{module}:{part}") else (f"{module}:{part}", options)


def own_files(world_name: str, robot_name: str | None) -> dict[str, Path]:
    """World and robot as a manifest's inputs, as far as they are files of the user's own."""
    if own := own_world(world_name):
        return source_files({"world": own[0]}) | own_files("", robot_name)
    named = {"world": world_name.partition("+clutter:")[0].partition(":")[0], "robot": robot_name or ""}
    files = {kind: Path(name) for kind, name in named.items() if Path(name).is_file()}
    return {**files, **_files_of_maps(files["world"])} if "world" in files else files


def _files_of_maps(world: Path) -> dict[str, Path]:
    """What a world file that is a map, or has maps among its shapes, reads besides."""
    data = read_mapping(world) if world.suffix in (".yaml", ".yml") else {}
    if "image" in data:
        start = world.parent / TRAJECTORY
        return {
            "world_image": map_files(world)["map_image"],
            **({"world_trajectory": start} if start.is_file() else {}),
        }
    if not isinstance(shapes := data.get("shapes"), list):
        return {}
    maps = [shape.get("file") for shape in shapes if isinstance(shape, dict) and shape.get("kind") == "map"]
    return {
        f"world_{kind}{number or ''}": path
        for number, file in enumerate(maps)
        for kind, path in map_files(world.parent / str(file)).items()
    }


def _own(part: str, options: str) -> World:
    """The world that a class of the user's makes."""
    maker: WorldMaker = find(part, WorldMaker)(options)
    world = maker.world()
    _mappable(world.bounds, world.name)
    return world


def _generated(where: str, name: str, settings: str) -> World:
    """World of a generator: settings are `SEED` and then `key=number` for its own parameters."""
    if name not in GENERATORS:
        raise InputError(f"{where}: unknown generator '{name}'; known: {', '.join(GENERATORS)}")
    generator = GENERATORS[name]
    limits = {key: LIMITS[key] for key in inspect.signature(generator).parameters if key != "seed"}
    seed, options = seeded(where, settings, limits)
    solids, spawn = generator(seed, **options)
    bounds = bounds_of(tuple(solids), MARGIN_M)
    label = f"{name}:{settings}"
    return World(label, "burger", SE2.from_xyt(*spawn), tuple(solids), bounds, (), {})


def _from_sdf(path: Path, settings: str) -> World:
    """A Gazebo world; `path:spawn=x/y/yaw` says where to start (default: the roomiest place near 0, 0)."""
    if not path.is_file():
        raise InputError(f"{path}: no such world file")
    key, _, value = settings.partition("=")
    if key not in ("", "spawn"):
        raise InputError(f"{path}: an SDF world has no option '{key}' (it has: spawn)")
    name, solids = load_sdf(path)
    if not solids:
        raise InputError(
            f"{path}: contains no static boxes, cylinders, spheres or meshes; "
            "for a world without obstacles use --world empty"
        )
    if len(solids) > MOST_SHAPES:
        raise InputError(f"{path}: {len(solids)} shapes; a world has at most {MOST_SHAPES}")
    bounds = _mappable(bounds_of(tuple(solids), 2.0), str(path))
    spawn = _spawn(path, value) or _roomy_place(solids, bounds)
    return World(path.stem if name == "default" else name, "burger", spawn, tuple(solids), bounds, (), {})


def _from_map(path: Path, settings: str) -> World:
    """The world of a map yaml. It starts where `spawn` says, else where the map's own drive did (a
    trajectory.tum beside it, if that is on free cells), else at the roomiest place."""
    keys = {"unknown": "solid", "spawn": ""}
    for setting in filter(None, settings.split(",")):
        key, _, value = setting.partition("=")
        if key not in keys:
            raise InputError(f"{path}: a map as a world has no option '{key}' (it has: unknown, spawn)")
        keys[key] = value
    if keys["unknown"] not in get_args(Unknown):
        raise InputError(f"{path}: unknown={keys['unknown']}: choose one of {', '.join(get_args(Unknown))}")
    plan = load_plan(path, path.stem, solid=keys["unknown"] == "solid")
    height, width = np.array(plan.grid.shape) * plan.grid.resolution
    corners = plan.grid.T_map_grid @ np.array([[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]])
    (x_min, y_min), (x_max, y_max) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
    bounds = _mappable((x_min, x_max, y_min, y_max), str(path))
    spawn = _spawn(path, keys["spawn"]) or _start_of(path, plan.grid) or roomiest_place(plan.grid)
    return World(path.stem, "burger", spawn, (plan,), bounds, (), {})


def _start_of(path: Path, grid: OccupancyGrid) -> SE2 | None:
    """Where the drive began that a map of ours was made from."""
    beside = path.parent / TRAJECTORY
    trajectory = load_tum(beside) if beside.is_file() else None
    if not trajectory or grid.value_at(trajectory.poses.xy[0]) not in range(FREE, FREE_TO + 1):
        return None
    return trajectory.poses[0]


def _spawn(path: Path, value: str) -> SE2 | None:
    """The pose that `spawn=x/y/yaw` says; None where it is not given."""
    try:
        spawn = SE2.from_xyt(*decimals(value.split("/"))) if value else None
    except (TypeError, ValueError):
        raise InputError(f"{path}: spawn={value}: expected x/y/yaw") from None
    if spawn is not None and not np.isfinite(spawn.xyt).all():
        raise InputError(f"{path}: spawn={value}: must be three finite numbers")
    return spawn


def _mappable(bounds: tuple[float, float, float, float], where: str) -> tuple[float, float, float, float]:
    """The bounds, or an InputError when a map of them is empty or beyond all memory."""
    width, depth = bounds[1] - bounds[0], bounds[3] - bounds[2]
    if not (width > 0.0 and depth > 0.0):
        raise InputError(f"{where}: bounds: x_min must be below x_max, and y_min below y_max")
    if not width * depth <= MOST_M2:
        raise InputError(f"{where}: {width:.3g} m x {depth:.3g} m is too large for a map")
    return bounds


def _roomy_place(solids: list[Solid], bounds: tuple[float, float, float, float]) -> SE2:
    """The place nearest to the origin with half a metre of room, else the one with the most."""
    outlines = sections(solids, 0.0, 0.5)
    x, y = np.meshgrid(np.arange(bounds[0], bounds[1], 0.1), np.arange(bounds[2], bounds[3], 0.1))
    points = np.vstack([np.zeros(2), np.stack([x.ravel(), y.ravel()], axis=-1)])
    points = points[np.argsort(np.hypot(*points.T), kind="stable")]
    points = points[~contains(solids, 0.2, points)]
    best = first_with_room(points, 0.5, outlines.segments, outlines.circles)
    return SE2.from_xyt(points[best, 0], points[best, 1], 0.0)


def _chosen(spec: WorldSpec, settings: str) -> dict[str, str]:
    """The world's options with `key=value,...` applied."""
    options = {key: values[0] for key, values in spec.options.items()}
    for setting in filter(None, settings.split(",")):
        key, _, value = setting.partition("=")
        values = spec.options.get(key)
        if values is None:
            known = ", ".join(options) or "none"
            raise InputError(f"world {spec.name} has no option '{key}' (it has: {known})")
        if value not in values:
            raise InputError(f"world {spec.name}: {key}={value}: choose one of {', '.join(values)}")
        options[key] = value
    return options


def world_names() -> list[str]:
    """Names of the built-in worlds."""
    return known_names(FOLDER)


def bounds_of(solids: tuple[Solid, ...], margin: float) -> tuple[float, float, float, float]:
    """(x_min, x_max, y_min, y_max) around solids; 10 m about the origin when there are none."""
    if not solids:
        return -10.0, 10.0, -10.0, 10.0
    each = np.array([solid.bounds() for solid in solids])
    return (
        float(each[:, 0].min() - margin),
        float(each[:, 1].max() + margin),
        float(each[:, 2].min() - margin),
        float(each[:, 3].max() + margin),
    )
