"""Odometry of a bag at the stamps of its scans, and a sensor's pose on the robot."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from turtlebag.datasets.bags import decode
from turtlebag.datasets.bags.contents import Contents, OdometryColumns
from turtlebag.datasets.bags.frames import BASES, FrameTree
from turtlebag.datasets.bags.plausibility import CLOCK_NS, FAR_M, driven_in_millimetres
from turtlebag.datasets.bags.stamps import check_order, running
from turtlebag.datasets.findings import Finding
from turtlebag.datasets.plurals import counted, verb
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Stamps, Trajectory

_DRIVEN = (0.1, 0.1, 0.2)
"""Twists that lead farther than this [m, m, rad] are of a robot that drives, not of noise."""
_BEYOND_NS = 10**8
"""Scans so long before or after the odometry are worth a word."""


@dataclass(frozen=True, eq=False, slots=True)
class OdometrySource:
    """Where the odometry comes from: its poses by stamp, by log time, and the frame they move."""

    base: str
    name: str = ""
    poses: Trajectory | None = None
    by_log_time: Trajectory | None = None


def find_odometry(contents: Contents, scan_frame: str, findings: list[Finding]) -> OdometrySource:
    """Odometry from /odom, from the topic that carries the lidar, from the only one, or from /tf."""
    chosen = _chosen_topic(contents, scan_frame)
    if chosen is not None:
        columns = contents.read_odometry(chosen)
        if contents.frames.lookup(columns.child, scan_frame) is None:
            contents.follow_tf()
        return of_topic(columns, chosen, contents.frames.base(), findings)
    names = list(contents.odometry)
    if len(names) > 1:
        what = f"several odometry topics and no /odom: {', '.join(names)}"
        findings.append(Finding("odometry source", "", what, len(names), remedy="/tf is used"))
    contents.follow_tf()
    frames = contents.frames
    links = [link for link in frames.moving if "odom" in link[0]]
    # one that leads to the lidar, else whichever: where the lidar sits is another question
    links.sort(key=lambda link: frames.lookup(link[1], scan_frame) is None)
    if links:
        parent, child = links[0]
        findings.append(Finding("odometry source", "", f"odometry from /tf ({parent} -> {child})"))
        return of_link(frames, links[0], findings)
    what = "neither an Odometry topic nor odom -> base in /tf"
    findings.append(Finding("no odometry", "", what, remedy="the scans alone are used"))
    return OdometrySource(frames.base())


def _chosen_topic(contents: Contents, scan_frame: str) -> str | None:
    """The odometry topic to use: /odom, else the only one that carries the lidar, else the only one."""
    if "/odom" in contents.odometry and len(contents.read_odometry("/odom").stamps_ns):
        return "/odom"
    columns = {name: contents.read_odometry(name) for name in contents.odometry}
    names = [name for name, found in columns.items() if len(found.stamps_ns)]
    frames = contents.frames
    carrying = [name for name in names if frames.lookup(columns[name].child, scan_frame) is not None]
    return next((found[0] for found in (carrying, names) if len(found) == 1), None)


def of_topic(columns: OdometryColumns, name: str, otherwise: str, findings: list[Finding]) -> OdometrySource:
    """The odometry of a topic; its base is `otherwise` where it names none."""
    if len(columns.links) > 1:
        named = ", ".join(
            f"'{parent} -> {child}' ({n})" for (parent, child), n in columns.links.most_common(12)
        )
        what = f"messages of {len(columns.links)} frames: {named}"
        count = columns.links.total() - len(columns.stamps_ns)
        findings.append(Finding("mixed frames", name, what, count, remedy="the most frequent is used"))
    stamps = running(name, columns.stamps_ns, columns.log_times_ns, findings)
    findings += check_order(name, columns.stamps_ns, columns.log_times_ns, "sorted")
    xyt = _filled_in(columns, stamps, name, findings)
    return _source(columns.child or otherwise, name, stamps, columns.log_times_ns, xyt, findings)


def of_link(frames: FrameTree, link: tuple[str, str], findings: list[Finding]) -> OdometrySource:
    """The odometry of a moving link of /tf."""
    name = f"/tf: {link[0]} -> {link[1]}"
    moving = frames.moving[link]
    times = np.array([transform.log_time_ns for transform in moving], dtype=np.int64)
    own = np.array([transform.stamp_ns for transform in moving], dtype=np.int64)
    stamps = running(name, own, times, findings)
    findings += check_order(name, own, times, "sorted")
    rows = np.array([(t.xyz[0], t.xyz[1], decode.yaw_of(t.quaternion)) for t in moving])
    return _source(link[1], name, stamps, times, rows, findings)


def _filled_in(columns: OdometryColumns, stamps: Stamps, name: str, findings: list[Finding]) -> Array:
    """The poses (n, 3); where a driver fills in its twists alone, those that they lead to."""
    xyt = columns.xyt
    if not np.array_equal(xyt, np.broadcast_to(xyt[0], xyt.shape), equal_nan=True):
        return xyt
    start = SE2.from_array(np.nan_to_num(xyt[0]))
    path = integrated(stamps, columns.twists, start)
    if not (np.abs(path - start.xyt) > _DRIVEN).any():
        return xyt
    what = "the pose never changes but the twist does"
    remedy = "the path is integrated from the twist"
    findings.append(Finding("pose not filled in", name, what, len(xyt), int(columns.log_times_ns[0]), remedy))
    return path


def integrated(stamps: Stamps, twists: Array, start: SE2) -> Array:
    """Poses (n, 3) that twists (n, 3) [m/s, m/s, rad/s] lead to from `start` on, in the order of the input.

    Each step is taken with the mean of the twists at its ends, in the direction halfway; absurd ones
    and those that are no numbers count as 0.
    """
    order = np.argsort(stamps, kind="stable")
    speeds = np.where(np.abs(twists[order]) < FAR_M, twists[order], 0.0)
    steps = 0.5 * (speeds[1:] + speeds[:-1]) * (np.diff(stamps[order]) * 1e-9)[:, None]
    turned = np.cumsum(steps[:, 2])
    halfway = turned - 0.5 * steps[:, 2]
    dx = steps[:, 0] * np.cos(halfway) - steps[:, 1] * np.sin(halfway)
    dy = steps[:, 0] * np.sin(halfway) + steps[:, 1] * np.cos(halfway)
    path = np.zeros((len(stamps), 3))
    path[1:] = np.column_stack([np.cumsum(dx), np.cumsum(dy), turned])
    xyt = np.empty_like(path)
    xyt[order] = (start @ SE2.from_array(path)).xyt
    return xyt


def _source(
    base: str, name: str, stamps: Stamps, times: Stamps, xyt: Array, findings: list[Finding]
) -> OdometrySource:
    """The poses (n, 3) that are such, in metres, by stamp and by log time [ns]."""
    findings += _impossible(xyt, times, name)
    with np.errstate(invalid="ignore"):
        places = (np.abs(xyt) < FAR_M).all(axis=1)
    stamps, times, xyt = stamps[places], times[places], xyt[places]
    if not len(stamps):
        return OdometrySource(base, name)
    if driven_in_millimetres(stamps, xyt[:, :2]):
        what = "the robot would be implausibly fast"
        findings.append(Finding("millimetres", name, what, len(xyt), int(times[0]), "read as millimetres"))
        xyt = xyt * (1e-3, 1e-3, 1.0)
    by_stamp, usual = without_repeats(_increasing(stamps, xyt))
    if usual > 1:
        what = f"each pose is sent about {usual} times"
        findings.append(Finding("repeated poses", name, what, usual, remedy="used once"))
    return OdometrySource(base, name, by_stamp, without_repeats(_increasing(times, xyt))[0])


def _impossible(xyt: Array, times: Stamps, name: str) -> Iterator[Finding]:
    """Poses (n, 3) without a direction or a place."""
    turned = np.isfinite(xyt[:, 2])
    with np.errstate(invalid="ignore"):
        far = turned & ~(np.abs(xyt[:, :2]) < FAR_M).all(axis=1)
    for kind, noun, wrong, what in (
        ("bad quaternions", "quaternion", ~turned, "zero or not finite"),
        ("absurd places", "pose", far, "not finite or implausibly far away"),
    ):
        if count := int(np.count_nonzero(wrong)):
            detail = f"{counted(count, noun)} {verb(count, 'is', 'are')} {what}"
            yield Finding(kind, name, detail, count, int(times[np.argmax(wrong)]), "left out")


def _increasing(stamps: Stamps, xyt: Array) -> Trajectory:
    """Poses in order of their stamps, each stamp once."""
    stamps, first = np.unique(stamps, return_index=True)
    return Trajectory(stamps, SE2.from_array(xyt[first]))


def without_repeats(odometry: Trajectory) -> tuple[Trajectory, int]:
    """The poses without those that a driver repeats until it has a new one, and how often it sends each.

    The robot moved evenly between new poses, rather than standing still and jumping. During a longer
    standstill, repeated poses are kept.
    """
    new = np.append(True, (np.diff(odometry.poses.xyt, axis=0) != 0.0).any(axis=1))
    first = np.flatnonzero(new)
    # the last run has no end; a robot that hardly moves says nothing of how often a pose is sent
    runs = np.diff(first)
    usual = int(np.median(runs)) if len(runs) else 1
    if usual < 2:
        return odometry, 1
    following = np.append(first, len(new) + usual)[np.cumsum(new)]
    keep = new | (following - np.arange(len(new)) >= usual)
    return Trajectory(odometry.stamps_ns[keep], odometry.poses[keep]), usual


def sensor_pose(frames: FrameTree, base: str, sensor: str) -> Array | None:
    """`T_base_sensor` (4, 4), from another base of the robot where fixed links lead from that one only."""
    ways = (frames.lookup(start, sensor) for start in (base, *BASES))
    return np.eye(4) if sensor == base else next((T for T in ways if T is not None), None)


def odometry_at(
    odometry: OdometrySource, topic: str, stamps: Stamps, log_times: Stamps, findings: list[Finding]
) -> SE2 | None:
    """Odometry at the stamp of each scan of a topic."""
    poses = odometry.poses
    if poses is None:
        return None
    first, last = int(poses.stamps_ns[0]), int(poses.stamps_ns[-1])
    if max(first - int(stamps.max()), int(stamps.min()) - last) > CLOCK_NS:
        off = abs(int(stamps.min()) - first) * 1e-9
        what = f"its stamps are {off:.1f} s off those of the odometry (different clocks)"
        remedy = "odometry not used" if odometry.by_log_time is None else "matched by the recording times"
        findings.append(Finding("mixed clocks", topic, what, len(stamps), int(log_times[0]), remedy))
        return None if odometry.by_log_time is None else odometry.by_log_time.at(log_times)
    outside = (stamps < first - _BEYOND_NS) | (stamps > last + _BEYOND_NS)
    if outside.any():
        count, where = int(np.count_nonzero(outside)), int(log_times[np.argmax(outside)])
        what = f"{counted(count, 'scan')} {verb(count, 'lies', 'lie')} outside the odometry's time"
        findings.append(Finding("beyond odometry", topic, what, count, where, "its nearest pose is used"))
    return poses.at(stamps)
