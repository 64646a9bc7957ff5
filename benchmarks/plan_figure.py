"""Planners side by side: how long they take, how long their paths are, how much room these keep."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from turtlebag.reports.figures.style import INK, ODOMETRY, SLAM, WIDTH_IN, new_figure

PANELS = (
    ("time_ms", "CPU time of a query [ms]", 100.0),
    ("ratio", "length / shortest", 1.05),
    ("clearance_m", "least clearance [m]", None),
)
"""Column, axis, target."""


def planner_boxes(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Boxes over all queries of a benchmark's rows (planner, solved, time_ms, ratio, clearance_m).

    A box is the middle half, its line the median, whiskers the 5th and 95th percentile; a dashed line
    is the target. Below each name, how many of its queries were solved.
    """
    names = list(dict.fromkeys(str(row["planner"]) for row in rows))
    figure = new_figure(1.2 + 0.26 * len(names), width_in=1.8 * WIDTH_IN)
    axes = figure.subplots(1, len(PANELS))
    for axis, (column, label, target) in zip(axes, PANELS, strict=True):
        boxes(axis, [[r[column] for r in rows if r["planner"] == n and r["solved"]] for n in names])
        axis.set_xlabel(label)
        if target is not None:
            axis.axvline(target, color=ODOMETRY, linestyle=(0, (4, 2)), linewidth=1.2)
    axes[0].set_xscale("log")
    axes[0].set_xticks([1, 3, 10, 30, 100, 300, 1000], minor=False)
    axes[0].xaxis.set_major_formatter("{x:g}")
    axes[0].minorticks_off()
    axes[0].set_title("solved / queries, by planner", loc="left", fontsize="small")
    share = {n: [r["solved"] for r in rows if r["planner"] == n] for n in names}
    axes[0].set_yticks(range(len(names)), [f"{n}  {sum(share[n])}/{len(share[n])}" for n in names])
    for axis in axes[1:]:
        axis.tick_params(labelleft=False)
    return figure


def boxes(axis: Axes, values: Sequence[Sequence[float]]) -> None:
    """Horizontal boxes, the first on top; a planner without a solution has none."""
    axis.boxplot(
        [np.asarray(v, dtype=np.float64) for v in values],
        positions=range(len(values)),
        orientation="horizontal",
        whis=(5, 95),
        widths=0.6,
        showfliers=False,
        boxprops={"color": SLAM},
        whiskerprops={"color": SLAM},
        capprops={"color": SLAM},
        medianprops={"color": INK, "linewidth": 1.6},
    )
    axis.set_ylim(len(values) - 0.4, -0.6)
