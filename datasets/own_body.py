"""Beams of a lidar that end on the robot itself: a strut, a mast, a cable."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import wrap
from turtlebag.datasets.types import Recording

NEAR_M = 0.5
"""No part of the robot is farther from its lidar."""
STILL_M = 0.03
"""Nine tenths of a beam's readings lie within so much where it sees the robot."""
CHANGED_M, CHANGED_SHARE = 0.1, 0.25
"""A scan is a new view if this share of its beams has changed by this much since the last one, or
started or stopped returning."""
SEEN_SHARE = 0.9
"""Share of the views in which such a beam returns."""
TURNS_RAD_S = 0.1
"""A robot that turns faster than this turns: left, right or not at all are three kinds of motion."""
LEAST_VIEWS, MOST_SCANS = 20, 2000
"""Views of a kind of motion that tell something; scans looked at."""


def without_own_body(recording: Recording) -> Recording:
    """The recording without readings of beams that see the robot itself: NaN, which says nothing. A note
    says how many beams they are.

    What stays as it is while the view changes again and again rides along, if that holds for more than one
    kind of motion: a pillar that the robot circles stays as near, too, until it drives otherwise. Without
    odometry nobody says how it drives, and nothing is taken away.
    """
    step = 1 + len(recording) // MOST_SCANS
    some = np.where(recording.lidar.returns(recording.ranges[::step]), recording.ranges[::step], np.nan)
    if recording.T_odom_base is None or len(some) < 2:
        return recording
    views = np.array(_views(some))
    turned = wrap(np.diff(recording.T_odom_base.yaw))
    seconds = np.maximum(np.diff(recording.stamps_ns) * 1e-9, 1e-3)
    rate = np.concatenate([[0.0], turned / seconds])[::step][views]
    kinds = np.sign(np.where(np.abs(rate) > TURNS_RAD_S, rate, 0.0))
    lasting = [views[kinds == kind] for kind in (-1.0, 0.0, 1.0) if np.sum(kinds == kind) >= LEAST_VIEWS]
    if len(lasting) < 2:
        return recording
    often = np.all([np.isfinite(some[part]).mean(axis=0) >= SEEN_SHARE for part in lasting], axis=0)
    # most of its readings are near if nearly all are, which takes longer to ask
    often &= np.all([(some[part] <= NEAR_M).mean(axis=0) > 0.5 for part in lasting], axis=0)
    body = np.zeros(some.shape[1], dtype=bool)
    if often.any():
        ends = np.array([np.nanpercentile(some[part][:, often], [5.0, 95.0], axis=0) for part in lasting])
        low, high = ends[:, 0].min(axis=0), ends[:, 1].max(axis=0)
        body[often] = (high - low <= STILL_M) & (high <= NEAR_M)
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
