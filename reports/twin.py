"""The page about a twin: each quantity of the real drive beside that of the simulated ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from turtlebag.datasets.se2 import Array
from turtlebag.reports.page import fill


def twin_page(
    source: str, about: Mapping[str, Any], differences: Sequence[Any], pictures: Sequence[object]
) -> str:
    """The page as HTML text; `about` has `base`, `shown`, `total` and `drives`."""
    return fill(
        "twin.html.j2",
        source=source,
        about=about,
        apart=[one for one in differences if one.differs],
        alike=[one for one in differences if not one.differs],
        rows=[(one, _spread(one.real), _spread(one.simulated)) for one in differences],
        pictures=pictures,
    )


def _spread(values: Array) -> str:
    low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
    return f"{middle:.3g} ({low:.3g} to {high:.3g})"
