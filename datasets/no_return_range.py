"""Detects the fixed range that some drivers send for "no return"."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

_SCANS = 1000
"""Scans looked at; codes are sent all the time."""
_SHARE = 0.001
"""Share of the readings that a code must have to matter."""
_TIMES = 10
"""A wall gives many different ranges, a code only one: it is this many times as frequent as any range nearby,
and as all longer ones together."""
_BESIDE, _MOST = 0.97, 0.6
"""Codes may stand beside each other, within this share of the longest; one of them is most of them. A wall
far away is spread over some values too, but more evenly."""
_VARIED = 50
"""Fewer different readings than this tell nothing of what walls give."""


def no_return_value(readings: NDArray[np.floating]) -> float:
    """Smallest range [m] that a driver sends for "no return"; +inf if there is none.

    `readings` (n_scans, n_beams). Such values, exactly equal each time, stand at the far end of the readings
    and are far more frequent than any other of at least half their range.
    """
    some = readings[:: 1 + len(readings) // _SCANS]
    values, counts = np.unique(some[np.isfinite(some) & (some > 0.0)], return_counts=True)
    found, end = math.inf, len(values)
    if end < _VARIED:
        return found
    peaks = np.flatnonzero(counts >= _TIMES)
    half, beside = (np.searchsorted(values, share * values[peaks]) for share in (0.5, _BESIDE))
    nearby = np.array([counts[a:b].max(initial=1) for a, b in zip(half, beside, strict=True)])
    peaks = peaks[counts[peaks] > _TIMES * nearby]
    while len(peaks):
        together = peaks[values[peaks] >= _BESIDE * values[peaks[-1]]]
        sent, first = counts[together], int(together[0])
        longer = counts[first:end].sum() - sent.sum()
        matters = sent.sum() >= max(_SHARE * counts.sum(), _TIMES * max(longer, 1))
        if matters and sent.max() >= _MOST * sent.sum():
            found, end = float(values[first]), first
        elif sent.sum() >= _SHARE * counts.sum():
            break
        peaks = peaks[: -len(together)]
    return found
