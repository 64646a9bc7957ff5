"""The options of a session: world, robot, map and seed, or a bag."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from turtlebag.datasets.bags.footprint import footprint_of
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.maps import map_files
from turtlebag.datasets.outputs import sha256_file, sha256_tree
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.navigation.config import NavigateConfig
from turtlebag.pipeline.slam.graph.edits import Edits
from turtlebag.pipeline.slam.mapper import SlamConfig
from turtlebag.pipeline.studio.journal import BagHeader, Header
from turtlebag.pipeline.studio.view import Scene
from turtlebag.sim.robots import RobotSpec, load_robot
from turtlebag.sim.simulator import SimConfig
from turtlebag.sim.world import World
from turtlebag.sim.worlds import load_world, own_files

ROBOT_M = 0.2
"""Radius of the disc that stands for a robot of unknown shape."""


@dataclass(frozen=True, eq=False)
class StudioSetup:
    """Names or files of world and robot, a seed, and a map if there is one.

    InputError, where something is first looked up, for unknown names and files that cannot be read.
    """

    world: str
    robot: str | None = None
    seed: int = 0
    map_path: Path | None = None
    sim: SimConfig = field(default_factory=SimConfig)

    @cached_property
    def arena(self) -> World:
        """The world."""
        return load_world(self.world)

    @cached_property
    def robot_name(self) -> str:
        """Name or file of the robot; the world's own where none was given."""
        return self.robot or self.arena.robot

    @cached_property
    def spec(self) -> RobotSpec:
        """The robot."""
        return load_robot(self.robot_name)

    @cached_property
    def config(self) -> NavigateConfig:
        """The resolved settings."""
        return NavigateConfig(sim=self.sim.resolved(self.spec))

    @cached_property
    def files(self) -> dict[str, Path]:
        """World, robot and map, as far as they are files of the user's own."""
        own = own_files(self.world, self.robot_name)
        return own if self.map_path is None else {**own, **map_files(self.map_path)}

    def scene(self) -> Scene:
        """The frame of the picture."""
        return Scene.of(self.arena, self.spec, self.seed)

    def header(self) -> Header:
        """What its session file begins with."""
        return Header(
            world=_absolute(self.world),
            robot=_absolute(self.robot_name),
            seed=self.seed,
            map=None if self.map_path is None else str(self.map_path.resolve()),
            sha256={kind: sha256_file(path) for kind, path in self.files.items()},
            sim=self.sim,
        )


@dataclass(frozen=True, eq=False)
class BagSetup:
    """A bag or log to be played. InputError, where it is first looked at, when it cannot be mapped."""

    bag: Path
    config: SlamConfig = field(default_factory=SlamConfig)
    """How the whole bag is mapped."""
    edits: Edits = Edits()  # noqa: RUF009 (frozen)
    """Those of an earlier session."""

    @cached_property
    def recording(self) -> Recording:
        """Its scans and odometry."""
        recording = load_recording(self.bag)
        if len(recording) == 0:
            raise InputError(f"{self.bag}: no scans to play")
        return recording

    @property
    def files(self) -> dict[str, Path]:
        """What is read."""
        return {"bag": self.bag}

    def header(self) -> BagHeader:
        """What its session file begins with."""
        return BagHeader(bag=str(self.bag.resolve()), sha256=sha256_tree(self.bag), edits=self.edits)

    def scene(self) -> Scene:
        """The frame of the picture: where the odometry went, and what the lidar may have seen from there."""
        recording, outline = self.recording, footprint_of(self.bag)
        xy = np.zeros((1, 2)) if recording.T_odom_base is None else recording.T_odom_base.xy
        reach = min(recording.lidar.range_max, 5.0)
        (x_min, y_min), (x_max, y_max) = xy.min(axis=0) - reach, xy.max(axis=0) + reach
        if outline is None:
            around = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
            outline = ROBOT_M * np.column_stack([np.cos(around), np.sin(around)])
        return Scene(
            world=self.bag.name,
            bounds=(float(x_min), float(y_min), float(x_max), float(y_max)),
            outline=outline,
        )


def _absolute(name: str) -> str:
    """The name of a file, which options may follow, from wherever it is read."""
    file = name.partition("+clutter:")[0].partition(":")[0]
    return str(Path(file).resolve()) + name[len(file) :] if Path(file).is_file() else name


def setup_of(header: Header | BagHeader, where: Path) -> StudioSetup | BagSetup:
    """The setup that a session file names; InputError when a file is missing or is not what it was."""
    if isinstance(header, BagHeader):
        bag = BagSetup(Path(header.bag), edits=header.edits)
        if not bag.bag.exists() or bag.header().sha256 != header.sha256:
            raise InputError(f"{where}: bag {header.bag}: has changed since the session; use the original")
        return bag
    path = None if header.map is None else Path(header.map)
    setup = StudioSetup(header.world, header.robot, header.seed, path, header.sim)
    now = setup.header().sha256
    for kind, sha256 in header.sha256.items():
        if sha256 != now.get(kind):
            name = setup.files.get(kind, kind)
            raise InputError(f"{where}: {kind} {name}: has changed since the session; use the original file")
    return setup
