"""What a run drove: its goals, its decisions, and the room it kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.offsetbox import AnchoredText
from matplotlib.path import Path

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Trajectory
from turtlebag.reports.figures import maps
from turtlebag.reports.figures.style import BAD, FINE_TO_BAD, GOOD, INK, MUTED, ODOMETRY, PAPER, SLAM
from turtlebag.reports.metrics.navigation import outcome, placed_goals

# How each goal ended, by the truth: colour, marker, words. Orange is bad, whatever the shape.
ENDS = {
    "reached": (GOOD, "o", "reached"),
    "elsewhere": (BAD, "D", "reported as reached, but elsewhere"),
    "timeout": (BAD, "s", "timeout"),
    "unreachable": (BAD, "X", "unreachable"),
    "rejected": (BAD, "h", "rejected"),
    "collided": (BAD, "P", "collided"),
}
ARROW = Path([(-1.0, 0.12), (0.3, 0.12), (0.3, 0.5), (1.0, 0.0), (0.3, -0.5), (0.3, -0.12), (-1.0, -0.12)])
"""A marker of the legend; closed where it is filled."""
ROOMY_M = 0.5
"""Clearance beyond this is all one colour."""


@dataclass(frozen=True, eq=False)
class Decisions:
    """Where a run without a goal decided to do something else than drive straight: poses (n,) and the
    driver's own words, (n,).
    """

    T_world_base: SE2
    words: list[str]


# Words of a decision -> (name in the legend, colour, where its arrow points from the robot's heading [rad]).
DECISIONS = {
    "slow_veer_left": ("veers", SLAM, np.pi / 4),
    "slow_veer_right": ("veers", SLAM, -np.pi / 4),
    "stop_turn_left": ("stops and turns", ODOMETRY, np.pi / 2),
    "stop_turn_right": ("stops and turns", ODOMETRY, -np.pi / 2),
    "turn_away": ("stops and turns", ODOMETRY, np.pi / 2),
    "back_off": ("backs off", INK, np.pi),
}


def run(
    grid: OccupancyGrid | None,
    truth: Trajectory,
    estimate: Trajectory | None,
    goals: Sequence[Mapping[str, Any]],
    contacts_xy: Array,
    decisions: Decisions | None = None,
) -> Figure:
    """What a run drove: true and estimated path on the map from the start, goals numbered and coloured by
    how they truly ended; for a run without goals where it decided what.
    """
    box = maps.view_box(grid, [truth, estimate])
    figure, axes = maps.map_figure(box)
    if grid is not None:
        maps.draw_grid(axes, grid)
    maps.draw_path(axes, truth, "truth", label="true path")
    maps.draw_path(axes, estimate, "amcl")
    maps.draw_start(axes, truth.poses[0])
    handles: list[Artist] = [line for line in axes.get_lines() if not str(line.get_label()).startswith("_")]
    used = _draw_goals(axes, goals)
    handles += [_marker(*ENDS[end]) for end in ENDS if end in used]
    if decisions is not None:
        handles += _draw_decisions(axes, decisions, 0.05 * max(box[1] - box[0], box[3] - box[2]))
    if len(contacts_xy):
        handles += axes.plot(*contacts_xy.T, "*", color=BAD, markersize=9, label="contact", zorder=6)
    maps.legend_above(axes, handles)
    return figure


def _draw_goals(axes: Axes, goals: Sequence[Mapping[str, Any]]) -> set[str]:
    used = set()
    for number, x, y, goal in placed_goals(goals):
        end = outcome(goal)
        colour, marker, _ = ENDS.get(end, (MUTED, "o", end))
        used.add(end)
        axes.plot(x, y, marker, color=colour, markersize=13, markeredgecolor=PAPER, zorder=5)
        axes.annotate(
            str(number), (x, y), color=PAPER, fontsize=7.5, ha="center", va="center", weight="bold", zorder=6
        )
    return used


def _marker(colour: str, marker: str | Path, label: str) -> Line2D:
    return Line2D([], [], linestyle="none", marker=marker, color=colour, markersize=8, label=label)


def _draw_decisions(axes: Axes, decisions: Decisions, length_m: float) -> list[Artist]:
    """An arrow to the side for each decision that has one; returns what the legend says."""
    handles: dict[str, Artist] = {}
    for number, word in enumerate(decisions.words):
        if word not in DECISIONS:
            continue
        label, colour, side = DECISIONS[word]
        pose = decisions.T_world_base[number]
        maps.draw_pose(axes, pose @ SE2.from_xyt(0.0, 0.0, side), colour, length_m)
        axes.plot(float(pose.x), float(pose.y), "o", color=colour, markersize=4, zorder=5)
        handles.setdefault(label, _marker(colour, ARROW, label))
    return list(handles.values())


def clearance_on_map(grid: OccupancyGrid | None, truth: Trajectory, clearance_m: Array) -> Figure:
    """The true path coloured by the footprint's clearance; the nearest place is named."""
    figure, axes = maps.faint_map(grid, [truth], bar=True)
    finite = np.where(np.isfinite(clearance_m), clearance_m, np.nan)
    points = axes.scatter(
        truth.poses.x,
        truth.poses.y,
        c=100.0 * finite,
        s=5,
        cmap=FINE_TO_BAD.reversed(),
        norm=Normalize(0.0, 100.0 * ROOMY_M),
        zorder=3,
        rasterized=True,
    )
    maps.add_scale(axes, points, "clearance [cm]", extend="max")
    if np.isfinite(finite).any():
        nearest = int(np.nanargmin(finite))
        axes.plot(truth.poses.x[nearest], truth.poses.y[nearest], "v", color=INK, markersize=8, zorder=5)
        note = AnchoredText(
            f"▼ least: {100.0 * finite[nearest]:.1f} cm", "lower left", frameon=False, pad=0.2
        )
        axes.add_artist(note)
    return figure
