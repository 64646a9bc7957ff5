"""The true map of a world: cells, and the circles that cells can only show as squares."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import yaml
from pydantic import Field

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.maps import load_map, save_map
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.yaml_files import DUMPER, checked, read_yaml

CIRCLES = "circles.yaml"

Metres = Annotated[float, Field(ge=-1e6, le=1e6)]


class _Circles(Settings):
    circles: tuple[tuple[Metres, Metres, Annotated[Metres, Field(gt=0.0)]], ...] = ()
    """x, y, radius [m] in the frame `world`, in the plane of the lidar."""


@dataclass(frozen=True, eq=False)
class TrueMap(OccupancyGrid):
    """A map and its round solids: `circles` (m, 3) are x, y, radius [m] in the map's frame."""

    circles: Array = field(default_factory=lambda: np.zeros((0, 3)))


def save_true_map(grid: OccupancyGrid, circles: Array, folder: Path) -> None:
    """Write `map.pgm`, `map.yaml` and `circles.yaml`; circles (m, 3)."""
    save_map(grid, folder)
    text = yaml.dump({"circles": circles.tolist()}, Dumper=DUMPER, default_flow_style=None, sort_keys=False)
    (folder / CIRCLES).write_text(text)


def load_true_map(folder: Path) -> TrueMap:
    """The map in a `truth/` folder; one of an earlier version has no circles. InputError if unreadable."""
    grid, file, circles = load_map(folder / "map.yaml"), folder / CIRCLES, _Circles()
    if file.exists():
        circles = checked(_Circles, read_yaml(file, where=str(file)), where=str(file))
    return TrueMap(grid.cells, grid.resolution, grid.T_map_grid, np.array(circles.circles).reshape(-1, 3))
