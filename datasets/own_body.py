"""Beams of a lidar that end on the robot itself: a strut, a mast, a cable."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.types import Recording

NEAR_M = 0.5
"""No part of the robot is farther from its lidar."""
STILL_M = 0.03
"""Nine tenths of a beam's readings lie within so much where it sees the robot."""
CHANGED_M, CHANGED_SHARE = 0.1, 0.25
"""A scan is another view where so many of its beams have changed by so much since the last one, or return no
more, or again."""
SEEN_SHARE = 0.9
"""Of the views, in which such a beam returns."""
LEAST_VIEWS, MOST_SCANS = 50, 2000


def without_own_body(recording: Recording) -> Recording:
    """The recording without readings of beams that see the robot itself: NaN, which says nothing. A note
    says how many beams they are.

    What stays as it is while the view changes again and again rides along. Walls beside a robot in a corridor
    do not: it would have to keep its distance to centimetres for the whole log, and never turn.
    """
    step = 1 + len(recording) // MOST_SCANS
    some = np.where(recording.lidar.returns(recording.ranges[::step]), recording.ranges[::step], np.nan)
    views = some[_views(some)]
    if len(views) < LEAST_VIEWS:
        return recording
    often = np.isfinite(views).mean(axis=0) >= SEEN_SHARE
    low, middle, high = np.full((3, views.shape[1]), np.nan)
    if often.any():
        low[often], middle[often], high[often] = np.nanpercentile(views[:, often], [5.0, 50.0, 95.0], axis=0)
    body = (high - low <= STILL_M) & (middle <= NEAR_M)
    if not body.any():
        return recording
    said = f"{body.sum()} of {len(body)} beams hit the robot itself (same short range all the time): not used"
    kept = np.where(body, np.float32(np.nan), recording.ranges)
    return replace(recording, ranges=kept, notes=(*recording.notes, said))


def _views(ranges: NDArray[np.floating]) -> list[int]:
    """Scans that show something else than the one before among them; `ranges` (n, beams), NaN: no return."""
    views, last = [0], ranges[0]
    for k in range(1, len(ranges)):
        same = np.abs(ranges[k] - last) <= CHANGED_M
        neither = np.isnan(ranges[k]) & np.isnan(last)
        if np.count_nonzero(same | neither) < (1.0 - CHANGED_SHARE) * len(last):
            views.append(k)
            last = ranges[k]
    return views
