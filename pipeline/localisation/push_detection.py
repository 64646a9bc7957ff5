"""Push detection: a standing robot was pushed if its scans change although its wheels do not turn.

A filter that updates only when the wheels turn (ROS amcl's update_min_d) would not notice; ROS leaves
calling nomotion_update to the user. Here it is called when most of the view has changed since
the robot stopped AND the map explains the scan clearly better from a pose nearby. A person
walking past changes only a part of the view, and no other pose explains it better.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from turtlebag.datasets.se2 import SE2, Array, wrap
from turtlebag.datasets.types import Scan
from turtlebag.pipeline.localisation.agreement import ALIKE, DOUBTFUL, DOUBTS, LONGEST_PAUSE, SETTLING
from turtlebag.pipeline.localisation.local_search import climb
from turtlebag.pipeline.localisation.motion import MIN_STEP_M

# Fixed with walkers who push a standing robot (docs/results_navigation.md); singly not measured.
# A beam has changed beyond the noise of a lidar; a view has when DOUBTFUL of its beams have, in DOUBTS scans.
CHANGED_M = 0.04
# The place found must be so far off [m, rad], and explain the scan clearly better (not ALIKE).
OFF_M, OFF_RAD = 0.025, 0.03
# The cloud is drawn as wide as the place found is off, and at least so wide [m, rad].
LEAST_STD = 0.05


class PushDetector:
    """Compares the scans of a standing robot with the first of them.

    After a push SETTLING scans are held against the map; after a look in vain there is a pause that doubles,
    up to LONGEST_PAUSE [scans].
    """

    def __init__(self) -> None:
        self.pushes = 0
        """How often the robot was found to have been pushed."""
        self.moved()

    def moved(self) -> None:
        """The wheels have turned: start anew; the filter's own updates suffice."""
        self._reference: tuple[Array, SE2] | None = None
        self._changed = self._alert = self._pause = self._next_pause = 0

    def pushed(
        self, scan: Scan, T_odom_base: SE2, pose: Array, agreement: Callable[[Array], Array]
    ) -> Array | None:
        """Standard deviations (3,) for spreading the particles after a push; None without one.

        `pose` (3,) is the estimate, `agreement` rates how well the map explains the scan from poses (n, 3).
        """
        if not self._worth_a_look(scan, T_odom_base):
            return None
        here = float(agreement(pose[None])[0])
        best, found = climb(agreement, pose)
        offset = np.abs(found - pose)
        offset[2] = abs(wrap(offset[2]))
        xy = float(np.hypot(offset[0], offset[1]))
        if best < here + ALIKE or (xy < OFF_M and offset[2] < OFF_RAD):
            self._next_pause = min(max(1, 2 * self._next_pause), LONGEST_PAUSE)
            self._pause = self._next_pause
            return None
        self._reference = (scan.ranges.astype(np.float64), T_odom_base)
        self._alert, self._pause, self._next_pause = SETTLING, 0, 0
        self.pushes += 1
        return np.maximum([xy, xy, float(offset[2])], LEAST_STD)

    def _worth_a_look(self, scan: Scan, T_odom_base: SE2) -> bool:
        """Whether the view has changed for good, or has lately been found to shift."""
        ranges = scan.ranges.astype(np.float64)
        if self._reference is None or not _still(self._reference[1], T_odom_base):
            self.moved()
            self._reference = (ranges, T_odom_base)
            return False
        if changed_share(ranges, self._reference[0]) > DOUBTFUL:
            self._changed += 1
        else:
            self._changed = self._pause = self._next_pause = 0
        if self._alert > 0:
            self._alert -= 1
            return True
        if self._pause > 0:
            self._pause -= 1
            return False
        return self._changed >= DOUBTS


def changed_share(ranges: Array, before: Array) -> float:
    """Share of the beams (n,) with a return in either scan that see farther or nearer than before."""
    seen = np.isfinite(ranges) | np.isfinite(before)
    if not seen.any():
        return 0.0
    with np.errstate(invalid="ignore"):
        same = np.abs(ranges - before) <= CHANGED_M
    return 1.0 - float(same[seen].mean())


def _still(one: SE2, other: SE2) -> bool:
    """Whether odometry has moved by less than what has a direction [m], or so much [rad]."""
    x, y, yaw = (one.inverse() @ other).xyt.tolist()
    return bool(np.hypot(x, y) < MIN_STEP_M and abs(yaw) < MIN_STEP_M)
