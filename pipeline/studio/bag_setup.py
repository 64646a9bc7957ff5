"""What playing a bag begins with."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import sha256_tree
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.studio.journal import BagHeader
from turtlebag.pipeline.studio.view import Scene
from turtlebag.sim.simulator import CONTROL_HZ

ROBOT_M = 0.2
"""Radius of the disc that stands for a robot of unknown shape."""


@dataclass(frozen=True, eq=False)
class BagSetup:
    """A bag or log to be played. InputError, where it is first looked at, when it cannot be mapped."""

    bag: Path

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
        return BagHeader(bag=str(self.bag.resolve()), sha256=sha256_tree(self.bag))


def scene_of(bag: Path, recording: Recording) -> Scene:
    """The frame of the picture: where the odometry went, and what the lidar may have seen from there."""
    around = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    xy = np.zeros((1, 2)) if recording.T_odom_base is None else recording.T_odom_base.xy
    reach = min(recording.lidar.range_max, 5.0)
    (x_min, y_min), (x_max, y_max) = xy.min(axis=0) - reach, xy.max(axis=0) + reach
    return Scene(
        world=bag.name,
        robot="",
        seed=0,
        control_hz=CONTROL_HZ,
        max_v=0.0,
        max_w=0.0,
        bounds=(float(x_min), float(y_min), float(x_max), float(y_max)),
        outline=ROBOT_M * np.column_stack([np.cos(around), np.sin(around)]),
        world_segments=np.zeros((0, 4)),
        world_circles=np.zeros((0, 3)),
    )
