"""Files that a session saves and loads by name: maps with keep-out areas, and waypoints."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.maps import load_map, save_map
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.yaml_files import read_mapping
from turtlebag.pipeline.navigation.driver_setup import require_walls_and_floor
from turtlebag.pipeline.studio.inputs import Stopover
from turtlebag.planners.tasks.waypoints import Waypoint, load_waypoints, parse_polygons, tutorial_patrol

KEEPOUT = "-keepout"


class Library:
    """The folders `maps` and `waypoints` of a session, and the map that it was started with."""

    def __init__(self, folder: Path, given: Path | None, *, tutorial: bool = False) -> None:
        """`given` is read here, once; InputError when it cannot be used. `tutorial`: this is its world."""
        self._maps, self._waypoints = folder / "maps", folder / "waypoints"
        self._given = None if given is None else (given, _usable_map(given))
        self.maps: tuple[str, ...] = () if given is None else ("",)
        """Names of the maps there are; the given one has none."""
        self.waypoint_files: tuple[str, ...] = ("",) if tutorial else ()
        """Names of the waypoints there are; the tutorial's have none."""

    def check_name(self, name: str) -> None:
        """InputError for a name that no map can have."""
        if name.endswith(KEEPOUT):
            raise InputError(f"map {name}: names ending in {KEEPOUT} are reserved; choose another name")

    def save_map(self, name: str, grid: OccupancyGrid, keepout: Sequence[Array]) -> None:
        """Write `maps/NAME.pgm` and `.yaml` and, with places to keep out of, `NAME-keepout.yaml`."""
        self._maps.mkdir(exist_ok=True)
        save_map(grid, self._maps, name)
        outlines = self._maps / f"{name}{KEEPOUT}.yaml"
        outlines.unlink(missing_ok=True)
        if keepout:
            corners = [outline.tolist() for outline in keepout]
            outlines.write_text(yaml.safe_dump({"keepout": corners}, default_flow_style=None))
        self.maps = tuple(sorted({*self.maps, name}))

    def load_map(self, name: str) -> tuple[Path, OccupancyGrid, tuple[Array, ...] | None]:
        """Path and grid of a map, and the outlines saved with it; InputError when there is no such map."""
        if name not in self.maps:
            known = ", ".join(filter(None, self.maps))
            what = f"map {name}: no such map" if name else "no map was given at the start"
            raise InputError(f"{what}; {f'known: {known}' if known else 'save one first'}")
        if not name and self._given is not None:
            return (*self._given, None)
        path = self._maps / f"{name}.yaml"
        grid = _usable_map(path)
        outlines = self._maps / f"{name}{KEEPOUT}.yaml"
        if not outlines.exists():
            return path, grid, None
        return path, grid, parse_polygons(read_mapping(outlines)["keepout"], str(outlines))

    def save_waypoints(self, name: str, stopovers: Sequence[Stopover]) -> None:
        """Write `waypoints/NAME.yaml`, which `--waypoints` reads."""
        self._waypoints.mkdir(exist_ok=True)
        lines = ["waypoints:\n"]
        for stop in stopovers:
            entry: dict[str, Any] = dict(zip(("x", "y", "yaw"), stop.pose, strict=True))
            if stop.wait is not None:
                entry["wait"] = stop.wait
            lines.append(f"- {yaml.safe_dump(entry, default_flow_style=True, sort_keys=False)}")
        (self._waypoints / f"{name}.yaml").write_text("".join(lines))
        self.waypoint_files = tuple(sorted({*self.waypoint_files, name}))

    def load_waypoints(self, name: str) -> tuple[Waypoint, ...]:
        """Waypoints that were saved, or the tutorial's; InputError when there are none of that name."""
        if name not in self.waypoint_files:
            known = ", ".join(filter(None, self.waypoint_files))
            what = (
                f"waypoints {name}: no such file" if name else "the tutorial's waypoints are of another world"
            )
            raise InputError(f"{what}; {f'known: {known}' if known else 'save some first'}")
        if not name:
            return tutorial_patrol().waypoints
        return load_waypoints(self._waypoints / f"{name}.yaml").waypoints


def _usable_map(path: Path) -> OccupancyGrid:
    grid = load_map(path)
    require_walls_and_floor(grid, path)
    return grid
