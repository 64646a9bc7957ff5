"""Quantities over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, MaxNLocator, NullLocator, ScalarFormatter
from matplotlib.transforms import blended_transform_factory

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Stamps, Trajectory
from turtlebag.reports.figures.maps import legend_above
from turtlebag.reports.figures.style import AMCL, BAD, INK, LINES, WIDTH_IN, new_figure
from turtlebag.reports.metrics.trajectory import PosePairs

Span = tuple[int, int]
LINEAR_TO = 3.0
"""Errors [cm, degrees] up to this have a linear axis."""
AXIS_TOLD = f"If an error exceeds {LINEAR_TO:g}, its axis is logarithmic from 1 upwards."
"""What every caption of such an axis says."""


def stacked(rows: int, height_in: float, *, legend: bool = False) -> tuple[Figure, list[Axes]]:
    """Axes over one time, one above the other; `legend`: room for one above them.

    Margins are fixed: to find them for axes whose labels are in line takes as long as drawing them twice.
    """
    figure = new_figure(height_in, layout=None)
    left, right = 0.9 / WIDTH_IN, 1.0 - 0.12 / WIDTH_IN
    room = {
        "left": left,
        "right": right,
        "bottom": 0.46 / height_in,
        "top": 1.0 - (0.3 if legend else 0.08) / height_in,
    }
    axes = list(np.atleast_1d(figure.subplots(rows, 1, sharex=True, gridspec_kw={**room, "hspace": 0.14})))
    axes[-1].set_xlabel("time [s]")
    for axis in axes:
        axis.yaxis.set_label_coords(
            0.38 / WIDTH_IN, 0.5, transform=blended_transform_factory(figure.transFigure, axis.transAxes)
        )
    return figure, axes


def speeds(truth: Trajectory) -> tuple[Array, Array, Array]:
    """Seconds, forward speed [m/s] and yaw rate [rad/s] between successive true poses, (n - 1,) each."""
    dt = np.maximum(np.diff(truth.stamps_ns), 1) * 1e-9
    step = truth.poses.steps()
    middle = (truth.stamps_ns[1:] + truth.stamps_ns[:-1]) / 2 - truth.stamps_ns[0]
    return middle * 1e-9, step[:, 0] / dt, step[:, 2] / dt


def error_over_time(slam: PosePairs | None, odometry: PosePairs | None, truth: Trajectory) -> Figure:
    """Position and yaw errors of SLAM and odometry, aligned with the true speed and yaw rate."""
    figure, axes = stacked(4, 5.6, legend=True)
    start = int(truth.stamps_ns[0])
    for pairs, kind in ((odometry, "odometry"), (slam, "slam")):
        if pairs is not None:
            _plot_errors(axes, pairs, start, **LINES[kind])
    for axis in axes[:2]:
        error_axis(axis)
    legend_above(axes[0])
    t, v, w = speeds(truth)
    for axis, values, label in ((axes[2], v, "speed\n[m/s]"), (axes[3], w, "yaw rate\n[rad/s]")):
        axis.plot(t, values, color=INK, linewidth=0.9)
        axis.set_ylabel(label)
    return figure


def _plot_errors(axes: Sequence[Axes], pairs: PosePairs, start_ns: int, **line: Any) -> None:
    """Errors of the position on the first axes, of the yaw on the second."""
    order = np.argsort(pairs.stamps_ns, kind="stable")
    t = seconds(pairs.stamps_ns[order] - start_ns)
    axes[0].plot(t, 100.0 * pairs.position_errors()[order], **line)
    axes[0].set_ylabel("position\nerror [cm]")
    axes[1].plot(t, np.degrees(pairs.yaw_errors()[order]), **line)
    axes[1].set_ylabel("yaw\nerror [°]")


def error_axis(axis: Axes) -> None:
    """From 0 up, with ticks: linear for small errors, else linear up to 1 and logarithmic beyond."""
    most = max((float(np.nanmax(line.get_ydata())) for line in axis.get_lines()), default=0.0)
    if most <= LINEAR_TO:
        axis.yaxis.set_major_locator(MaxNLocator(4))
    else:
        axis.set_yscale("symlog", linthresh=1.0)
        decades = [step * 10.0**k for k in range(8) for step in (1.0, 3.0)]
        axis.yaxis.set_major_locator(FixedLocator([0.0, *(tick for tick in decades if tick <= most)]))
        axis.yaxis.set_minor_locator(NullLocator())
        axis.yaxis.set_major_formatter(ScalarFormatter())
    axis.set_ylim(0.0, 1.1 * max(most, 1e-2))


def localisation(
    pairs: PosePairs, start_ns: int, contacts: Sequence[Span], goals_s: Sequence[float]
) -> Figure:
    """Position and yaw error of the estimate, with contact episodes shaded and goals ticked."""
    figure, axes = stacked(2, 3.4)
    _plot_errors(axes, pairs, start_ns, color=AMCL, linewidth=1.2)
    for axis in axes:
        error_axis(axis)
        mark_events(axis, start_ns, contacts, goals_s)
    return figure


def mark_events(axis: Axes, start_ns: int, contacts: Sequence[Span], goals_s: Sequence[float]) -> None:
    """Contact episodes as bands, ends of goals as thin lines."""
    for first, last in contacts:
        axis.axvspan(
            seconds(first - start_ns), seconds(last - start_ns) + 0.2, color=BAD, alpha=0.35, linewidth=0
        )
    for moment in goals_s:
        axis.axvline(moment, color=INK, linewidth=0.6, linestyle=(0, (1, 3)))


def clearance(
    stamps_ns: Stamps, clearance_m: Array, commands: Array, contacts: Sequence[Span], goals_s: Sequence[float]
) -> Figure:
    """Footprint clearance and the commands (n, 2) [m/s, rad/s] over time."""
    figure, axes = stacked(3, 4.4)
    start = int(stamps_ns[0])
    t = seconds(stamps_ns - start)
    axes[0].plot(t, 100.0 * np.where(np.isfinite(clearance_m), clearance_m, np.nan), color=INK, linewidth=1.1)
    axes[0].set_ylabel("clearance\n[cm]")
    axes[0].set_ylim(bottom=0.0)
    axes[0].axhline(0.0, color=BAD, linewidth=1.0)
    for axis, values, unit in zip(axes[1:], commands.T, ("m/s", "rad/s"), strict=True):
        axis.plot(t, values, color=INK, linewidth=0.9)
        axis.set_ylabel(f"command\n[{unit}]")
    for axis in axes:
        mark_events(axis, start, contacts, goals_s)
    return figure
