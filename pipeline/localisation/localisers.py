"""The localisers, by their names in the setting `localiser`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.parts import chosen, part_of
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import LidarSpec, MountedLidar
from turtlebag.pipeline.localisation.amcl import Amcl
from turtlebag.pipeline.localisation.localiser import Localiser
from turtlebag.pipeline.localisation.parameters import AmclConfig

LocaliserName = Annotated[
    str, part_of("amcl"), Field(description="what localises", exclude_if=lambda name: name == "amcl")
]


def make_localiser(
    name: str,
    grid: OccupancyGrid,
    lidar: LidarSpec,
    T_base_lidar: SE2,
    config: AmclConfig,
    rng: np.random.Generator,
    others: Sequence[MountedLidar] = (),
) -> Localiser:
    """The localiser of that name; InputError if it is a user's class that cannot be loaded. `others` are
    further lidars; only ours can use them."""
    if others and name != "amcl":
        raise InputError(
            f"localiser={name}: localises with one lidar, but the scans are of {1 + len(others)}"
        )
    parts = (grid, lidar, T_base_lidar, config, rng)
    if others:
        return Amcl(*parts, others=others)
    made: Localiser = chosen(name, {"amcl": Amcl}, Localiser)(*parts)
    return made
