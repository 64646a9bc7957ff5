"""The layout for Foxglove and Lichtblick beside a report: the frame its bags have, the ground they cover."""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

import numpy as np

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.yaml_files import read_mapping
from turtlebag.reports.stages import Stage

PANEL = "3D!turtlebag"
ON_MAP = ("/map", "/plan", "/particlecloud", "/amcl_pose", "/goal_pose")
"""Topics of a run that knows where it is on a map."""

MARGIN = 1.3
"""Distance of the camera in sizes of the ground: its field of view of 45 degrees shows 0.83 of that."""


def viewer_layouts(stages: Sequence[Stage]) -> dict[str, str]:
    """Layouts as JSON by file name: in the frame `map` for bags with a map, in `odom` for those without.

    With bags of both kinds the second one has `-odom` in its name. All grids are in view.
    """
    topics = [found for stage in stages if (found := topics_of(stage))]
    frames = sorted({"map" if "/map" in found else "odom" for found in topics}) or ["map"]
    layouts = {f"foxglove-layout-{frame}.json": _layout(stages, frame) for frame in frames[1:]}
    return {"foxglove-layout.json": _layout(stages, frames[0]), **layouts}


def _layout(stages: Sequence[Stage], frame: str) -> str:
    template = files("turtlebag.reports") / "templates/foxglove-layout.json"
    layout: dict[str, Any] = json.loads(template.read_text())
    panel = layout["configById"][PANEL]
    panel["followTf"] = frame
    if frame != "map":
        panel["topics"] = {name: value for name, value in panel["topics"].items() if name not in ON_MAP}
    grids = [grid for stage in stages for grid in (stage.map, stage.true_map) if grid is not None]
    if grids:
        corners = np.concatenate([_corners(grid) for grid in grids])
        low, high = corners.min(axis=0), corners.max(axis=0)
        x, y = ((low + high) / 2.0).round(2).tolist()
        panel["cameraState"]["targetOffset"] = [x, y, 0.0]
        panel["cameraState"]["distance"] = round(MARGIN * float((high - low).max()), 1)
    return json.dumps(layout, indent=1) + "\n"


def topics_of(stage: Stage) -> set[str]:
    """Names of the topics in a stage's bag, by its metadata; none for a stage without one. InputError when it
    cannot be read."""
    path = stage.folder / "bag/metadata.yaml"
    if not path.is_file():
        return set()
    try:
        topics = read_mapping(path)["rosbag2_bagfile_information"]["topics_with_message_count"]
        return {str(topic["topic_metadata"]["name"]) for topic in topics}
    except (KeyError, TypeError):
        raise InputError(f"{path}: not the metadata of a bag") from None


def _corners(grid: OccupancyGrid) -> Any:
    """(4, 2) corners of a grid [m]."""
    rows, columns = grid.shape
    width, height = columns * grid.resolution, rows * grid.resolution
    return grid.T_map_grid @ np.array([[0.0, 0.0], [width, 0.0], [0.0, height], [width, height]])
