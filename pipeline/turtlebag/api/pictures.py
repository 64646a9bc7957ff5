"""What a notebook shows of a result: a card with its verdict, a few facts and a picture."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Trajectory
from turtlebag.reports.interactive_map import interactive_map

WIDTH_PX, TALLEST_PX = 420, 520
ROWS_SHOWN = 12
LINES = {
    "truth": ("#9ccbee", 3.2),
    "odometry": ("#b455a0", 1.2),
    "map": ("#0072b2", 1.5),
    "estimate": ("#009e73", 1.5),
    "plan": ("#0072b2", 1.5),
}
"""Colour and width [px] of a path by what it is, those of the report's figures."""
MOODS = {"good": "#009e73", "bad": "#d55e00", "neutral": "#5f6873"}
CELL_M = 0.05
MARGIN_M = 0.3


def card(title: str, said: str, facts: Mapping[str, str], picture: str = "", mood: str = "neutral") -> str:
    """HTML that reads the same on light and dark pages: title, sentence, facts by name, picture."""
    rows = "".join(
        f'<tr style="background:none"><td style="text-align:left;color:#5f6873;padding:1px 12px 1px 0;'
        f'vertical-align:top">{html.escape(name)}</td><td style="text-align:left;padding:1px 0">'
        f"{html.escape(text)}</td></tr>"
        for name, text in facts.items()
    )
    sentence = f'<div style="margin-top:4px">{html.escape(said)}</div>' if said else ""
    table = f'<table style="border:none;margin:6px 0 0;font-size:13px;color:#1c2024">{rows}</table>'
    return (
        f'<div style="display:inline-block;max-width:{WIDTH_PX + 30}px;background:#fefefe;color:#1c2024;'
        f"border:1px solid #d5dae0;border-left:4px solid {MOODS[mood]};border-radius:4px;padding:8px 12px;"
        f'font:14px system-ui,sans-serif"><b>{html.escape(title)}</b>{sentence}{table if rows else ""}'
        f"{picture}</div>"
    )


def scene(
    grid: OccupancyGrid | None,
    paths: Mapping[str, Trajectory | None],
    goals: Sequence[Mapping[str, Any]] = (),
) -> str:
    """SVG of a map with paths, keys of LINES, and goals, green where they were truly reached."""
    drawn = {kind: path for kind, path in paths.items() if path is not None and len(path)}
    if grid is None:
        grid = _floor_under(list(drawn.values()))
    if grid is None:
        return ""
    found = interactive_map(grid, {kind: (kind, path) for kind, path in drawn.items()}, goals)
    _, _, width_m, height_m = (float(part) for part in found.view.split())
    width = min(float(WIDTH_PX), TALLEST_PX * width_m / height_m)
    x, y, yaw = found.origin
    rows_m, columns_m = found.rows * found.resolution, found.columns * found.resolution
    pixel = width_m / width
    body = [
        f'<g transform="translate({x} {-y}) rotate({-np.rad2deg(yaw)})"><image href="{found.image}" x="0" '
        f'y="{-rows_m}" width="{columns_m}" height="{rows_m}" preserveAspectRatio="none" '
        'style="image-rendering:pixelated"/></g>'
    ]
    for _, kind, points in found.lines:
        colour, thick = LINES[kind]
        body.append(
            f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="{thick * pixel:.4f}" '
            'stroke-linejoin="round"/>'
        )
    for goal_x, goal_y, number, mood in found.goals:
        body.append(
            f'<circle cx="{goal_x}" cy="{-goal_y}" r="{8 * pixel:.4f}" fill="{MOODS[mood]}"/>'
            f'<text x="{goal_x}" y="{-goal_y + 3.5 * pixel:.4f}" font-size="{10 * pixel:.4f}" fill="#fefefe" '
            f'text-anchor="middle" font-family="sans-serif">{number}</text>'
        )
    svg = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{found.view}" width="{width:.0f}" '
        f'style="display:block;margin:8px 0 0;max-width:100%" role="img">{"".join(body)}</svg>'
    )
    return svg + _legend([kind for _, kind, _ in found.lines])


def path_picture(path: Trajectory) -> str:
    """SVG of a path alone."""
    return scene(None, {"map": path}).partition("</svg>")[0] + "</svg>" if len(path) else ""


def table_html(table: Mapping[str, NDArray[Any]]) -> str:
    """The first rows of a table of columns (n,)."""
    count = len(next(iter(table.values()), ()))
    head = "".join(f"<th>{html.escape(name)}</th>" for name in table)
    columns = [column[:ROWS_SHOWN] for column in table.values()]
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(_cell(value))}</td>" for value in row) + "</tr>"
        for row in zip(*columns, strict=True)
    )
    more = f"<p>... {count} rows in all</p>" if count > ROWS_SHOWN else ""
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{more}"


def _cell(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _legend(kinds: Sequence[str]) -> str:
    keys = "".join(
        f'<span style="margin-right:14px"><span style="display:inline-block;width:18px;height:0;'
        f'border-top:{max(LINES[kind][1], 2.0)}px solid {LINES[kind][0]};vertical-align:middle"></span> '
        f"{kind}</span>"
        for kind in kinds
    )
    return f'<div style="font-size:12px;color:#5f6873;margin-top:4px">{keys}</div>'


def _floor_under(paths: Sequence[Trajectory]) -> OccupancyGrid | None:
    """A blank floor where there is no map to draw on."""
    if not paths:
        return None
    xy = np.concatenate([path.poses.xy for path in paths])
    low, high = xy.min(axis=0) - MARGIN_M, xy.max(axis=0) + MARGIN_M
    size = max(float((high - low).max()) / 500.0, CELL_M)
    columns, rows = np.ceil((high - low) / size).astype(int).tolist()
    return OccupancyGrid(np.zeros((rows, columns), dtype=np.int8), size, SE2.from_xyt(low[0], low[1], 0.0))
