"""Durations: in settings [s], and as stamps count them [ns]."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

LONGEST_S = 1e6
"""Far beyond any run; what is longer could not be counted in nanoseconds."""

Seconds = Annotated[float, Field(ge=0.0, le=LONGEST_S)]


def nanoseconds(span_s: float) -> int:
    """A span [s] in whole nanoseconds."""
    return round(span_s * 1e9)


def seconds(span_ns: int) -> float:
    """A span of nanoseconds [s]."""
    return span_ns * 1e-9
