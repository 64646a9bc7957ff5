"""Other systems' results in Python: their files, and how to read them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from turtlebag.api.given import PathLike, Pose
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.other_systems import require_name


@dataclass(frozen=True, eq=False)
class System:
    """Another system's result for a recording: a trajectory (TUM, KITTI, EuRoC csv), a map's YAML, or both.

    `times` is the file with the times of KITTI poses. `base` is the pose on the robot of what it tracks, such
    as a camera. `shift` is added to its stamps [s].
    """

    trajectory: PathLike | None = None
    map: PathLike | None = None
    times: PathLike | None = None
    base: Pose | None = None
    shift: float = 0.0


Systems = Mapping[str, System | PathLike]
"""Other systems by their names; one with only a file may be given as its path."""


def fields_of(systems: Systems | None) -> tuple[list[tuple[str, PathLike]], dict[str, Any]]:
    """The files with the systems' names, and the fields of a request that say the rest; InputError for a
    system without files."""
    files: list[tuple[str, PathLike]] = []
    rest: dict[str, list[tuple[str, Any]]] = {"system_base": [], "system_times": [], "system_shift": []}
    for name, entry in (systems or {}).items():
        require_name(str(name))
        one = entry if isinstance(entry, System) else System(entry)
        held = [file for file in (one.trajectory, one.map) if file is not None]
        if not held:
            raise InputError(f"{name} has no trajectory")
        files += [(name, file) for file in held]
        for option, value in (("base", one.base), ("times", one.times), ("shift", one.shift or None)):
            rest[f"system_{option}"] += [] if value is None else [(name, value)]
    return files, rest
