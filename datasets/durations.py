"""The type of durations in settings."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

LONGEST_S = 1e6
"""Far beyond any run; what is longer could not be counted in nanoseconds."""

Seconds = Annotated[float, Field(ge=0.0, le=LONGEST_S)]
