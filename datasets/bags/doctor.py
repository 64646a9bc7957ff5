"""`bag doctor`: defects of a bag, and what each would break in mapping, localisation or other tools."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from turtlebag.datasets.bags.plausibility import (
    ARM_M,
    CLOCK_NS,
    directed,
    driven_in_millimetres,
    far_away,
    ranges_in_millimetres,
    stands_still,
)
from turtlebag.datasets.bags.survey import Finding, Survey, TopicSurvey, survey
from turtlebag.datasets.bags.topics import IMU, ODOMETRY, SCAN, TRANSFORMS, way_out
from turtlebag.datasets.plurals import counted
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Stamps

_LATCHED = ("/tf_static", "/map")


def examine(path: Path) -> list[Finding]:
    """All findings on a bag, the gravest first; InputError when it cannot be opened."""
    found = survey(path)
    findings = [finding for check in _CHECKS for finding in check(found)]
    return sorted(findings, key=lambda finding: finding.severity != "error")


def _file(found: Survey) -> Iterator[Finding]:
    for note in found.notes:
        if note.startswith("metadata.yaml"):
            breaks = "`ros2 bag` and most readers refuse the folder; `turtlebag bag recover` rewrites it"
            yield Finding("error", "missing metadata", note, breaks)
        elif "read up to there" not in note:
            breaks = "readers that need the index refuse the file, and data after this place is not read; "
            yield Finding("error", "damaged file", note, breaks + "use `turtlebag bag recover`")


def _missing_topics(found: Survey) -> Iterator[Finding]:
    if not found.of_type(SCAN):
        other = way_out({name: topic.topic.msgtype for name, topic in found.topics.items()})
        what = f"no LaserScan topic; {other}" if other else "no LaserScan topic"
        yield Finding("error", "no scans", what, "there is nothing to map or localise with")
    moving = any(parent == "odom" for parent, _ in found.link_stamps)
    if not found.of_type(ODOMETRY) and not moving:
        what = "neither an Odometry topic nor odom -> base in /tf"
        breaks = "mapping has only the scans; AMCL cannot run"
        yield Finding("warning", "no odometry", what, breaks)
    empty = [name for name, topic in found.topics.items() if topic.undecodable]
    for name in empty:
        what = f"{name}: {found.topics[name].undecodable} messages cannot be decoded"
        yield Finding("error", "damaged messages", what, "they are skipped")


def _backwards(found: Survey) -> Iterator[Finding]:
    for name, topic in found.topics.items():
        stamps = np.array(topic.stamps, dtype=np.int64)
        if topic.topic.msgtype in TRANSFORMS or stands_still(stamps):
            continue
        steps = np.diff(stamps)
        if (steps < 0).any():
            count, worst = int((steps < 0).sum()), float(steps.min()) * -1e-9
            what = f"{name}: stamps go back {counted(count, 'time')}, by up to {worst:.3f} s"
            breaks = (
                "TF buffers are cleared, and message filters drop everything older than what they have seen"
            )
            yield Finding("error", "time goes backwards", what, breaks)
        elif (steps == 0).any():
            what = f"{name}: {counted(int((steps == 0).sum()), 'message')} with the stamp of the one before"
            yield Finding("warning", "repeated stamps", what, "interpolation between them is undefined")
    for link, times in found.link_stamps.items():
        count = int((np.diff(np.array(times, dtype=np.int64)) < 0).sum())
        if count:
            what = f"/tf: {link[0]} -> {link[1]} goes back in time {counted(count, 'time')}"
            yield Finding("error", "time goes backwards", what, "tf2 clears its buffer and lookups fail")


def _clocks(found: Survey) -> Iterator[Finding]:
    lags = {}
    for name, topic in found.topics.items():
        if topic.stamps and len(topic.stamps) == len(topic.log_times) and not stands_still(topic.stamps):
            lags[name] = float(np.median(np.array(topic.log_times) - np.array(topic.stamps)))
    if len(lags) < 2:
        return
    middle = float(np.median(list(lags.values())))
    odd = {name: lag for name, lag in lags.items() if abs(lag - middle) > CLOCK_NS}
    breaks = "no odometry or transform matches the scans in time (use_sim_time set on some nodes only?)"
    for name, lag in odd.items():
        what = f"{name}: its stamps are {abs(lag - middle) * 1e-9:.1f} s off those of the other topics"
        yield Finding("error", "mixed clocks", what, breaks)


def _gaps(found: Survey) -> Iterator[Finding]:
    for name, topic in found.topics.items():
        if topic.topic.msgtype in (SCAN, ODOMETRY, IMU):
            yield from _gap(name, topic.stamps, "the motion across the gap is a guess")
    for link, times in found.link_stamps.items():
        if link in found.frames.moving and link[0] != "map":
            name = f"/tf: {link[0]} -> {link[1]}"
            yield from _gap(name, times, "lookups in the gap are refused as extrapolation, scans are dropped")


def _gap(name: str, times: list[int], breaks: str) -> Iterator[Finding]:
    steps = np.diff(np.unique(np.array(times, dtype=np.int64)))
    if len(steps) < 3:
        return
    usual, longest = float(np.median(steps)), float(steps.max())
    limit = round(max(5.0 * usual, 3e8))
    if longest < limit:
        return
    count = int((steps >= limit).sum())
    what = (
        f"{name}: {counted(count, 'gap')}, the longest {longest * 1e-9:.2f} s (usually {usual * 1e-9:.3f} s)"
    )
    yield Finding("warning", "gaps", what, breaks)


def _connections(found: Survey) -> Iterator[Finding]:
    frames = found.frames
    scans = found.of_type(SCAN)
    if scans and "/tf_static" not in found.topics and not frames.fixed:
        what = "no /tf_static and no fixed link in /tf"
        breaks = "the laser is assumed at the robot's centre; --laser X,Y,YAW sets its pose"
        yield Finding("error", "no static transforms", what, breaks)
    base = found.base()
    for topic in scans:
        for frame in topic.frames:
            if frame != base and frames.fixed and frames.lookup(base, frame) is None:
                what = f"{topic.topic.name}: its frame '{frame}' is not connected to '{base}'"
                breaks = (
                    "the laser's position on the robot is unknown: every scan is dropped by tf2 message "
                    "filters, viewers stay blank; --laser X,Y,YAW sets it here"
                )
                yield Finding("error", "frames do not connect", what, breaks)
    for topic in found.of_type(ODOMETRY):
        for child in topic.children:
            ours = topic.topic.name.startswith("/ground_truth")
            if not ours and frames.frames() and child not in frames.frames():
                what = f"{topic.topic.name}: its child frame '{child}' is not in /tf"
                breaks = "odometry and sensors are not connected"
                yield Finding("error", "frames do not connect", what, breaks)
    for child, parents in found.parents.items():
        if len(parents) > 1:
            what = f"frame '{child}' has several parents: {', '.join(sorted(parents))}"
            breaks = "the tree flickers between them (two nodes publish the same transform?)"
            yield Finding("error", "two parents", what, breaks)


def _scans(found: Survey) -> Iterator[Finding]:
    for name, scans in found.scans.items():
        total = sum(scans.geometries.values())
        (geometry, n), _ = scans.geometries.most_common(1)[0]
        angle_min, angle_max, increment, time_increment, _, range_min, range_max = geometry
        step = increment or (angle_max - angle_min) / max(n - 1, 1)
        if not directed(angle_min, step, n):
            what = f"{name}: {n} readings from {angle_min:g} rad on, {step:g} rad apart"
            yield Finding("error", "beam angles", what, "the directions of the readings are unknown")
        elif increment and abs((angle_max - angle_min) / increment - (n - 1)) > 0.5:
            steps = round((angle_max - angle_min) / increment) + 1
            what = f"{name}: {n} readings, but angle_min, angle_max and the increment imply {steps}"
            breaks = "slam_toolbox and Karto refuse such scans, others shift each beam a little"
            yield Finding("warning", "fence-post", what, breaks)
        sizes = sorted({size for _, size in scans.geometries})
        if len(sizes) > 1:
            what = f"{name}: the number of readings varies ({sizes[0]}..{sizes[-1]})"
            breaks = "slam_toolbox and Karto drop the scans that differ; here they are resampled"
            yield Finding("warning", "fence-post", what, breaks)
        if not (range_max > range_min >= 0.0 and math.isfinite(range_max)):
            what = f"{name}: valid ranges {range_min:g}..{range_max:g} m"
            yield Finding("error", "range limits", what, "no reading is valid")
        if scans.all_nan:
            what = f"{name}: {scans.all_nan} of {total} scans are NaN only"
            yield Finding("warning", "empty scans", what, "they are empty; the motion is a guess")
        if scans.no_return:
            what = f"{name}: {scans.no_return} of {total} scans have no return at all"
            yield Finding("warning", "empty scans", what, "they cannot be matched")
        if scans.zeros > 0.01 * scans.readings:
            what = f"{name}: {100.0 * scans.zeros / scans.readings:.1f} % of the readings are 0"
            breaks = "old drivers mean 'no return' by it; it is read as invalid, so free space stays unknown"
            yield Finding("warning", "zero readings", what, breaks)
        yield from _sweep_time(name, found.topics[name], time_increment * (n - 1))


def _sweep_time(name: str, topic: TopicSurvey, sweep_s: float) -> Iterator[Finding]:
    steps = np.diff(np.array(topic.stamps, dtype=np.int64))
    period = float(np.median(steps)) * 1e-9 if len(steps) else 0.0
    if period > 0.0 and sweep_s > 1.2 * period:
        what = f"{name}: time_increment implies a sweep of {sweep_s:.3f} s, a scan comes every {period:.3f} s"
        yield Finding("warning", "sweep time", what, "deskewing distorts the scans")


def _rotations(found: Survey) -> Iterator[Finding]:
    for name, count in found.bad_rotations.items():
        what = f"{name}: {count} quaternions are zero, not normalised or not finite"
        yield Finding("error", "bad quaternions", what, "tf2 refuses them; here the poses are left out")


def _quality_of_service(found: Survey) -> Iterator[Finding]:
    for name in _LATCHED:
        topic = found.topics.get(name)
        if topic and "durability" in topic.topic.qos and "transient_local" not in topic.topic.qos:
            what = f"{name} was recorded as volatile"
            breaks = "with `ros2 bag play`, nodes that start later never receive it"
            yield Finding("warning", "quality of service", what, breaks)


def _truth(found: Survey) -> Iterator[Finding]:
    leaks = [link for link in found.parents.items() if "world" in link[1]]
    if leaks and found.link_stamps:
        what = f"/tf links 'world' to {', '.join(child for child, _ in leaks)}"
        yield Finding("warning", "truth in /tf", what, "a mapper that uses /tf may read the ground truth")


def _still_clocks(found: Survey) -> Iterator[Finding]:
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


def _mixed_frames(found: Survey) -> Iterator[Finding]:
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


def _places(found: Survey) -> Iterator[Finding]:
    """Transforms and poses beyond the Earth."""
    for parent, child in sorted(found.frames.far):
        what = f"/tf or /tf_static: {parent} -> {child} is implausibly far away"
        yield Finding("error", "absurd places", what, "viewers break; here it is left out")
    for topic in found.of_type(ODOMETRY):
        if count := sum(map(far_away, topic.places)):
            what = f"{topic.topic.name}: {count} poses are implausibly far away"
            yield Finding("error", "absurd places", what, "here they are left out")


def _units(found: Survey) -> Iterator[Finding]:
    """Readings, poses and places in millimetres."""
    for name, scans in found.scans.items():
        (_, _, _, _, _, _, range_max), _ = scans.geometries.most_common(1)[0][0]
        if ranges_in_millimetres(np.concatenate(scans.some), range_max):
            what = f"{name}: the readings exceed any lidar's range"
            breaks = "other readers take them for metres; here they are read as millimetres"
            yield Finding("error", "millimetres", what, breaks)
    for name, stamps, places in _driven(found):
        if driven_in_millimetres(stamps, places):
            what = f"{name}: the robot would be implausibly fast"
            breaks = "other readers take the poses for metres; here they are read as millimetres"
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


_CHECKS: tuple[Callable[[Survey], Iterator[Finding]], ...] = (
    _file,
    _missing_topics,
    _backwards,
    _still_clocks,
    _clocks,
    _gaps,
    _connections,
    _mixed_frames,
    _places,
    _units,
    _scans,
    _rotations,
    _quality_of_service,
    _truth,
)
