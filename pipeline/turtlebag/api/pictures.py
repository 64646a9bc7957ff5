"""Notebook cards of results: verdict, a few facts and the report's picture."""

from __future__ import annotations

import html
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from matplotlib.figure import Figure
from numpy.typing import NDArray

from turtlebag.datasets.types import Trajectory
from turtlebag.reports.figures.album import Album
from turtlebag.reports.figures.maps import draw_path, draw_start, faint_map
from turtlebag.reports.figures.style import BAD, GOOD, INK, MUTED, PAPER, RULE, styled, svg_text
from turtlebag.reports.kinds import KINDS
from turtlebag.reports.stages import Group, Stage

WIDTH_PX = 420
ROWS_SHOWN = 12
MOODS = {"good": GOOD, "bad": BAD, "neutral": MUTED}


def card(title: str, said: str, facts: Mapping[str, str], picture: str = "", mood: str = "neutral") -> str:
    """HTML that is readable on light and dark pages: title, sentence, facts by name, picture."""
    rows = "".join(
        f'<tr style="background:none"><td style="text-align:left;color:{MUTED};padding:1px 12px 1px 0;'
        f'vertical-align:top">{html.escape(name)}</td><td style="text-align:left;padding:1px 0">'
        f"{html.escape(text)}</td></tr>"
        for name, text in facts.items()
    )
    sentence = f'<div style="margin-top:4px">{html.escape(said)}</div>' if said else ""
    table = f'<table style="border:none;margin:6px 0 0;font-size:13px;color:{INK}">{rows}</table>'
    return (
        f'<div style="display:inline-block;max-width:{WIDTH_PX + 30}px;background:{PAPER};color:{INK};'
        f"border:1px solid {RULE};border-left:4px solid {MOODS[mood]};border-radius:4px;padding:8px 12px;"
        f'font:14px system-ui,sans-serif"><b>{html.escape(title)}</b>{sentence}{table if rows else ""}'
        f"{picture}</div>"
    )


class _Enough(Exception):
    """There is a picture."""


class _First(Album):
    """Keeps the first picture and no file."""

    svg = ""

    def add(self, name: str, title: str, caption: str, draw: Callable[..., Figure], *drawn: Any) -> None:
        """Draw it, and no other."""
        self.svg = svg_of(draw, *drawn)
        raise _Enough


def picture_of(stage: Stage) -> str:
    """The first picture of an output in a report, as SVG; empty without one."""
    album = _First(None, animate=False)
    with suppress(_Enough):
        KINDS[stage.kind].draw(stage, Group("", (stage,)), album)
    return album.svg


def svg_of(draw: Callable[..., Figure], *drawn: Any) -> str:
    """A figure as SVG in a box of the card's width."""
    with styled():
        svg = svg_text(draw(*drawn), "picture")
    return f'<div style="width:{WIDTH_PX}px;max-width:100%;margin-top:8px">{svg}</div>'


def path_picture(path: Trajectory) -> str:
    """SVG of a path alone."""

    def draw() -> Figure:
        figure, axes = faint_map(None, [path])
        draw_path(axes, path, "slam")
        draw_start(axes, path.poses[0])
        return figure

    return svg_of(draw) if len(path) else ""


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
