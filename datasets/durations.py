"""Durations: in settings [s], and as stamps count them [ns]."""

from __future__ import annotations

from typing import Annotated, Any, overload

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

LONGEST_S = 86_400.0
"""A day: nothing is simulated for longer, however many inputs there are."""

Seconds = Annotated[float, Field(ge=0.0, le=LONGEST_S)]


@overload
def nanoseconds(span_s: float) -> int: ...
@overload
def nanoseconds(span_s: NDArray[np.float64]) -> NDArray[np.int64]: ...
def nanoseconds(span_s: float | NDArray[np.float64]) -> int | NDArray[np.int64]:
    """A span [s], or an array of them, in whole nanoseconds."""
    ns = span_s * 1e9
    return np.round(ns).astype(np.int64) if isinstance(ns, np.ndarray) else round(ns)


@overload
def seconds(span_ns: float) -> float: ...
@overload
def seconds(span_ns: NDArray[np.int64]) -> NDArray[np.float64]: ...
def seconds(span_ns: float | NDArray[np.int64]) -> float | NDArray[Any]:
    """A span of nanoseconds [s], or an array of them."""
    return span_ns * 1e-9
