"""Where drivers publish: to the bag that is open, if one is, and to whoever draws."""

from __future__ import annotations

from collections.abc import Sequence

from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Cloud, Observation, Twist
from turtlebag.pipeline.navigation.recorder import NoBag


class Tee(BagWriter):
    """Passes everything on to `bag`, and remembers the newest map and plan."""

    def __init__(self) -> None:
        self.bag: BagWriter = NoBag()
        self.grid: OccupancyGrid | None = None
        """The newest map."""
        self.path: SE2 | None = None
        """The newest plan, (n,) in the frame of whoever planned it."""

    def static_transforms(
        self, stamp_ns: int, links: Sequence[tuple[str, str, tuple[float, float, float], float]]
    ) -> None:
        """As the bag's."""
        self.bag.static_transforms(stamp_ns, links)

    def observation(self, observation: Observation) -> None:
        """As the bag's."""
        self.bag.observation(observation)

    def cloud(self, log_time_ns: int, stamp_ns: int, cloud: Cloud, frame: str) -> None:
        """As the bag's."""
        self.bag.cloud(log_time_ns, stamp_ns, cloud, frame)

    def truth(self, stamp_ns: int, T_world_base: SE2, twist: Twist) -> None:
        """As the bag's."""
        self.bag.truth(stamp_ns, T_world_base, twist)

    def command(self, stamp_ns: int, twist: Twist) -> None:
        """As the bag's."""
        self.bag.command(stamp_ns, twist)

    def owner(self, stamp_ns: int, owner: str) -> None:
        """As the bag's."""
        self.bag.owner(stamp_ns, owner)

    def map(self, stamp_ns: int, grid: OccupancyGrid) -> None:
        """As the bag's."""
        self.grid = grid
        self.bag.map(stamp_ns, grid)

    def amcl_pose(self, stamp_ns: int, T_map_base: SE2, covariance: Array) -> None:
        """As the bag's."""
        self.bag.amcl_pose(stamp_ns, T_map_base, covariance)

    def map_to_odom(self, stamp_ns: int, T_map_odom: SE2) -> None:
        """As the bag's."""
        self.bag.map_to_odom(stamp_ns, T_map_odom)

    def particles(self, stamp_ns: int, T_map_base: SE2) -> None:
        """As the bag's."""
        self.bag.particles(stamp_ns, T_map_base)

    def plan(self, stamp_ns: int, T_map_base: SE2) -> None:
        """As the bag's."""
        self.path = T_map_base
        self.bag.plan(stamp_ns, T_map_base)

    def goal(self, stamp_ns: int, T_map_goal: SE2) -> None:
        """As the bag's."""
        self.bag.goal(stamp_ns, T_map_goal)
