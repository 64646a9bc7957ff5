"""The scans of a recording, whose points are made when needed, so that only those in use are in memory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.motion import sweep_motion
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.scans.clouds import Clouds, KeyScans, make_clouds
from turtlebag.pipeline.slam.scans.range_noise import RangeNoise, range_noise


@dataclass(frozen=True, eq=False)
class Scans:
    """The scans of a recording whose sensors are corrected, and what makes points and lines of them.

    Returns beyond `usable_m` are ignored; `noise` is the lidar's; `motion` (n, KNOTS) is the base's during
    each sweep, as `sweep_motion` gives it, None if a sweep is one instant or its motion is unknown.
    """

    recording: Recording
    usable_m: float
    noise: RangeNoise
    motion: SE2 | None

    @staticmethod
    def of(recording: Recording, usable_m: float) -> Scans:
        """The scans of a recording, by its own ranges and odometry."""
        return Scans(recording, usable_m, range_noise(recording, usable_m), sweep_motion(recording))

    def __len__(self) -> int:
        return len(self.recording)

    def clouds(self, numbers: NDArray[np.int64] | None = None) -> Clouds:
        """Points and lines of all scans, or of some (k,), numbered anew."""
        return make_clouds(self.recording, self.usable_m, self.motion, self.noise, numbers)

    def of_keys(self, keys: NDArray[np.int64]) -> KeyScans:
        """The key scans (k,), numbered as in the recording; all others are empty."""
        clouds, n = self.clouds(keys), len(self)
        counts, table = np.zeros(n, np.int64), np.full((n, clouds.table.shape[1]), -1, np.int32)
        counts[keys], table[keys] = np.diff(clouds.starts), clouds.table
        starts, sensor = np.concatenate([[0], np.cumsum(counts)]), self.recording.lidar_of
        return KeyScans(clouds._replace(starts=starts, table=table, sensor=sensor), keys)
