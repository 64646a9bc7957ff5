"""Self-check: is this map good? Without ground truth.

Revisit consistency: two key scans at the same place must see the same walls. If one saw through
what the other saw as a wall, the map is doubled or folded there. Map entropy: the uncertainty of the cells.
Lost scans: poses constrained by neither walls nor odometry. Impossible motions: jumps, and slides sideways.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.motion import FASTER, GAP_S, without_gap
from turtlebag.datasets.plurals import counted, verb
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.check.base import Verdict
from turtlebag.pipeline.slam.check.uncertainty import position_sigmas, shared_errors
from turtlebag.pipeline.slam.grid import Certainty
from turtlebag.pipeline.slam.loops.free_space import free_space_violations, thinned, visits
from turtlebag.pipeline.slam.odometry.evidence import Evidence
from turtlebag.pipeline.slam.odometry.track import AGREE_M, HYPOTHESES, Track
from turtlebag.pipeline.slam.sensors.stretches import odometry_stream, usual_period
from turtlebag.pipeline.slam.sessions import Session

# Visits this many key scans apart are a revisit. This share of free-space violations marks a place as bad.
APART_KEYS, BAD_SHARE = 30, 0.35
# At most this share of the places, or of the scans, may be wrong; and at most this many key scans, however
# long the log, may contradict most of their revisits.
MOST_WRONG, MOST_CONTRADICTED = 0.05, 4
# If the standard deviation of some scans by the graph is larger than this [m], the worst of them may be 0.2 m
# off: the true error was 1.4 to 6 times as large (ten logs of 20 m to 2 km with known poses).
LEAST_SURE_M = 0.1


@dataclass(frozen=True, eq=False)
class SelfCheck(Verdict):
    """The numbers of the check and the reasons for doubt; `violations` is (n, 3): key i, key j, the share of
    points that violate the other's free space."""

    revisits: int
    mean_violation: float
    bad_places: float
    lost_scans: int
    position_sigma_m: float
    map_entropy_bits: float
    wall_share: float
    violations: Array
    reasons: tuple[str, ...]


def check_map(session: Session, T_map_base: SE2, certainty: Certainty) -> SelfCheck:
    """Check a finished map with these poses of all scans (n,). `certainty` is the grid's."""
    recording, evidence, breaks = session.recording, session.evidence, session.unconfirmed
    track, T_map_keys = session.track, session.graph.T_map_keys
    pairs = revisits_of(T_map_keys)
    share = free_space_violations(*session.key_scans, T_map_keys.xyt, pairs)
    known = np.isfinite(share)
    pairs, share = pairs[known], share[known]
    mean = float(share.mean()) if len(share) else 0.0
    bad = float(np.mean(share > BAD_SHARE)) if len(share) else 0.0
    lost = np.flatnonzero(track.usable & ~track.fits)
    reasons = []
    alone = contradicted_keys(pairs, share, BAD_SHARE)
    if bad > MOST_WRONG or len(alone) > MOST_CONTRADICTED:
        worst = pairs[int(np.argmax(share))]
        x, y = T_map_keys.xy[worst[0]]
        reasons.append(
            f"revisited places contradict each other (worst near x {x:.1f}, y {y:.1f}): "
            "the map is folded or doubled"
        )
    if len(lost) > MOST_WRONG * len(track.usable):
        many = counted(len(lost), "scan")
        reasons.append(f"{many} {verb(len(lost), 'does', 'do')} not fit the map (first: scan {lost[0]})")
    if len(breaks):
        reasons.append(
            f"{counted(len(breaks), 'break')} where scans are missing, or fit nothing seen before, and "
            f"nothing confirms the odometry (first: before scan {breaks[0]}): what follows may be misplaced"
        )
    if recording.turned_over:
        reasons.append(
            "scans and odometry turn in opposite directions, and there is no gyro to decide: "
            "if the scans are right, this map is mirrored"
        )
    reasons += _merged(recording)
    empty = int(np.count_nonzero(~track.usable))
    if empty > MOST_WRONG * len(track.usable):
        reasons.append(f"{counted(empty, 'scan')} {verb(empty, 'sees', 'see')} no surface")
    reasons += _jumps(evidence, T_map_base, _steps_in_gap(recording))
    slid = slides(recording, T_map_base, evidence.borders)
    if len(slid):
        reasons.append(
            f"the path slides sideways as wheels cannot (first: at scan {slid[0]}): the map may be torn there"
        )
    constraints, unobserved_m = session.graph.constraints, evidence.unobserved_m
    asked, sigmas = position_sigmas(T_map_keys, constraints, shared_errors(track, constraints, unobserved_m))
    sigma = float(sigmas.max())
    if sigma > LEAST_SURE_M:
        x, y = T_map_keys.xy[asked[sigmas.argmax()]]
        missed = unobserved_m.sum()
        blind = f"; scans and odometry missed {missed:.1f} m of the path" if missed > 0.0 else ""
        reasons.append(
            f"the pose graph is uncertain near x {x:.1f}, y {y:.1f} by {sigma:.2f} m (one standard "
            f"deviation): the map may be bent there{blind}"
        )
    violations = np.column_stack([pairs, share])
    decided = certainty.entropy_bits, certainty.wall_share
    return SelfCheck(len(share), mean, bad, len(lost), sigma, *decided, violations, tuple(reasons))


