"""The robot's outline in a bag's custom data, as Nav2 writes footprints: `[[x, y], ...]` [m], in its base."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import Array

KEY = "footprint"
Metres = Annotated[float, Field(ge=-10.0, le=10.0)]
_CORNERS = TypeAdapter(Annotated[list[tuple[Metres, Metres]], Field(min_length=3, max_length=200)])


def footprint_text(footprint: Array) -> dict[str, str]:
    """The entry for an outline (n, 2)."""
    return {KEY: json.dumps(footprint.round(4).tolist())}


def footprint_of(path: Path) -> Array | None:
    """The outline (n, 2) that a bag states; None for one that states none, and for a log."""
    with suppress(InputError, ValidationError):
        return np.array(_CORNERS.validate_json(open_bag(path).custom_data().get(KEY, "")))
    return None
