"""Where drivers publish: to the open bag, if there is one, and to the display."""

from __future__ import annotations

from collections.abc import Callable

from turtlebag.datasets.bags.cdr import Layout
from turtlebag.datasets.bags.writer import BagWriter, Fields
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Observation


class Publisher(BagWriter):
    """Passes every message on to `bag`, if it is open, and remembers the newest map and plan."""

    def __init__(self) -> None:
        self.bag: BagWriter | None = None
        self.grid: OccupancyGrid | None = None
        """The newest map."""
        self.path: SE2 | None = None
        """The newest plan, (n,) in its planner's frame."""

    def observation(self, observation: Observation) -> None:
        """As a bag's, with the cloud."""
        super().observation(observation)
        if observation.cloud is not None:
            self.cloud(observation.stamp_ns, *observation.cloud, "lidar_3d")

    def map(self, stamp_ns: int, grid: OccupancyGrid) -> None:
        """As a bag's."""
        self.grid = grid
        super().map(stamp_ns, grid)

    def plan(self, stamp_ns: int, T_map_base: SE2) -> None:
        """As a bag's."""
        self.path = T_map_base
        super().plan(stamp_ns, T_map_base)

    def _write(
        self, topic: str, log_time_ns: int, make: Callable[[*Fields], bytes] | Layout, *fields: *Fields
    ) -> None:
        if self.bag is not None:
            self.bag._write(topic, log_time_ns, make, *fields)
