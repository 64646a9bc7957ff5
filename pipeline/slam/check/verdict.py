"""Self-check: is this map good? Without ground truth.

Revisit consistency: two key scans at the same place must see the same walls. If one saw through
what the other saw as a wall, the map is doubled or folded there. Map entropy: the uncertainty of the cells.
Lost scans: poses constrained by neither walls nor odometry. Impossible motions: jumps, and slides sideways.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.motion import FASTER, GAP_PERIODS, gap_s, way_and_turn, without_gap
from turtlebag.datasets.plurals import counted, verb
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.check.base import Verdict
from turtlebag.pipeline.slam.check.p_bad import Term, doublings, p_bad, reasons, sizes
from turtlebag.pipeline.slam.check.size import Size, size_of
from turtlebag.pipeline.slam.check.uncertainty import Uncertainty
from turtlebag.pipeline.slam.graph.constraints import Kind
from turtlebag.pipeline.slam.graph.cost import mahalanobis
from turtlebag.pipeline.slam.grid import Certainty
from turtlebag.pipeline.slam.loops.free_space import free_space_violations, thinned, visits
from turtlebag.pipeline.slam.odometry.evidence import Evidence
from turtlebag.pipeline.slam.odometry.track import AGREE, AGREE_M, HYPOTHESES, Track
from turtlebag.pipeline.slam.sessions import Session

# Visits this many key scans apart are a revisit. This share of free-space violations marks a place as bad.
APART_KEYS, BAD_SHARE = 30, 0.35
# At most this share of the scans may be wrong.
MOST_WRONG = 0.05
# What good maps may have, as people and doors are seen once and not again: this share of contradictory
# revisits, and this many key scans, however long the log, that contradict most of their revisits.
USUAL_SHARE, USUAL_KEYS = 0.04, 4
# What good maps may have: the largest standard deviation of a key scan [m], of which two are the error of a
# bad map, and the mean robust residual of pairs, which people and rough walls double in real logs.
SURE_M, USUAL_APART = 0.10, 0.08


@dataclass(frozen=True, eq=False)
class SelfCheck(Verdict):
    """The numbers of the check and the reasons for doubt; `p_bad` is the probability that the map is bad, and
    `terms` what of it each kind of evidence gives. `violations` is (n, 3): key i, key j, the share of points
    that violate the other's free space."""

    p_bad: float
    revisits: int
    mean_violation: float
    bad_places: float
    lost_scans: int
    position_sigma_m: float
    map_entropy_bits: float
    wall_share: float
    violations: Array
    terms: dict[str, float]
    reasons: tuple[str, ...]
    size: Size = field(default_factory=Size)

    def as_metrics(self) -> dict[str, Any]:
        """The numbers, the terms, and `scale`: how well the map's size is known."""
        return {**super().as_metrics(), "terms": self.terms, **self.size.as_metrics()}


def check_map(session: Session, T_map_base: SE2, certainty: Certainty, uncertainty: Uncertainty) -> SelfCheck:
    """Check a finished map with these poses of all scans (n,). `certainty` is the grid's, `uncertainty` that
    of the session's graph."""
    track, T_map_keys = session.track, session.graph.T_map_keys
    pairs = revisits_of(T_map_keys)
    share = free_space_violations(*session.key_scans, T_map_keys.xyt, pairs)
    known = np.isfinite(share)
    pairs, share = pairs[known], share[known]
    asked, sigmas = uncertainty.position_sigmas()
    terms = [
        *_contradicted(T_map_keys, pairs, share),
        *_scans(track),
        *(Term("motion", 1.0, reason) for reason in _motion(session, T_map_base)),
        *_uncertain(T_map_keys.xy[asked[sigmas.argmax()]], float(sigmas.max()), session.evidence),
        *_walls(session),
    ]
    return SelfCheck(
        p_bad(terms),
        len(share),
        float(share.mean()) if len(share) else 0.0,
        float(np.mean(share > BAD_SHARE)) if len(share) else 0.0,
        int(np.count_nonzero(track.usable & ~track.fits)),
        float(sigmas.max()),
        certainty.entropy_bits,
        certainty.wall_share,
        np.column_stack([pairs, share]),
        sizes(terms),
        reasons(terms),
        size_of(session.setup),
    )


