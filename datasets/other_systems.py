"""The output of another SLAM system for a recording: its trajectory, its map or both, under one name."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass as pydantic_dataclass

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.maps import load_map, map_files
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.se3 import inverse, lifted
from turtlebag.datasets.trajectories_3d import Trajectory3D, read_trajectory_3d
from turtlebag.datasets.types import Stamps

OURS, TRUTH = "TurtleBag", "truth"
"""What we are called among systems, and what they are measured by."""
FEWEST = 3
"""Poses that a trajectory must have to be laid on another."""
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_+-]*")
PATHS = ("trajectory", "map", "times")
"""What another system may have a file of."""
IMAGES = (".pgm", ".png", ".bmp", ".jpg", ".jpeg")
LONGEST_S = 4e9
OPTICAL = np.array([[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""From a camera's axes (x right, y down, z forward) to a robot's (x forward, y left, z up)."""
CLIMB_M = 1.0
"""No robot on wheels climbs this far, and half as far as it drives."""


def kind_of(path: Path) -> str:
    """Which field of `SystemFiles` a file belongs to, by its name: a map's is YAML."""
    return "map" if path.suffix in (".yaml", ".yml") else "trajectory"


def require_name(name: str) -> None:
    """InputError for what is no name of a system."""
    if not NAME.fullmatch(name):
        raise InputError(f"{name!r}: a system's name may contain only letters, digits, - and _")


@pydantic_dataclass(frozen=True)
class SystemFiles:
    """Files of another system. `base` (x, y [m], yaw [rad]) is where on the robot sits what its trajectory
    tracks; `shift_s` is added to its stamps; `times` are the stamps of a KITTI file.

    InputError for a name that is none or is taken, and for what needs a trajectory that is not there.
    """

    name: str
    trajectory: Path | None = None
    map: Path | None = None
    times: Path | None = None
    base: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shift_s: float = 0.0

    def __post_init__(self) -> None:
        require_name(self.name)
        if self.name in (OURS, TRUTH):
            raise InputError(f"{self.name}: this name is taken; give this system another one")
        if self.trajectory is None and (self.map is None or self.times or self.shift_s or self.moved):
            raise InputError(f"{self.name} has no trajectory")
        if not abs(self.shift_s) < LONGEST_S:
            raise InputError(f"{self.name}: cannot be shifted by {self.shift_s:g} s")

    @property
    def paths(self) -> dict[str, Path | None]:
        """Its files by kind."""
        return {what: getattr(self, what) for what in PATHS}

    @property
    def moved(self) -> bool:
        """Whether it tracks anything but the base."""
        return any(self.base)

    def inputs(self) -> dict[str, Path]:
        """All files that are read, by kind."""
        files = {what: path for what, path in self.paths.items() if path is not None and what != "map"}
        return files | (map_files(self.map) if self.map is not None else {})


@dataclass(frozen=True, eq=False)
class System:
    """Base poses and map of one system, in its own frame; `notes` list the corrections made while reading."""

    name: str
    track: Trajectory3D | None
    grid: OccupancyGrid | None
    notes: tuple[str, ...] = ()


def load_system(files: SystemFiles, scans_ns: Stamps) -> System:
    """Read another system's files; `scans_ns` are the stamps of the scans. InputError if they are invalid."""
    for what, path in files.paths.items():
        if path is not None and path.is_dir():
            raise InputError(f"{path}: is a folder; give the file of the {what} in it")
        if path is not None and path.suffix.lower() in IMAGES:
            raise InputError(f"{path}: is a map's image; give the map's YAML file")
    grid = None if files.map is None else load_map(files.map)
    if files.trajectory is None:
        return System(files.name, None, grid)
    read = read_trajectory_3d(files.trajectory, files.times, scans_ns)
    if len(read) < FEWEST:
        raise InputError(
            f"{files.trajectory}: too few poses to compare ({len(read)}; at least {FEWEST} are needed)"
        )
    notes = []
    shift_ns = round(files.shift_s * 1e9)
    track = replace(read, stamps_ns=read.stamps_ns + shift_ns).in_time()
    if shift_ns:
        notes.append(f"Its stamps were shifted by {files.shift_s:g} s, as requested.")
    if len(track) < len(read):
        notes.append(f"{len(read) - len(track)} of its poses repeat a stamp and were left out.")
    if _looks_through_a_camera(track):
        track = replace(track, T=OPTICAL @ track.T @ inverse(OPTICAL))
        notes.append(
            "Its z axis points forward, as a camera's does: its poses were rotated to a robot's axes."
        )
    if files.moved:
        track = replace(track, T=track.T @ inverse(lifted(SE2.from_xyt(*files.base))))
        x, y, yaw = files.base
        notes.append(f"It tracks a point at {x:g}, {y:g} m, {yaw:g} rad on the robot; moved to the base.")
    return System(files.name, track, grid, tuple(notes))


def _looks_through_a_camera(track: Trajectory3D) -> bool:
    extent = np.ptp(track.T[:, :3, 3], axis=0)
    return bool(extent[2] > CLIMB_M and extent[2] > 0.5 * extent[:2].max())


def gaps(stamps_ns: Stamps) -> list[tuple[int, int]]:
    """Stretches between successive stamps (increasing) that are much longer than usual: (begin, end) [ns]."""
    steps = np.diff(stamps_ns)
    if not len(steps):
        return []
    wide = np.flatnonzero(steps > max(2_000_000_000, 5 * int(np.median(steps))))
    return [(int(stamps_ns[k]), int(stamps_ns[k + 1])) for k in wide]


def covered(wanted_ns: Stamps, stamps_ns: Stamps) -> NDArray[np.bool_]:
    """Which stamps are within the time span of others (increasing), except in their gaps."""
    inside = (wanted_ns >= stamps_ns[0]) & (wanted_ns <= stamps_ns[-1])
    for begin, end in gaps(stamps_ns):
        inside &= (wanted_ns <= begin) | (wanted_ns >= end)
    return np.asarray(inside)


def coverage(stamps_ns: Stamps, begin_ns: int, end_ns: int) -> float:
    """Share of a time span in which there are poses, without gaps."""
    first, last = max(int(stamps_ns[0]), begin_ns), min(int(stamps_ns[-1]), end_ns)
    missing = sum(max(min(b, last) - max(a, first), 0) for a, b in gaps(stamps_ns))
    covered = seconds(max(last - first - missing, 0))
    return covered / max(seconds(end_ns - begin_ns), 1e-9) if end_ns > begin_ns else 1.0
