"""The recording that a request names, with what a person says of it, and poses of its options."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from turtlebag.datasets.files import unchanged
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.stages.requests.maps import LocaliseRequest, MapRequest
from turtlebag.pipeline.stages.requests.options import XYT
from turtlebag.pipeline.stages.requests.robots import IdentifyRequest, TwinRequest

Word = TypeVar("Word")


def recording_of(
    request: MapRequest | LocaliseRequest | IdentifyRequest | TwinRequest, path: Path | None = None
) -> Recording:
    """The planar scans of its source, or of another file of the same robot; InputError when there are none,
    or the file changes while it is read.

    `laser` overrides how the file says the laser sits on the robot, `topic` names the scans of a bag: without
    it they are those of all lidars that have transforms, of /scan or of the only LaserScan topic.
    """
    path, laser = path or request.source, request.laser
    T_base_lidar, over = (None, False) if laser is None else (laser.T_base_lidar, laser.upside_down)
    with unchanged(path):
        return load_recording(path, T_base_lidar=T_base_lidar, upside_down=over, topic=request.topic)


def pose_or_word(pose: XYT | Word) -> SE2 | Word:
    """The pose that an option says, or the word that stands in its place."""
    return SE2.from_xyt(*pose) if isinstance(pose, tuple) else pose
