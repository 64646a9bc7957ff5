"""The contract of a front end: it estimates the pose of each scan of a log, in order.

`tracker.Tracker` calls it and does what all front ends share: it corrects the odometry's systematic errors,
uses odometry until the first scan that others can be matched with, selects the key scans, and keeps
the `Track`, the input of loops and refinement. So a front end is one method, and fits on a page.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from turtlebag.datasets.parts import Answer
from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.slam.track import HYPOTHESES


@dataclass(frozen=True, eq=False)
class Placed:
    """Where a scan was taken, and how sure that is.

    `T_track_base` (3,) is the pose of the base at the scan's stamp: x, y [m], yaw [rad] in the frame of the
    track, which is the odometry's at the first scan (identity without odometry). `information` (3, 3) is what
    the scan itself saw of it, in the frame of the base at that pose [1/m^2, 1/(m rad), 1/rad^2], each point
    counted by itself (`align.STEP_INFLATION` allows for their shared errors): zero along a direction that it
    was blind in, and nothing of what the odometry said, which the graph adds. `overlap` is the share 0..1 of
    the scan that lies on what was seen before, `known` that where was looked before, `rmse` how far off it
    lies [m]. `source` says which start won, an index into `track.HYPOTHESES`. Where `sure` is False the scan
    does not become a key scan. `revised` are the scans before it that are now known better, with their poses
    (3,): how they fit is what is said of this one, `source` aside. Key scans keep theirs.
    """

    T_track_base: Array
    information: Array
    overlap: float
    rmse: float = 0.0
    source: int = 0
    sure: bool = True
    revised: tuple[tuple[int, Array], ...] = ()
    known: float = 1.0

    @property
    def agreement(self) -> float:
        """The share of what lies where was looked before that was seen before, 0..1."""
        return self.overlap / self.known if self.known > 0.0 else 1.0


class FrontEnd(Protocol):
    """Places the scans of a log one after another. It may change nothing that it is given."""

    def __init__(self, tracker: Any) -> None:
        """Begin with a `turtlebag.pipeline.slam.tracker.Tracker` on which the first scan stands, a key scan
        that has points: the log as far as it is tracked, to be read at any step."""
        ...

    def step(self, points: Array, odometry_step: Array | None, wait_s: float) -> Placed:
        """Where the next scan was taken.

        `points` (n, 2) are its returns [m] in the frame of the base at its stamp, n may be 0. `odometry_step`
        (3,) is the motion since the scan before as the calibrated odometry has it, seen from there, None
        without odometry; `wait_s` is the time since then [s], below 0 where stamps go back. Which scan it is,
        the pose and motion before, key scans and surfaces are on the tracker, for front ends that need them.
        Where nothing can be said the pose expected is, with information of zero.
        """
        ...


def require_placed(front_end: FrontEnd, placed: object, scan: int) -> None:
    """InputError unless it is what `step` must return of this scan."""
    answer = Answer(front_end, "step")
    answer.require_a(Placed, placed)
    assert isinstance(placed, Placed)
    answer.require_finite("T_track_base", placed.T_track_base, 3)
    answer.require_finite("information", placed.information, 3, 3)
    for what in ("overlap", "known", "rmse"):
        answer.require_finite(what, getattr(placed, what))
    answer.require_kind("sure", placed.sure, bool, np.bool_)
    if not isinstance(placed.source, int | np.integer) or placed.source not in range(len(HYPOTHESES)):
        raise answer.wrong(f"source must be 0 to {len(HYPOTHESES) - 1}, an index into track.HYPOTHESES")
    for one in placed.revised if isinstance(placed.revised, tuple | list) else (placed.revised,):
        pair = one if isinstance(one, tuple | list) and len(one) == 2 else (None, None)
        if not isinstance(pair[0], int | np.integer) or not 0 <= pair[0] < scan:
            raise answer.wrong(f"revised must be scans before this one, 0 to {scan - 1}, with their poses")
        answer.require_finite("a revised pose", pair[1], 3)
