"""Break detection: steps of a track whose motion neither scans nor odometry confirm.

The motion between two scans is measured twice, by the scans and by the odometry. If scans are missing for a
while, or one fits nothing seen before, and the two do not clearly confirm each other, the track
is broken: the robot may be anywhere. Where scans are blind along a corridor, drift grows faster than
elsewhere. Both determine how far off a place may be when the robot returns to it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.motion import gap_s, gaps_between
from turtlebag.pipeline.slam.odometry.evidence import Evidence
from turtlebag.pipeline.slam.odometry.track import Track

# After a wait shorter than this many of the shortest gaps, odometry alone may determine a blind direction,
# because it says nothing impossible. After a longer one it may be metres off (MIT CSAIL, 20 s without a
# scan: 1.6 m after 19 m there and back), and a scan aligned from its prediction agrees with it in any case:
# most of the scan must then lie on known surfaces.
SHORT_GAPS, SURE_OVERLAP = 2.5, 0.8


@dataclass(frozen=True, eq=False)
class TrackBreaks:
    """Per step between successive key scans (keys - 1,): whether it is broken (nothing confirms it), whether
    scans and odometry contradict each other, whether only odometry observed it. `gaps` (n, 2) are the last
    scan before and the first after each break."""

    broken: NDArray[np.bool_]
    contradicted: NDArray[np.bool_]
    alone: NDArray[np.bool_]
    gaps: NDArray[np.int64]

    def segments(self) -> NDArray[np.int64]:
        """The number of the unbroken part that each key belongs to, (keys,)."""
        return np.concatenate([[0], np.cumsum(self.broken)])

    def first(self, steps: int) -> TrackBreaks:
        """Its first `steps` steps."""
        return replace(
            self,
            broken=self.broken[:steps],
            contradicted=self.contradicted[:steps],
            alone=self.alone[:steps],
        )

    def still_open(self, unbridged: NDArray[np.bool_]) -> TrackBreaks:
        """Only the unbridged breaks, `unbridged` (keys - 1,)."""
        broken = self.broken & unbridged
        return TrackBreaks(broken, self.contradicted & broken, self.alone & broken, self.gaps)


def joined_breaks(a: TrackBreaks, b: TrackBreaks, scans: int, *, broken: bool = False) -> TrackBreaks:
    """The breaks of two recordings, one located in the map of the other, or not yet: then there is one
    between them. `scans` is the number of scans of the first."""
    border, no = np.array([broken]), np.zeros(1, dtype=bool)
    return TrackBreaks(
        np.concatenate([a.broken, border, b.broken]),
        np.concatenate([a.contradicted, border, b.contradicted]),
        np.concatenate([a.alone, no, b.alone]),
        np.concatenate([a.gaps, b.gaps + scans]),
    )


def breaks_of(track: Track, evidence: Evidence) -> TrackBreaks:
    """Judge every step between the key scans of a track."""
    T, keys, stamps_ns = track.T_track_base, track.keys, evidence.stamps_ns
    sure = ~evidence.blind & (track.overlap >= SURE_OVERLAP)
    short_s = SHORT_GAPS * gap_s(seconds(np.diff(stamps_ns)))
    broken, contradicted, alone = np.zeros((3, len(keys) - 1), dtype=bool)
    gaps = []
    # the first scan that fits nothing seen just before follows a gap, whatever the stamps say
    strange = track.usable & ~track.fits
    first = 1 + np.flatnonzero(strange[1:] & ~strange[:-1])
    missing = gaps_between(stamps_ns, track.usable)
    waited = np.unique(np.concatenate([missing, np.stack([first - 1, first], axis=1)]), axis=0)
    for (before, after), fast in zip(waited, evidence.too_fast(T, *waited.T), strict=True):
        step = int(np.searchsorted(keys, after)) - 1
        if not 0 <= step < len(keys) - 1:
            continue
        agreed = evidence.agreed(T, before, after) and not fast
        wait = seconds(int(stamps_ns[after] - stamps_ns[before]))
        fits = track.fits[after]
        if not (agreed and fits and (wait < short_s or sure[after])):
            broken[step] = True
            contradicted[step] |= not agreed
            alone[step] |= not fits
            gaps.append((before, after))
    between = np.array(gaps, dtype=np.int64).reshape(-1, 2)
    return TrackBreaks(broken, contradicted, alone, between)
