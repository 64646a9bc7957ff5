"""The pose graph: keys where they ended up, loops coloured by what is left of their error."""

from __future__ import annotations

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.types import Trajectory
from turtlebag.reports.figures.maps import ERROR_SCALE_M, add_scale, faint_map
from turtlebag.reports.figures.style import FINE_TO_BAD, MUTED
from turtlebag.reports.g2o import LoopRecord, PoseGraph


def pose_graph(graph: PoseGraph, grid: OccupancyGrid | None, record: LoopRecord) -> Figure:
    """Keys in order as a thin line, loops as lines from blue (agrees) to orange (strained)."""
    keys = Trajectory.untimed(graph.T_map_keys)
    figure, axes = faint_map(grid, [keys], bar=True)
    axes.plot(keys.poses.x, keys.poses.y, "-", color=MUTED, linewidth=0.8, zorder=2)
    axes.plot(keys.poses.x, keys.poses.y, ".", color=MUTED, markersize=3, zorder=3)
    pairs, residual_m = record.kept(len(keys))
    order = np.argsort(residual_m, kind="stable")
    residual_cm = 100.0 * residual_m
    segments = keys.poses.xy[pairs[order]]
    norm = Normalize(0.0, 100.0 * ERROR_SCALE_M)
    lines = LineCollection(list(segments), cmap=FINE_TO_BAD, norm=norm, linewidths=1.8, alpha=0.8, zorder=4)
    lines.set_rasterized(len(order) > 1500)
    lines.set_array(residual_cm[order])
    axes.add_collection(lines)
    add_scale(axes, ScalarMappable(norm, FINE_TO_BAD), "residual of the loop [cm]", extend="max")
    return figure
