"""A point cloud from above, coloured by height."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from turtlebag.datasets.se2 import Array
from turtlebag.reports.figures.maps import MARGIN_M, add_scale, map_figure

MOST_PIXELS = 900


def cloud_from_above(points: Array) -> Figure:
    """The highest of the points (n, 3) in each pixel, by its height over the lowest [m]."""
    low, high = points.min(axis=0), points.max(axis=0)
    pixel = max(float((high - low)[:2].max()) / MOST_PIXELS, 0.04)
    box = (low[0] - MARGIN_M, high[0] + MARGIN_M, low[1] - MARGIN_M, high[1] + MARGIN_M)
    figure, axes = map_figure(box, bar=True)
    image = heights(points, low[:2], pixel)
    floor, top = np.percentile(points[:, 2], [1.0, 99.5])
    norm = Normalize(0.0, max(float(top - floor), 0.1))
    colours = matplotlib.colormaps["viridis"].with_extremes(bad=(0.0, 0.0, 0.0, 0.0))
    extent = (low[0], low[0] + pixel * image.shape[1], low[1], low[1] + pixel * image.shape[0])
    shown = np.ma.masked_invalid(image - floor)
    artist = axes.imshow(
        shown, origin="lower", extent=extent, cmap=colours, norm=norm, interpolation="nearest"
    )
    add_scale(axes, artist, "height [m]")
    return figure


def heights(points: Array, corner: Array, pixel: float) -> Array:
    """Greatest z in each pixel, (rows, cols) from the corner (2,); NaN where there is no point."""
    cols, rows = np.floor((points[:, :2] - corner) / pixel).astype(np.int64).T
    image = np.full((int(rows.max()) + 1, int(cols.max()) + 1), -np.inf)
    np.maximum.at(image, (rows, cols), points[:, 2])
    return np.where(np.isfinite(image), image, np.nan)
