"""A bag as input of mapping and localisation: scans, odometry, the laser's pose. Never ground truth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from turtlebag.datasets.bags.contents import Contents
from turtlebag.datasets.bags.decode import RawScan
from turtlebag.datasets.bags.frames import FrameTree
from turtlebag.datasets.bags.lidars import LidarTopic, in_one, lidars_among
from turtlebag.datasets.bags.odometry import OdometrySource, find_odometry, odometry_at, sensor_pose
from turtlebag.datasets.bags.plausibility import ARM_M, stands_still
from turtlebag.datasets.bags.scans import assemble
from turtlebag.datasets.bags.source import Bag
from turtlebag.datasets.bags.stamps import check_order, running
from turtlebag.datasets.bags.topics import CLOUD, SCAN, way_out
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.findings import Finding, Unusable, lines_of
from turtlebag.datasets.plurals import listed
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import LidarSpec, Recording, Stamps

_TILTED = "the laser is tilted"
_UNPLACED = ("no static transforms", "frames do not connect", "millimetres")
_LASER = "--laser X,Y,YAW[,upside-down] sets its pose"


class NoScans(InputError):
    """The bag has no planar scans to map with; `clouds` names point cloud topics that would do."""

    def __init__(self, message: str, clouds: list[str]) -> None:
        super().__init__(message)
        self.clouds = clouds


def read_for_mapping(
    bag: Bag, *, T_base_lidar: SE2 | None = None, topic: str | Sequence[str] = ()
) -> Recording:
    """Recording of a bag; InputError (NoScans) when it has no scan to map with.

    `topic` chooses among its LaserScan topics, one or several; without it those of all lidars that have a
    transform, or else /scan, or the only one. `T_base_lidar` is the pose of the only one.
    """
    contents = Contents(bag)
    wanted = (topic,) if isinstance(topic, str) else topic
    chosen = [_wanted_topic(contents, name) for name in dict.fromkeys(wanted)]
    if T_base_lidar is None and len(chosen) > 1:
        lidars = [_read_topic(contents, name, None, bag.findings) for name in chosen]
        return in_one(lidars, bag.findings)
    if T_base_lidar is None and not chosen:
        lidars = lidars_of(contents, bag.findings)
        if len(lidars) > 1:
            return in_one(lidars, bag.findings)
        chosen = [lidar.name for lidar in lidars]
    if len(chosen) > 1:
        raise InputError(f"--laser: is the pose of one lidar; choose it with one --topic of {listed(chosen)}")
    name = chosen[0] if chosen else _scan_topic(contents)
    return recording_of(contents, name, T_base_lidar, findings=bag.findings)


def lidars_of(contents: Contents, findings: list[Finding]) -> list[LidarTopic]:
    """The scan topics of several lidars that have transforms, or the one of them whose points all others
    are; none where that is not clear."""
    preferred, names = _preferred(contents), list(contents.scans)
    read: dict[str, tuple[LidarTopic, list[Finding]]] = {}
    left_out: list[Finding] = []
    for name in dict.fromkeys([*preferred, *names]) if len(names) > 1 else ():
        own: list[Finding] = []
        try:
            one = _read_topic(contents, name, None, own)
            unclear = next((f for f in own if f.kind in _UNPLACED or f.detail.startswith(_TILTED)), None)
        except Unusable as error:
            unclear = error.finding
        if unclear is None:
            read[name] = one, own
        elif [name] == preferred:
            return []
        else:
            left_out.append(replace(unclear, kind="scans left out", remedy="left out"))
    frames = [read[name][0].frame for name in preferred if name in read]
    kept = lidars_among([one for one, _ in read.values()], left_out)
    one_of_many = len(preferred) > 1 and len(kept) < 2 and len(kept) == len(read)
    if one_of_many or len(set(frames)) < len(frames):
        return []
    findings += left_out
    if len(kept) > 1:
        what = f"scans of {len(kept)} lidars: {listed([one.name for one in kept])}"
        findings.append(Finding("several lidars", "", what, len(kept), remedy="all are used"))
        findings += [finding for one in kept for finding in read[one.name][1]]
    return kept


def recording_of(
    contents: Contents, topic: str, T_base_lidar: SE2 | None = None, *, findings: list[Finding]
) -> Recording:
    """The recording of one of the scan topics; Unusable when it cannot be mapped.

    What is found is appended to `findings`, which are the recording's then.
    """
    return _read_topic(contents, topic, T_base_lidar, findings).scans


def _read_topic(
    contents: Contents, topic: str, T_base_lidar: SE2 | None, findings: list[Finding]
) -> LidarTopic:
    """As `recording_of`, with what tells one lidar's scans from another's."""
    path = contents.bag.path
    scans, log_times = _of_one_laser(topic, contents.scans[topic], findings)
    try:
        ranges, lidar = assemble(topic, scans, log_times, findings)
    except ValueError as error:
        remedy = "no scan has a usable geometry; there is nothing to map"
        finding = Finding("beam angles", topic, str(error), len(scans), int(log_times[0]), remedy)
        raise Unusable(path, finding) from None
    own = np.array([scan.stamp_ns for scan in scans], dtype=np.int64)
    stamps = running(topic, own, log_times, findings)
    if stands_still(stamps):
        what, remedy = "all scans have one stamp and one recording time", "without times no map can be made"
        raise Unusable(path, Finding("no time", topic, what, len(scans), int(log_times[0]), remedy))
    findings += check_order(topic, own, log_times, "file order kept")
    odometry = find_odometry(contents, scans[0].frame, findings)
    if T_base_lidar is None:
        T_base_lidar, lidar = _mounted(contents, topic, odometry, scans[0].frame, lidar, findings)
    T_odom_base = odometry_at(odometry, topic, stamps, log_times, findings)
    imu = contents.read_imu(findings)
    findings += contents.findings()
    recording = Recording(
        source=str(path),
        stamps_ns=stamps,
        ranges=ranges,
        lidar=lidar,
        T_base_lidar=T_base_lidar,
        T_odom_base=T_odom_base,
        odometry=odometry.poses,
        imu=imu,
        topic=topic,
        notes=lines_of(findings),
        findings=tuple(findings),
    )
    return LidarTopic(recording, log_times, scans[0].frame)


def _of_one_laser(
    topic: str, scans: list[tuple[int, RawScan]], findings: list[Finding]
) -> tuple[list[RawScan], Stamps]:
    """The scans of the most frequent frame and their log times: two lasers do not sit at one place."""
    frames = Counter(scan.frame for _, scan in scans)
    main, count = frames.most_common(1)[0]
    if len(frames) > 1:
        named = ", ".join(f"'{name}' ({number})" for name, number in frames.most_common(12))
        what, others = f"messages of {len(frames)} frames: {named}", len(scans) - count
        findings.append(Finding("mixed frames", topic, what, others, remedy="the most frequent is used"))
    ours = [(time, scan) for time, scan in scans if scan.frame == main]
    return [scan for _, scan in ours], np.array([time for time, _ in ours], dtype=np.int64)


def _mounted(
    contents: Contents,
    topic: str,
    odometry: OdometrySource,
    sensor: str,
    lidar: LidarSpec,
    findings: list[Finding],
) -> tuple[SE2, LidarSpec]:
    """Planar pose of a laser on the robot, and the lidar as seen from above."""
    T = sensor_pose(contents.frames, odometry.base, sensor)
    if T is None:
        findings.append(unplaced(contents.frames, topic, odometry.base, sensor))
        return SE2.identity(), lidar
    require_near(contents, topic, odometry.base, sensor, T)
    up = float(T[2, 2])
    if abs(up) < 0.98:
        degrees = np.degrees(np.arccos(np.clip(abs(up), 0, 1)))
        findings.append(Finding("mounting", topic, f"{_TILTED} by {degrees:.0f} degrees"))
    if up < 0.0:
        what = "the laser is mounted upside down"
        findings.append(Finding("mounting", topic, what, remedy="its scans were flipped"))
        lidar = lidar.turned_over()
    return SE2.from_xyt(T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])), lidar


def unplaced(frames: FrameTree, topic: str, base: str, sensor: str) -> Finding:
    """That no fixed transforms say where the sensor of a topic sits."""
    what = f"no fixed transform {base} -> {sensor} (frames in /tf and /tf_static: {listed(frames.frames())})"
    kind = "frames do not connect" if frames.fixed else "no static transforms"
    remedy = f"an upright laser at the robot's centre is assumed; {_LASER}"
    return Finding(kind, topic, what, remedy=remedy)


def require_near(contents: Contents, topic: str, base: str, sensor: str, T_base_sensor: Array) -> None:
    """Unusable when a sensor would sit further from the robot than any is large."""
    if (arm := float(np.linalg.norm(T_base_sensor[:3, 3]))) > ARM_M:
        what = f"the transforms put the laser '{sensor}' {arm:.4g} m from '{base}' (millimetres?)"
        finding = Finding("millimetres", topic, what, remedy="--laser X,Y,YAW sets its pose")
        raise Unusable(contents.bag.path, finding)


def _preferred(contents: Contents) -> list[str]:
    names = list(contents.scans)
    return [name for name in names if name == "/scan"] or [n for n in names if n.endswith("/scan")] or names


def _scan_topic(contents: Contents) -> str:
    path, names, preferred = contents.bag.path, list(contents.scans), _preferred(contents)
    if len(preferred) == 1:
        return preferred[0]
    if names:
        choice = ", ".join(names)
        raise InputError(f"{path}: no /scan, and several LaserScan topics; choose one with --topic: {choice}")
    raise NoScans(f"{path}: {no_scans(contents)}", clouds_in(contents))


def no_scans(contents: Contents) -> Finding:
    """Why there are no scans to map with, and the way out if there is one."""
    damaged = [*contents.findings(), *contents.bag.findings]
    for finding in damaged:
        of_scans = finding.kind == "damaged messages" and SCAN in contents.types[finding.topic]
        if of_scans or finding.kind == "damaged file":
            return Finding("no scans", "", f"no /scan could be read: {finding}")
    what = "no /scan (sensor_msgs/LaserScan) messages in this bag"
    return Finding("no scans", "", what, remedy=way_out(contents.types) or _topics(contents))


def _wanted_topic(contents: Contents, wanted: str) -> str:
    if wanted in contents.scans:
        return wanted
    types = contents.types.get(wanted, {})
    state = f"of type {' and '.join(types)}" if types else "not in this bag"
    if SCAN in types:
        state = "without a readable message"
    way = way_out({wanted: types}) or _topics(contents)
    message = f"{contents.bag.path}: --topic {wanted} is {state}; {way}"
    raise NoScans(message, [wanted] if CLOUD in types else [])


def clouds_in(contents: Contents) -> list[str]:
    """Topics of point clouds."""
    return [name for name, types in contents.types.items() if CLOUD in types]


def _topics(contents: Contents) -> str:
    return f"its topics: {listed(contents.types)}"
