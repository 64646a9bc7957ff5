"""Load any recording: ROS 1 and 2 bags, record folders and CARMEN logs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from turtlebag.datasets.bags.mapping_input import read_for_mapping
from turtlebag.datasets.bags.plausibility import ARM_M
from turtlebag.datasets.bags.source import is_bag, open_bag
from turtlebag.datasets.carmen import is_carmen, parse_carmen
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.files import read_unpacked
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Recording


def load_recording(
    path: Path, *, T_base_lidar: SE2 | None = None, upside_down: bool = False, topic: str | Sequence[str] = ()
) -> Recording:
    """Read any input: a record's folder, a rosbag2 folder, .mcap, .db3, .bag or a CARMEN log (.gz, .bz2 too).

    `T_base_lidar` and with it `upside_down` override what the input says of the laser's place on the robot,
    `topic` names the scans of a bag that has several. Truth topics are never read. InputError when there is
    nothing to map with, or the laser would sit further from the robot than any does.
    """
    if T_base_lidar is not None and (arm := math.hypot(*T_base_lidar.xy)) > ARM_M:
        told = ",".join(f"{value:g}" for value in T_base_lidar.xyt)
        raise InputError(f"--laser {told}: {arm:.4g} m from the robot's centre; X and Y are metres")
    recording = _read(path, T_base_lidar, topic)
    if T_base_lidar is None or not upside_down:
        return recording
    note = "the laser is mounted upside down; its scans were flipped"
    return replace(recording, lidar=recording.lidar.turned_over(), notes=(*recording.notes, note))


def _read(path: Path, T_base_lidar: SE2 | None, topic: str | Sequence[str]) -> Recording:
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if path.is_dir() or is_bag(path):
        return read_for_mapping(open_bag(path), T_base_lidar=T_base_lidar, topic=topic)
    content, problem = read_unpacked(path)
    if is_carmen(content):
        notes = [problem] if problem else []
        return parse_carmen(content, path, T_base_lidar=T_base_lidar, notes=notes)
    try:
        return read_for_mapping(open_bag(path), T_base_lidar=T_base_lidar, topic=topic)
    except InputError as error:
        if "not a bag" in str(error):
            kinds = ".mcap, .db3, .bag, a rosbag2 folder or a CARMEN log"
            raise InputError(f"{path}: not a recording; expected {kinds}") from None
        raise
