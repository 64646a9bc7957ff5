"""What to do when the robot no longer knows where it is: stop, look about, drive about, or give up.

Pure bookkeeping over what the localiser says of itself; it never sees a pose.
"""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from turtlebag.datasets.spans import Seconds

Action = Literal["go", "look", "roam", "restart", "give_up"]


class RelocaliseConfig(BaseModel):
    """Seconds, but for `doubts` and `restarts`."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    doubts: int = Field(default=2, ge=1)
    """Filter updates in a row that find the robot lost before it stops."""
    settled: Seconds = 1.0
    """So long the cloud must be narrow and the scans agree before it goes on."""
    look: Seconds = Field(default=5.0, gt=0.0)
    """It turns to and fro for so long; a cloud that is narrow then is trusted: no better place was found."""
    trust: Seconds = 15.0
    """So long it is not asked again whether the scans agree: people and boxes are not on the map."""
    roam: Seconds = Field(default=45.0, gt=0.0)
    """It drives about for so long, touching nothing, until the cloud settles."""
    restarts: int = Field(default=2, ge=0)
    """Then it forgets every pose and begins again, so often; then the goal is given up."""
    tell_apart: Seconds = 120.0
    """Two places look alike: it drives for so long to where they would not; then the goal is given up."""


class Relocaliser:
    """Decides, tick by tick, from `narrow` (the cloud), `agrees` (scans and map) and the updates so far."""

    def __init__(self, config: RelocaliseConfig) -> None:
        self.config = config
        self.action: Action = "go"
        self._since_ns = self._trusted_ns = 0
        self._good_ns: int | None = None
        self._doubts = self._updates = self._updates_then = self._restarts = 0

    def update(self, now_ns: int, narrow: bool, agrees: bool, updates: int) -> Action:
        """What to do now; `restart` and `give_up` are said once."""
        if self.action in ("restart", "give_up"):
            self._enter("look" if self.action == "restart" else "go", now_ns, updates)
        good = narrow and (agrees or now_ns < self._trusted_ns)
        if self.action == "go":
            return self._drive(now_ns, good, updates)
        if not good:
            self._good_ns = None
        elif self._good_ns is None:
            self._good_ns = now_ns
        waited = (now_ns - self._since_ns) * 1e-9
        moved = updates > self._updates_then
        if self._good_ns is not None and moved and now_ns - self._good_ns >= self.config.settled * 1e9:
            return self._found(now_ns, updates)
        if self.action == "look" and waited >= self.config.look:
            if narrow and moved:
                self._trusted_ns = now_ns + round(self.config.trust * 1e9)
                return self._found(now_ns, updates)
            self._enter("roam", now_ns, updates)
        elif self.action == "roam" and waited >= self.config.roam:
            self._begin_again()
        return self.action

    def suspect(self, now_ns: int, updates: int) -> None:
        """Something else speaks for being lost: look about at once."""
        self._enter("look", now_ns, updates)

    def _drive(self, now_ns: int, good: bool, updates: int) -> Action:
        if good:
            self._doubts = 0
        elif updates > self._updates:
            self._doubts += 1
        self._updates = updates
        if self._doubts >= self.config.doubts:
            self._enter("look", now_ns, updates)
        return self.action

    def _found(self, now_ns: int, updates: int) -> Action:
        self._restarts = 0
        self._enter("go", now_ns, updates)
        return self.action

    def _begin_again(self) -> None:
        more = self._restarts < self.config.restarts
        self._restarts = self._restarts + 1 if more else 0
        self.action = "restart" if more else "give_up"

    def _enter(self, action: Action, now_ns: int, updates: int) -> None:
        self.action, self._since_ns, self._good_ns = action, now_ns, None
        self._doubts, self._updates, self._updates_then = 0, updates, updates
