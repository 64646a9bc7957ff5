"""`bag doctor`: defects of a bag, and what each would break in mapping, localisation or other tools.

What concerns mapping is found by mapping's own reader; the checks here are of what it does not read.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from turtlebag.datasets.bags.contents import Contents
from turtlebag.datasets.bags.frames import FrameTree
from turtlebag.datasets.bags.mapping_input import clouds_in, lidars_of, no_scans, recording_of
from turtlebag.datasets.bags.odometry import of_link, of_topic
from turtlebag.datasets.bags.plausibility import CLOCK_NS, stands_still
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.bags.stamps import check_order, running
from turtlebag.datasets.findings import Finding, Unusable
from turtlebag.datasets.types import Stamps

_LATCHED = ("/tf_static", "/map")
_GRAVITY = ("error", "warning", "note")
Times = dict[str, tuple[Stamps, Stamps]]
"""Stamps and log times [ns] by topic."""


def examine(path: Path) -> list[Finding]:
    """All findings on a bag, the gravest first; InputError when it cannot be opened."""
    contents = Contents(open_bag(path), everything=True)
    findings = [*contents.bag.findings, *_mapped(contents)]
    contents.follow_tf()
    times = _times(contents)
    for others in (
        _odometries(contents),
        _orders(contents, times),
        _clocks(times, findings),
        _connections(contents),
        _quality_of_service(contents),
        _truth(contents.frames),
        contents.findings(),
    ):
        known = {(finding.kind, finding.topic) for finding in findings if finding.topic}
        findings += [finding for finding in others if (finding.kind, finding.topic) not in known]
    return sorted(dict.fromkeys(findings), key=lambda finding: _GRAVITY.index(finding.severity))


def _mapped(contents: Contents) -> Iterator[Finding]:
    """What mapping finds with each of the scan topics."""
    if not contents.scans and not clouds_in(contents):
        yield no_scans(contents)
    for topic in contents.scans:
        findings: list[Finding] = []
        try:
            recording_of(contents, topic, findings=findings)
        except Unusable as error:
            findings.append(error.finding)
        yield from findings
    choice: list[Finding] = []
    lidars_of(contents, choice)
    yield from (one for one in choice if one.kind in ("several lidars", "scans left out"))


def _times(contents: Contents) -> Times:
    """The times of all topics but transforms, which are those of links."""
    times = {
        name: _columns((s.stamp_ns, time) for time, s in scans) for name, scans in contents.scans.items()
    }
    for name in contents.odometry:
        columns = contents.read_odometry(name)
        times[name] = columns.stamps_ns, columns.log_times_ns
    for name in contents.imu:
        times[name] = contents.imu_times(name)
    for name in contents.others:
        times[name] = contents.read_headers(name)
    return {name: columns for name, columns in times.items() if len(columns[0])}


def _columns(pairs: Iterable[tuple[int, int]]) -> tuple[Stamps, Stamps]:
    stamps, log_times = np.array(list(pairs), dtype=np.int64).reshape(-1, 2).T
    return stamps, log_times


def _orders(contents: Contents, times: Times) -> Iterator[Finding]:
    """Clocks that stand, go back or pause."""
    for name, (stamps, log_times) in times.items():
        for finding in check_order(name, stamps, log_times):
            if finding.kind != "gaps" or name not in contents.others:
                yield finding
        yield from _standing(name, stamps, log_times)
    for link, pairs in contents.frames.times.items():
        stamps, log_times = _columns(pairs)
        name = f"/tf: {link[0]} -> {link[1]}"
        moving = link in contents.frames.moving
        kinds = ("time goes backwards", *(["gaps"] if moving and link[0] != "map" else []))
        yield from (one for one in check_order(name, stamps, log_times) if one.kind in kinds)
        if moving:
            yield from _standing(name, stamps, log_times)


def _standing(name: str, stamps: Stamps, log_times: Stamps) -> list[Finding]:
    findings: list[Finding] = []
    running(name, stamps, log_times, findings)
    return findings


def _clocks(times: Times, findings: list[Finding]) -> Iterator[Finding]:
    """Topics of another clock than most, where mapping has not found that the scans are one."""
    lags = {
        name: float(np.median(log_times - stamps))
        for name, (stamps, log_times) in times.items()
        if not stands_still(stamps)
    }
    if len(lags) < 2 or any(finding.kind == "mixed clocks" for finding in findings):
        return
    middle = float(np.median(list(lags.values())))
    for name, lag in lags.items():
        if abs(lag - middle) > CLOCK_NS:
            what = f"its stamps are {abs(lag - middle) * 1e-9:.1f} s off those of the other topics"
            yield Finding("mixed clocks", name, what, len(times[name][0]), int(times[name][1][0]))


def _odometries(contents: Contents) -> Iterator[Finding]:
    """What is wrong with all odometry, also with that which mapping does not use."""
    findings: list[Finding] = []
    for name in contents.odometry:
        columns = contents.read_odometry(name)
        if len(columns.stamps_ns):
            of_topic(columns, name, "", findings)
    yield from findings
    for link in contents.frames.moving:
        if "odom" in link[0]:
            links: list[Finding] = []
            of_link(contents.frames, link, links)
            yield from (one for one in links if one.kind not in ("gaps", "repeated stamps"))


def _connections(contents: Contents) -> Iterator[Finding]:
    """Odometry that moves a frame of no tree."""
    frames = contents.frames.frames()
    for name in contents.odometry:
        child = contents.read_odometry(name).child
        if frames and child not in frames:
            what = f"its child frame '{child}' is not in /tf"
            yield Finding("frames do not connect", name, what, remedy="its poses are used all the same")


def _quality_of_service(contents: Contents) -> Iterator[Finding]:
    for name in _LATCHED:
        for topic in contents.types.get(name, {}).values():
            if "durability" in topic.qos and "transient_local" not in topic.qos:
                yield Finding("quality of service", name, "was recorded as volatile")


def _truth(frames: FrameTree) -> Iterator[Finding]:
    leaks = [child for child, parents in frames.parents().items() if "world" in parents]
    if leaks and frames.times:
        yield Finding("truth in /tf", "", f"/tf links 'world' to {', '.join(leaks)}", len(leaks))
