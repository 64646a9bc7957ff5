"""One look for all figures, and files whose bytes depend on the data only.

Colours are Okabe and Ito's, told apart with every common colour blindness; each series also has a
line style of its own. Ink, grid and paper are named colours here so that a page can swap them for
its theme's: the SVG text carries the very hex strings below.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

INK, MUTED, RULE, PAPER, GROUND = "#1c2024", "#5f6873", "#d5dae0", "#fefefe", "#e1e5ea"
TRUTH, ODOMETRY, SLAM, AMCL = "#9ccbee", "#b455a0", "#0072b2", "#009e73"
GOOD, BAD = "#009e73", "#d55e00"
# Series of no meaning of their own. None is BAD: orange is what went wrong, in every figure.
SERIES = (SLAM, ODOMETRY, GOOD, "#8a7f1f", "#56b4e9", INK)

# The truth is wide and pale beneath the thin lines of estimates: both are seen where they agree.
LINES: dict[str, dict[str, Any]] = {
    "truth": {"color": TRUTH, "linewidth": 4.6, "linestyle": "-", "label": "truth"},
    "odometry": {"color": ODOMETRY, "linewidth": 1.2, "linestyle": (0, (4, 2)), "label": "odometry"},
    "slam": {"color": SLAM, "linewidth": 1.3, "linestyle": "-", "label": "SLAM"},
    "amcl": {"color": AMCL, "linewidth": 1.3, "linestyle": "-", "label": "estimate"},
    "plan": {"color": SLAM, "linewidth": 1.6, "linestyle": "-", "label": "plan"},
}

STYLE: dict[Any, Any] = {
    # A world's name or a campaign's label may have any letters: dollars are no formulas.
    "text.parse_math": False,
    "font.family": "DejaVu Sans",
    "font.size": 10.0,
    "axes.titlesize": 10.5,
    "axes.labelsize": 10.0,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.facecolor": PAPER,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": RULE,
    "grid.linewidth": 0.6,
    "text.color": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
    "legend.fontsize": 9.5,
    "figure.facecolor": PAPER,
    "savefig.facecolor": PAPER,
    "savefig.dpi": 160,
    "svg.fonttype": "path",
    "image.interpolation": "none",
    "axes.formatter.useoffset": False,
    "path.simplify": True,
    "path.simplify_threshold": 0.4,
}

WIDTH_IN = 4.4

# From fine to bad. Both ends keep their hue and their contrast when a dark page inverts lightness.
FINE_TO_BAD = LinearSegmentedColormap.from_list("fine_to_bad", ["#0072b2", "#7f86a8", "#b98a6a", "#d55e00"])


def series_colour(number: int) -> str:
    """The colour of a series by its number from 0 on."""
    return SERIES[number % len(SERIES)]


@contextmanager
def styled() -> Iterator[None]:
    """Draw and save inside this; global matplotlib settings are left alone."""
    with matplotlib.rc_context(STYLE):
        yield


def new_figure(height_in: float, layout: Literal["constrained"] | None = "constrained") -> Figure:
    """An empty figure on the Agg canvas, laid out when drawn or with margins of its own."""
    figure = Figure(figsize=(WIDTH_IN, height_in), layout=layout)
    FigureCanvasAgg(figure)
    return figure


def bare(axes: Axes) -> None:
    """No grid and no frame: for maps."""
    axes.grid(False)
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.tick_params(length=2)


def save_png(figure: Figure, path: Path, software: str | None = None) -> None:
    """PNG without a date, and the program named only if one is given: same data, same bytes."""
    figure.savefig(path, metadata={"Software": software})


def save_pdf(figure: Figure, path: Path) -> None:
    """PDF with text as text and without a date."""
    with matplotlib.rc_context({"pdf.fonttype": 42}):
        figure.savefig(path, metadata={"CreationDate": None, "Creator": None, "Producer": None})


def standalone(svg: str) -> str:
    """An SVG element as a file of its own."""
    head = '<?xml version="1.0" encoding="utf-8"?>\n'
    return head + svg.replace("<svg ", '<svg style="stroke-linejoin: round; stroke-linecap: butt" ', 1)


def svg_text(figure: Figure, name: str) -> str:
    """The figure as an `<svg>` element without date, with ids made unique to the page by `name`."""
    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": name}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    # An inline style element would reach the whole page, and the page sets the size.
    text = re.sub(r"<(metadata|style)\b.*?</\1>", "", text, flags=re.DOTALL)
    text = re.sub(r'^(<svg[^>]*?) width="[^"]*"', r"\1", re.sub(r'^(<svg[^>]*?) height="[^"]*"', r"\1", text))
    # Equal images carry equal ids, and nothing refers to them.
    text = re.sub(r'(<image\b[^>]*?) id="[^"]*"', r"\1", text)
    text = re.sub(r'\bid="', f'id="{name}-', text)
    return re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", text)
