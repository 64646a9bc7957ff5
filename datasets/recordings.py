"""One door for every recorded input: bags of ROS 1 and 2, record folders and CARMEN logs."""

from __future__ import annotations

from pathlib import Path

from datasets.carmen import is_carmen, parse_carmen
from datasets.errors import InputError
from datasets.files import read_unpacked
from datasets.se2 import SE2
from datasets.types import Recording


def load_recording(path: Path, *, T_base_lidar: SE2 | None = None) -> Recording:
    """Read any input: a record's folder, a rosbag2 folder, .mcap, .db3, .bag or a CARMEN log (.gz, .bz2 too).

    `T_base_lidar` overrides what the input says of the laser's place on the robot. Truth topics are
    never read. InputError when there is nothing to map with.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if path.is_dir():
        raise InputError(f"{path}: not a bag or log")
    content, problem = read_unpacked(path)
    notes = [problem] if problem else []
    if is_carmen(content):
        return parse_carmen(content, path, T_base_lidar=T_base_lidar, notes=notes)
    raise InputError(f"{path}: neither a bag (.mcap, .db3, .bag, rosbag2 folder) nor a CARMEN log")
