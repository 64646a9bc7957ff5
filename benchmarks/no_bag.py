"""A bag that forgets: campaigns keep the numbers of an episode, not its messages."""

from __future__ import annotations

from collections.abc import Sequence

from datasets.grid import OccupancyGrid
from datasets.se2 import SE2, Array
from datasets.types import Observation, Twist


class NoBag:
    """Takes everything that a bag would record, and forgets it."""

    def static_transforms(
        self, stamp_ns: int, links: Sequence[tuple[str, str, tuple[float, float, float], float]]
    ) -> None:
        """Forgotten, as everything here."""

    def observation(self, observation: Observation) -> None:
        """Forgotten."""

    def truth(self, stamp_ns: int, T_world_base: SE2, twist: Twist) -> None:
        """Forgotten."""

    def command(self, stamp_ns: int, twist: Twist) -> None:
        """Forgotten."""

    def owner(self, stamp_ns: int, owner: str) -> None:
        """Forgotten."""

    def map(self, stamp_ns: int, grid: OccupancyGrid) -> None:
        """Forgotten."""

    def amcl_pose(self, stamp_ns: int, T_map_base: SE2, covariance: Array) -> None:
        """Forgotten."""

    def map_to_odom(self, stamp_ns: int, T_map_odom: SE2) -> None:
        """Forgotten."""

    def particles(self, stamp_ns: int, T_map_base: SE2) -> None:
        """Forgotten."""

    def plan(self, stamp_ns: int, T_map_base: SE2) -> None:
        """Forgotten."""

    def goal(self, stamp_ns: int, T_map_goal: SE2) -> None:
        """Forgotten."""
