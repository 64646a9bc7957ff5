"""The doctor's checks for what cannot be: clocks that stand, two sensors in one, millimetres."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from turtlebag.datasets.bags.survey import Finding, Survey
from turtlebag.datasets.bags.topics import ODOMETRY, SCAN, TRANSFORMS
from turtlebag.datasets.bags.units import (
    ARM_M,
    driven_in_millimetres,
    far_away,
    ranges_in_millimetres,
    stands_still,
)
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Stamps


def still_clocks(found: Survey) -> Iterator[Finding]:
    """Topics and links whose stamps never change."""
    clocks = {
        name: topic.stamps for name, topic in found.topics.items() if topic.topic.msgtype not in TRANSFORMS
    }
    moving = {link: times for link, times in found.link_stamps.items() if link in found.frames.moving}
    clocks |= {f"/tf: {parent} -> {child}": times for (parent, child), times in moving.items()}
    breaks = "tf2 and message filters cannot match by it; here the recording times are used"
    for name, stamps in clocks.items():
        if stands_still(stamps):
            what = f"{name}: all {len(stamps)} stamps are {stamps[0] * 1e-9:g} s"
            yield Finding("error", "no time", what, breaks)


def mixed_frames(found: Survey) -> Iterator[Finding]:
    """Topics that carry the messages of several sensors or robots."""
    for topic in found.of_type(SCAN, ODOMETRY):
        for frames in (topic.frames, topic.children):
            if len(frames) > 1:
                named = ", ".join(f"'{name}' ({count})" for name, count in frames.most_common())
                what = f"{topic.topic.name}: messages of {len(frames)} frames: {named}"
                breaks = (
                    "two sensors or robots on one topic look like one that jumps; the most frequent is used"
                )
                yield Finding("error", "mixed frames", what, breaks)


def places(found: Survey) -> Iterator[Finding]:
    """Transforms and poses beyond the Earth."""
    for parent, child in sorted(found.frames.far):
        what = f"/tf or /tf_static: {parent} -> {child} is farther than any place on Earth"
        yield Finding("error", "absurd places", what, "viewers break; here it is left out")
    for topic in found.of_type(ODOMETRY):
        if count := sum(map(far_away, topic.places)):
            what = f"{topic.topic.name}: {count} poses are farther than any place on Earth"
            yield Finding("error", "absurd places", what, "here they are left out")


def units(found: Survey) -> Iterator[Finding]:
    """Readings, poses and places in millimetres."""
    for name, scans in found.scans.items():
        (_, _, _, _, _, _, range_max), _ = scans.geometries.most_common(1)[0][0]
        if ranges_in_millimetres(np.concatenate(scans.some), range_max):
            what = f"{name}: the readings are longer than any lidar's"
            breaks = "every reader reads them as metres; here they are read as millimetres"
            yield Finding("error", "millimetres", what, breaks)
    for name, stamps, places in _driven(found):
        if driven_in_millimetres(stamps, places):
            what = f"{name}: the robot would be faster than any"
            breaks = "every reader reads the poses as metres; here they are read as millimetres"
            yield Finding("error", "millimetres", what, breaks)
    base = found.base()
    for topic in found.of_type(SCAN):
        for frame in topic.frames:
            T = found.frames.lookup(base, frame)
            if T is not None and (arm := float(np.linalg.norm(T[:3, 3]))) > ARM_M:
                what = f"{topic.topic.name}: its frame '{frame}' lies {arm:.4g} m from '{base}'"
                breaks = "no robot is that large; mapping refuses it, --laser X,Y,YAW sets the position"
                yield Finding("error", "millimetres", what, breaks)


def _driven(found: Survey) -> Iterator[tuple[str, Stamps, Array]]:
    """Name, stamps (n,) and positions (n, 2) of whatever tells where the robot went."""
    for topic in found.of_type(ODOMETRY):
        stamps = topic.log_times if stands_still(topic.stamps) else topic.stamps
        known = [k for k, place in enumerate(topic.places[: len(stamps)]) if not far_away(place)]
        places = np.array(topic.places).reshape(-1, 2)[known]
        yield topic.topic.name, np.array(stamps, dtype=np.int64)[known], places
    for (parent, child), moving in found.frames.moving.items():
        if "odom" in parent:
            times = np.array([transform.stamp_ns for transform in moving], dtype=np.int64)
            yield f"/tf: {parent} -> {child}", times, np.array([transform.xyz[:2] for transform in moving])
