"""The page about a robot's parameters: the numbers, where each comes from, and the data behind them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from turtlebag.reports.page import fill
from turtlebag.reports.parameters import GROUPS, MEANINGS, value_and_interval


def identify_page(
    source: str,
    record: Mapping[str, Any],
    pictures: Sequence[object],
    data: Mapping[str, str],
    others: Mapping[str, str],
) -> str:
    """The page as HTML text, of identify.json; `data` names the picture of the data behind each parameter,
    `others` are files for other programs."""
    parameters = record["parameters"]
    groups = {
        title: [
            (MEANINGS[name], name, parameters[name], value_and_interval(parameters[name]))
            for name in names
            if name in parameters
        ]
        for title, names in GROUPS.items()
    }
    shown = sum(entry["observable"] for entry in parameters.values())
    return fill(
        "identify.html.j2", source=source, record=record, groups=groups, pictures=pictures, data=data,
        others=others, shown=shown, total=len(parameters),
    )  # fmt: skip