def _contradicted(T_map_keys: SE2, pairs: NDArray[np.int64], share: Array) -> Iterator[Term]:
    """Places that two visits saw differently."""
    if len(share) == 0:
        return
    alone = contradicted_keys(pairs, share, BAD_SHARE)
    against = max(float(np.mean(share > BAD_SHARE)) / USUAL_SHARE, len(alone) / USUAL_KEYS)
    x, y = T_map_keys.xy[pairs[int(np.argmax(share))][0]]
    yield Term(
        "contradicted",
        doublings(against, 1.0),
        f"revisited places contradict each other (worst near x {x:.1f}, y {y:.1f}): "
        "the map is folded or doubled",
    )


def _scans(track: Track) -> Iterator[Term]:
    """Scans that fit nothing, or have nothing to fit."""
    many = MOST_WRONG * len(track.usable)
    lost, empty = np.flatnonzero(track.usable & ~track.fits), int(np.count_nonzero(~track.usable))
    if len(lost):
        n, does = counted(len(lost), "scan"), verb(len(lost), "does", "do")
        yield Term("scans", len(lost) / many, f"{n} {does} not fit the map (first: scan {lost[0]})")
    if empty:
        sees = verb(empty, "sees", "see")
        yield Term("scans", empty / many, f"{counted(empty, 'scan')} {sees} no surface")


def _motion(session: Session, T_map_base: SE2) -> Iterator[str]:
    """Breaks that nothing bridges, a log that may be mirrored, lidars that disagree, and motions that the
    robot cannot have made."""
    breaks, apart_s, evidence = session.unconfirmed, session.recording.times.apart_s, session.evidence
    if len(breaks):
        yield (
            f"{counted(len(breaks), 'break')} where scans are missing, or fit nothing seen before, and "
            f"nothing confirms the odometry (first: before scan {breaks[0]}): what follows may be misplaced"
        )
    if session.recording.turned_over:
        yield (
            "scans and odometry turn in opposite directions, and there is no gyro to decide: "
            "if the scans are right, this map is mirrored"
        )
    if apart_s > 0.0:
        yield (
            f"parts of each scan disagree about the motion by up to {apart_s:.2f} s (two lidars merged "
            "without synchronisation?): walls are drawn twice where the robot turns"
        )
    moved = _back_in_time(evidence) or _jumped(evidence, T_map_base) or _slid(session, T_map_base)
    if moved:
        yield moved


def _uncertain(xy: Array, sigma: float, evidence: Evidence) -> Iterator[Term]:
    """A graph that leaves a key scan open, whose place is `xy` (2,)."""
    missed = evidence.unobserved_m.sum()
    blind = f"; scans and odometry missed {missed:.1f} m of the path" if missed > 0.0 else ""
    yield Term(
        "uncertain",
        doublings(sigma, SURE_M),
        f"the pose graph is uncertain near x {xy[0]:.1f}, y {xy[1]:.1f} by {sigma:.2f} m (one standard "
        f"deviation): the map may be bent there{blind}",
    )


def _walls(session: Session) -> Iterator[Term]:
    """Walls that are thicker than the lidar's noise makes them: scans that overlap do not fit together."""
    pairs = [c for c in session.graph.constraints if c.kind is Kind.PAIR]
    if pairs:
        apart = np.log1p(mahalanobis(session.graph.T_map_keys, pairs) / 3.0)
        i, mean = int(np.argmax(apart)), float(np.mean(apart))
        x, y = session.graph.T_map_keys.xy[pairs[i].i]
        yield Term(
            "thick",
            doublings(mean, USUAL_APART),
            f"scans of the same place do not fit together (worst near x {x:.1f}, y {y:.1f}), and walls are "
            "thick: are the lidar's times and angles right?",
        )


