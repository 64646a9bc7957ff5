"""The localisers, by their names in the setting `localiser`."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.parts import chosen, part_of
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import LidarSpec
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
) -> Localiser:
    """The localiser of that name; InputError if it is a user's class that cannot be loaded."""
    made: Localiser = chosen(name, {"amcl": Amcl}, Localiser)(grid, lidar, T_base_lidar, config, rng)
    return made
