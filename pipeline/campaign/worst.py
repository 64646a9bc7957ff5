"""The case of a campaign that deserves a look first."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from turtlebag.pipeline.campaign.campaign_file import Campaign
from turtlebag.pipeline.campaign.case import Row, Where, kept_at
from turtlebag.pipeline.campaign.cases import Case


@dataclass(frozen=True, eq=False)
class Worst:
    """The case with the largest value of a result, called `label`; `link` leads to its files."""

    row: Row
    label: str
    value: float
    unit: str
    link: str


def worst_case(campaign: Campaign, todo: Sequence[Case], rows: Sequence[Row], where: Where) -> Worst | None:
    """The first case with the largest value of the first result; None when no case has a number."""
    name = next(iter(campaign.results), "")
    numbers = [row for row in rows if _size(row.get(name)) > -math.inf]
    if not numbers:
        return None
    row = max(numbers, key=lambda row: _size(row[name]))
    case = next(case for case in todo if case.name == row["case"])
    folder = kept_at(case, campaign, where.maker, campaign.results[name].at.partition(":")[0])
    label, unit = campaign.names[name]
    return Worst(row, label, row[name], unit, f"{folder}/metrics.json")


def _size(value: object) -> float:
    return value if isinstance(value, (int, float)) and not isinstance(value, bool) else -math.inf