def revisits_of(T_map_keys: SE2) -> NDArray[np.int64]:
    """Pairs (n, 2) of keys that are near in place and far in time, in order."""
    pairs = visits(T_map_keys.xyt)
    return thinned(pairs[np.abs(pairs[:, 1] - pairs[:, 0]) >= APART_KEYS])


def contradicted_keys(pairs: NDArray[np.int64], share: Array, limit: float) -> NDArray[np.int64]:
    """Keys contradicted (by more than `limit`) in more than half of their revisits: even a few in a long log
    are in a wrong place."""
    n = int(pairs.max()) + 1 if len(pairs) else 0
    visits = np.bincount(pairs.ravel(), minlength=n)
    against = np.bincount(pairs[share > limit].ravel(), minlength=n)
    return np.flatnonzero(2 * against > visits)


def _jumped(evidence: Evidence, T_map_base: SE2) -> str | None:
    """Whether the robot moved farther than it can, from scan to scan or over a longer time."""
    for over in (1, GAP_PERIODS):
        jumped = evidence.jumps(T_map_base, over)
        if len(jumped):
            many, first = counted(len(jumped), "jump"), jumped[0, 1]
            return f"{many} farther than the robot can drive (first: to scan {first})"
    return None


def _back_in_time(evidence: Evidence) -> str | None:
    """Whether the clock went back within a log by more than a gap: scans and odometry may not belong to each
    other from there on. Shorter steps back are messages out of order."""
    waits = seconds(np.diff(evidence.stamps_ns))
    back = np.setdiff1d(1 + np.flatnonzero(waits < -gap_s(waits)), evidence.borders)
    if not len(back):
        return None
    return (
        f"the stamps go back by {-waits[back[0] - 1]:.1f} s (first: at scan {back[0]}): "
        "scans and odometry may be of different times from there on"
    )


def _slid(session: Session, T_map_base: SE2) -> str | None:
    slid = slides(session.recording, T_map_base, session.evidence.borders)
    told = "the path slides sideways as wheels cannot (first: at scan {}): the map may be torn there"
    return told.format(slid[0]) if len(slid) else None


def slides(recording: Recording, T_map_base: SE2, borders: NDArray[np.int64]) -> NDArray[np.int64]:
    """Scans (k,) up to which the poses (n,) slid sideways, over GAP_PERIODS steps, farther for the way driven
    than the wheels ever go by the odometry; none without odometry, or across a gap."""
    if recording.T_odom_base is None:
        return np.zeros(0, dtype=np.int64)
    known, over = without_gap(seconds(np.diff(recording.stamps_ns))), GAP_PERIODS
    known[borders - 1] = False
    usual = np.quantile(np.abs(_sideways(recording.T_odom_base)), 1.0 - MOST_WRONG) if len(known) else 0.0
    aside = np.where(known, _sideways(T_map_base), 0.0)
    most = AGREE * way_and_turn(T_map_base.steps())[:, 0] + FASTER * usual
    aside, most = (np.append(0.0, np.cumsum(steps)) for steps in (aside, most))
    far = np.abs(aside[over:] - aside[:-over]) > AGREE_M + most[over:] - most[:-over]
    return over + np.flatnonzero(far)


def _sideways(T_map_base: SE2) -> Array:
    """How far each step of poses (n,) leads to the left of every way along which wheels can roll while they
    turn so far to one side, (n - 1,) [m]."""
    x, y, turn = T_map_base.steps().T
    left = np.cos(0.5 * turn) * y - np.sin(0.5 * turn) * x
    return np.sign(left) * np.maximum(np.abs(left) - np.hypot(x, y) * np.abs(np.sin(0.5 * turn)), 0.0)


def hypothesis_shares(track: Track) -> dict[str, float]:
    """How often each start of the front end won."""
    counts = np.bincount(track.source[1:], minlength=len(HYPOTHESES))
    total = max(int(np.sum(counts)), 1)
    return {name: float(count) / total for name, count in zip(HYPOTHESES, counts, strict=True)}
