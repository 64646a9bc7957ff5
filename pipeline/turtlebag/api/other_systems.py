"""Other systems' results in Python: their files, and how to read them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from turtlebag.api import given
from turtlebag.api.given import PathLike, Pose
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.other_systems import require_name
from turtlebag.datasets.parts import told_kind


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


def system_options(systems: Systems | None) -> tuple[list[str], dict[str, list[str]], dict[str, Path]]:
    """NAME=FILE of every file, the options of the command line that say the rest, and the files by what they
    are; InputError for what is none."""
    if not isinstance(systems, Mapping | None):
        said = 'expected a mapping such as {"other": "poses.tum"}'
        raise InputError(f"systems: {said}, not {told_kind(systems)}")
    words: list[str] = []
    known: dict[str, list[str]] = {"system_base": [], "system_times": [], "system_shift": []}
    read: dict[str, Path] = {}
    for name, entry in (systems or {}).items():
        require_name(str(name))
        what = f"systems {name}"
        one = entry if isinstance(entry, System) else System(given.path(entry, what))
        files = {kind: getattr(one, kind) for kind in ("trajectory", "map", "times")}
        found = {k: given.path(file, f"{what} {k}") for k, file in files.items() if file is not None}
        if not found.keys() & {"trajectory", "map"}:
            raise InputError(f"{name} has no trajectory")
        read |= {f"{what} {kind}": path for kind, path in found.items()}
        known["system_times"] += [f"{name}={found.pop('times')}"] if "times" in found else []
        words += [f"{name}={path}" for path in found.values()]
        if one.base is not None:
            known["system_base"].append(f"{name}={given.pose_text(given.pose(one.base, f'{what} base'))}")
        if shift := given.number(one.shift, f"{what} shift", "a number of seconds"):
            known["system_shift"].append(f"{name}={shift!r}")
    return words, known, read
