"""Augmented MCL: the agreement of scans and map, and the share of random particles that follows from it.

Probabilistic Robotics, section 8.3.5: random particles are mixed in by how far a fast average of the
agreement is below a slow one. Here they come from a search (see global_search), which is expensive, so when
to search is also decided here.
"""

from __future__ import annotations

from turtlebag.pipeline.localisation.parameters import AmclConfig

# Two places look alike if their agreement, a share of the beams, differs by less than the first, and are
# clearly different if it differs by more than the second: a scan agrees with the map of its place to a few
# hundredths. The exact numbers are not measured.
ALIKE, DIFFERENT = 0.05, 0.1
# Agreement of scan and map at the right place before the first scan: the start of both averages. From 1 on, a
# robot kidnapped in the house is found after 3, 1, 6 and 1 s instead of 1, 1, 0 and 1.
NOMINAL_AGREEMENT = 0.8
# A drop of the agreement by this share of the beams is a reason for doubt; a smaller one is people and boxes
# in view. Random particles are mixed in from this share on; a single scan this far below the usual agreement
# contradicts the estimate.
DOUBTFUL = 0.25
# A single scan may be noise: this many in a row are not, and this many settle a question (not measured).
DOUBTS, SETTLING = 2, 6
# Filter updates from one search to the next; with 64, or 24 where the agreement has faded, 13 episodes of
# lost robots are found in the same times.
PAUSE = 32
# An agreement below this share of the best so far is a reason for a search: without it, a robot kidnapped in
# the house noticed later and was at its goal after 94 s instead of 71 s.
FADED = 0.9


class AgreementWatch:
    """Averages of the agreement over the filter's updates, and when to search."""

    def __init__(self, config: AmclConfig, *, anywhere: bool = False) -> None:
        self.anywhere = anywhere
        """After a global start the robot may be anywhere, and no scan has been explained yet."""
        self.updates = 0
        self.slow = NOMINAL_AGREEMENT
        self.fast = 0.0 if anywhere else NOMINAL_AGREEMENT
        self.best = 0.0
        """The highest fast average so far."""
        self._config = config
        self._next_search = 0

    def update(self, agreement: float) -> None:
        """Add the agreement 0..1 of a scan at the new estimate."""
        self.slow += self._config.recovery_alpha_slow * (agreement - self.slow)
        self.fast += (1.0 if self.anywhere else self._config.recovery_alpha_fast) * (agreement - self.fast)
        self.anywhere = self.anywhere and agreement == 0.0
        self.best = max(self.best, self.fast)
        self.updates += 1

    def confirm(self) -> None:
        """A search has led back to the estimate: as scans agree with the map there, so they usually do.

        Else a robot whose scans never agree as well as at the start (noise of 5 cm, three beams of ten lost)
        would be right all along and never sure of it.
        """
        self.slow = min(self.slow, self.fast)

    def contradicted_by(self, agreement: float) -> bool:
        """Whether a scan with this agreement contradicts the estimate."""
        return agreement < (1.0 - DOUBTFUL) * self.slow

    def random_share(self) -> float:
        """Share of random particles: how far the fast average of the agreement is below the slow one."""
        if self._config.recovery_alpha_slow <= 0.0 or self.slow <= 0.0:
            return 0.0
        share = 1.0 - self.fast / self.slow
        return share if share >= DOUBTFUL else 0.0

    def search_share(self) -> float:
        """Share of particles to draw from a search now: all after a global start, then at intervals where
        scans agree less than they once did.

        At an alias of the true place almost everything agrees, and only a search shows that the true one
        agrees better. At intervals, so that a place that does not look like the map (a moved wardrobe) does
        not cost a search per scan.
        """
        if self.anywhere:
            return 1.0
        share = self.random_share()
        if (share == 0.0 and self.fast >= FADED * self.best) or self.updates < self._next_search:
            return 0.0
        self._next_search = self.updates + PAUSE
        return share or DOUBTFUL
