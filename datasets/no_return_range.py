"""Detects the fixed range that some drivers send for "no return"."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

_SCANS = 1000
"""Scans looked at; codes are sent all the time."""
_SHARE = 0.005
"""Share of the readings that a code must have to matter."""
_TIMES = 10
"""A wall gives many different ranges, a code only one: it is this many times as frequent as any range nearby,
and as all longer ones together."""
_VARIED = 50
"""Fewer different readings than this tell nothing of what walls give."""


def no_return_value(readings: NDArray[np.floating]) -> float:
    """Smallest range [m] that a driver sends for "no return"; +inf if there is none.

    `readings` (n_scans, n_beams). Such a value, exactly equal each time, stands at the far end of the
    readings and is far more frequent than any other of at least half its range.
    """
    some = readings[:: 1 + len(readings) // _SCANS]
    values, counts = np.unique(some[np.isfinite(some) & (some > 0.0)], return_counts=True)
    found, end = math.inf, len(values)
    if end < _VARIED:
        return found
    frequent = np.flatnonzero(counts >= max(_SHARE * counts.sum(), _TIMES))
    for k in frequent[::-1]:
        # another code may stand right beside
        nearby = counts[(values >= 0.5 * values[k]) & (values < 0.99 * values[k])]
        if counts[k] <= _TIMES * max(nearby.max(initial=1), counts[k + 1 : end].sum()):
            break
        found, end = float(values[k]), int(k)
    return found
