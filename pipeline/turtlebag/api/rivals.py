"""Other systems in Python: their files, and what has to be known of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from turtlebag.api.making import PathLike, Pose, in_a_line, path_if, path_of, pose_of, pose_text
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.parts import told_kind
from turtlebag.datasets.rivals import RivalFiles, kind_of
from turtlebag.datasets.se2 import SE2


@dataclass(frozen=True, eq=False)
class Rival:
    """What another system made of a recording: a trajectory (TUM, KITTI, EuRoC csv), a map's YAML, or both.

    `times` is the file with the times of KITTI poses. `base` is where on the robot sits what it tracks (a
    camera, say). `shift` is added to its stamps [s].
    """

    trajectory: PathLike | None = None
    map: PathLike | None = None
    times: PathLike | None = None
    base: Pose | None = None
    shift: float = 0.0


Rivals = Mapping[str, Rival | PathLike]
"""Rivals by their names; one of which there is nothing but a file may be its path."""


def rival_files(rivals: Rivals | None) -> list[RivalFiles]:
    """Their files; InputError for what is none."""
    if not isinstance(rivals, Mapping | None):
        said = 'expected a mapping such as {"other": "poses.tum"}'
        raise InputError(f"rivals: {said}, not {told_kind(rivals)}")
    return [_files(str(name), rival) for name, rival in (rivals or {}).items()]


def rival_options(files: list[RivalFiles]) -> tuple[list[str], dict[str, list[str]]]:
    """NAME=FILE of every file, and the options of the command line that say the rest."""
    words = [f"{one.name}={path}" for one in files for path in (one.trajectory, one.map) if path is not None]
    return words, {
        "rival_base": [f"{one.name}={pose_text(one.T_base_sensor)}" for one in files if one.moved],
        "rival_times": [f"{one.name}={one.times}" for one in files if one.times is not None],
        "rival_shift": [f"{one.name}={one.shift_s!r}" for one in files if one.shift_s],
    }


def _files(name: str, rival: Any) -> RivalFiles:
    if not isinstance(rival, Rival):
        path = path_of(rival, f"rivals {name}")
        return RivalFiles(name, **{kind_of(path): path})  # type: ignore[arg-type]
    return RivalFiles(
        name,
        path_if(rival.trajectory, f"rivals {name} trajectory"),
        path_if(rival.map, f"rivals {name} map"),
        path_if(rival.times, f"rivals {name} times"),
        SE2.identity() if rival.base is None else pose_of(rival.base, f"rivals {name} base"),
        _seconds(rival.shift, f"rivals {name} shift"),
    )


def _seconds(value: Any, what: str) -> float:
    if not isinstance(value, int | float | np.number) or not math.isfinite(value):
        raise InputError(f"{what}: expected a number of seconds, not {in_a_line(value)}")
    return float(value)
