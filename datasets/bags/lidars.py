"""Which scan topics of a bag are lidars of the robot, and their scans as those of one recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.bags.plausibility import CLOCK_NS
from turtlebag.datasets.findings import Finding, lines_of
from turtlebag.datasets.lidars import together
from turtlebag.datasets.plurals import listed
from turtlebag.datasets.se2 import SE2, Array, wrap
from turtlebag.datasets.types import Recording, Stamps

_SAMPLES = 30
"""Scans of a topic that are compared with those of others."""
_EQUAL_M = 2e-4
"""Readings that differ by less were computed from each other: no two lidars measure so alike."""
_BEAMS_APART = 1.5
"""Beams that such a reading may lie beside the original: it was put on another grid."""
_DERIVED = 0.6
"""Share of a topic's returns that are others' if all are, but for those at edges and in overlaps."""


@dataclass(frozen=True, eq=False)
class LidarTopic:
    """The scans of one topic, their recording times [ns], and the frame of its lidar."""

    scans: Recording
    log_times: Stamps
    frame: str

    @property
    def name(self) -> str:
        """The topic."""
        return self.scans.topic

    @property
    def lag_ns(self) -> float:
        """How long after its stamp a scan was recorded."""
        return float(np.median(self.log_times - self.scans.stamps_ns))


def in_one(topics: Sequence[LidarTopic], findings: list[Finding]) -> Recording:
    """One recording of the scans of several topics, in the order in which they were recorded."""
    parts = [topic.scans for topic in topics]
    # the messages of each keep their order in the file
    times = np.concatenate([np.maximum.accumulate(topic.log_times) for topic in topics])
    order = np.argsort(times, kind="stable")
    poses = [part.T_odom_base.xyt for part in parts if part.T_odom_base is not None]
    whole = len(poses) == len(parts)
    return replace(
        together(parts, order),
        T_odom_base=SE2(np.concatenate(poses)[order]) if whole else None,
        odometry=parts[0].odometry if whole else None,
        notes=lines_of(findings),
        findings=tuple(dict.fromkeys(findings)),
    )


def lidars_among(topics: Sequence[LidarTopic], findings: list[Finding]) -> list[LidarTopic]:
    """Those that are lidars of their own, the first one among them if possible; for each of the others a
    finding says why it is left out."""
    kept: list[LidarTopic] = []
    for topic in topics:
        same = next((one for one in kept if one.frame == topic.frame), None)
        if same is not None:
            what = f"its frame '{topic.frame}' is that of {same.name}: scans of one lidar"
            findings.append(_left_out(topic, what))
        elif kept and abs(topic.lag_ns - kept[0].lag_ns) > CLOCK_NS:
            findings.append(_left_out(topic, f"its clock is not that of {kept[0].name}"))
        else:
            kept.append(topic)
    while (derived := _most_derived(kept)) is not None:
        kept.remove(derived)
        findings.append(_left_out(derived, f"its points are those of {listed([one.name for one in kept])}"))
    return kept


def _left_out(topic: LidarTopic, what: str) -> Finding:
    return Finding("scans left out", topic.name, what, len(topic.scans), remedy="left out; --topic maps it")


def _most_derived(topics: Sequence[LidarTopic]) -> LidarTopic | None:
    """A topic whose points are those of others: of several the one that needs most of them, or the last."""
    found: list[tuple[float, LidarTopic]] = []
    for topic in topics:
        others = [one for one in topics if one is not topic]
        if others and _share(topic.scans, others) >= _DERIVED:
            found.append((max(_share(topic.scans, [one]) for one in others), topic))
    # a merged topic is that of two others, and each of these is contained in it
    return min(reversed(found), key=lambda pair: round(pair[0], 1), default=(0.0, None))[1]


def _share(scans: Recording, others: Sequence[LidarTopic]) -> float:
    """The share of the returns that others measured, too, in half of the scans or more."""
    some = np.unique(np.linspace(0, len(scans) - 1, _SAMPLES).astype(int)).tolist()
    shares = [_share_of(scans, k, others) for k in some if scans.scan(k).valid().any()]
    return float(np.median(shares)) if shares else 0.0


def _share_of(scans: Recording, k: int, others: Sequence[LidarTopic]) -> float:
    scan = scans.scan(k)
    equal = partial(_equal, scan.lidar.angles[scan.valid()], scan.ranges[scan.valid()].astype(np.float64))
    known = np.zeros(int(scan.valid().sum()), dtype=bool)
    for other in others:
        stamps = other.scans.stamps_ns
        before = int(np.searchsorted(stamps, scan.stamp_ns, side="right")) - 1
        T = scans.T_base_lidar.inverse() @ other.scans.T_base_lidar
        apart = _BEAMS_APART * max(abs(scan.lidar.angle_increment), abs(other.scans.lidar.angle_increment))
        near = {min(max(number, 0), len(stamps) - 1) for number in (before, before + 1)}
        seen = [equal(T @ other.scans.scan(number).points_lidar(), apart) for number in sorted(near)]
        known |= max(seen, key=np.count_nonzero)
    return float(known.mean())


def _equal(angles: Array, ranges: Array, points: Array, apart: float) -> NDArray[np.bool_]:
    """Which readings (n,) are those of points (m, 2) in the same frame, within so many [rad]."""
    near = np.abs(ranges[:, None] - np.hypot(points[:, 0], points[:, 1])) < _EQUAL_M
    reading, point = np.nonzero(near)
    bearing = np.arctan2(points[point, 1], points[point, 0])
    out = np.zeros(len(ranges), dtype=bool)
    out[reading[np.abs(wrap(bearing - angles[reading])) < apart]] = True
    return out