def revisits_of(T_map_keys: SE2) -> NDArray[np.int64]:
    """Pairs (n, 2) of keys that are near in place and far in time, in order."""
    pairs = visits(T_map_keys.xy)
    return thinned(pairs[np.abs(pairs[:, 1] - pairs[:, 0]) >= APART_KEYS])


def contradicted_keys(pairs: NDArray[np.int64], share: Array, limit: float) -> NDArray[np.int64]:
    """Keys contradicted (by more than `limit`) in more than half of their revisits: even a few in a long log
    are in a wrong place."""
    n = int(pairs.max()) + 1 if len(pairs) else 0
    visits = np.bincount(pairs.ravel(), minlength=n)
    against = np.bincount(pairs[share > limit].ravel(), minlength=n)
    return np.flatnonzero(2 * against > visits)


def _merged(recording: Recording) -> list[str]:
    """Whether parts of the scans were taken at different times."""
    if (apart_s := recording.times.apart_s) == 0.0:
        return []
    return [
        f"parts of each scan disagree about the motion by up to {apart_s:.2f} s (two lidars merged without "
        "synchronisation?): walls are drawn twice where the robot turns"
    ]


def _jumps(evidence: Evidence, T_map_base: SE2, steps_in_gap: int) -> list[str]:
    """Whether the robot moved farther than it can, from scan to scan or over a longer time."""
    for over in (1, steps_in_gap):
        jumped = evidence.jumps(T_map_base, over)
        if len(jumped):
            many, first = counted(len(jumped), "jump"), jumped[0, 1]
            return [f"{many} farther than the robot can drive (first: to scan {first})"]
    return []


def _steps_in_gap(recording: Recording) -> int:
    """The usual number of steps in GAP_S."""
    return max(1, round(GAP_S / usual_period(recording)))


def slides(recording: Recording, T_map_base: SE2, borders: NDArray[np.int64]) -> NDArray[np.int64]:
    """Scans (k,) up to which the poses (n,) slid sideways, over as many steps as GAP_S usually has, farther
    than the robot's wheels ever go by the odometry; none without odometry.

    How the robot drove between scans that are far apart only odometry that came meanwhile tells.
    """
    if recording.T_odom_base is None:
        return np.zeros(0, dtype=np.int64)
    stream, stamps_ns = odometry_stream(recording), recording.stamps_ns
    slid = np.where(_together(stream.stamps_ns), _sideways(stream.poses), 0.0)
    slid = np.interp(stamps_ns, stream.stamps_ns, np.append(0.0, np.cumsum(slid)))
    by_odometry = np.abs(np.diff(slid))
    aside = _sideways(T_map_base)
    aside = np.where(_together(stamps_ns), aside, np.clip(aside, -by_odometry, by_odometry))
    aside[borders - 1] = 0.0
    usual = np.quantile(by_odometry, 1.0 - MOST_WRONG) if len(by_odometry) else 0.0
    total, over = np.append(0.0, np.cumsum(aside)), _steps_in_gap(recording)
    far = np.abs(total[over:] - total[:-over]) > AGREE_M + FASTER * over * usual
    return over + np.flatnonzero(far)


def _together(stamps_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of these stamps (n,) are followed by the next without a gap, (n - 1,)."""
    return without_gap(seconds(np.diff(stamps_ns)))


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
