"""Where drivers publish: to the open bag, if there is one, and to the display."""

from __future__ import annotations

from typing import Any

from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Observation
from turtlebag.pipeline.navigation.recorder import NoBag


class _Passed:
    """A method of the bag that is open."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, publisher: Publisher, owner: type) -> Any:
        return getattr(publisher.bag, self._name)


class Publisher(BagWriter):
    """Passes everything on to `bag`, and remembers the newest map and plan."""

    static_transforms = _Passed()
    cloud = _Passed()
    truth = _Passed()
    command = _Passed()
    owner = _Passed()
    amcl_pose = _Passed()
    map_to_odom = _Passed()
    particles = _Passed()
    goal = _Passed()

    def __init__(self) -> None:
        self.bag: BagWriter = NoBag()
        self.grid: OccupancyGrid | None = None
        """The newest map."""
        self.path: SE2 | None = None
        """The newest plan, (n,) in its planner's frame."""

    def observation(self, observation: Observation) -> None:
        """As the bag's, with the cloud."""
        self.bag.observation(observation)
        if observation.cloud is not None:
            self.bag.cloud(observation.stamp_ns, *observation.cloud, "lidar_3d")

    def map(self, stamp_ns: int, grid: OccupancyGrid) -> None:
        """As the bag's."""
        self.grid = grid
        self.bag.map(stamp_ns, grid)

    def plan(self, stamp_ns: int, T_map_base: SE2) -> None:
        """As the bag's."""
        self.path = T_map_base
        self.bag.plan(stamp_ns, T_map_base)
