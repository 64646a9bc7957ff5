"""The track breaks where neither scans nor odometry say how the robot moved; places join its parts."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.slam_rooms import ROOM, SICK, around_the_room, dead_reckoning, drifted, recording
from turtlebag.datasets.durations import nanoseconds
from turtlebag.datasets.motion import gaps_between, without_gap
from turtlebag.datasets.se2 import SE2, between, compose
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind
from turtlebag.pipeline.slam.graph.pose_graph import optimise
from turtlebag.pipeline.slam.loops.by_appearance import joined_parts, relaxed
from turtlebag.pipeline.slam.odometry.breaks import TrackBreaks, breaks_of
from turtlebag.pipeline.slam.odometry.evidence import evidence_of
from turtlebag.pipeline.slam.odometry.line_icp import Lines
from turtlebag.pipeline.slam.odometry.track import OdometryNoise, Track, TrackingConfig
from turtlebag.pipeline.slam.odometry.tracker import track_log
from turtlebag.pipeline.slam.scans.scans import Scans


def breaks_at(n: int, broken: tuple[int, ...], against: tuple[int, ...]) -> TrackBreaks:
    steps = np.arange(n)
    gone = np.isin(steps, broken)
    return TrackBreaks(gone, np.isin(steps, against), gone & False, np.zeros((0, 2), int))


def test_breaks_part_the_log_until_a_place_joins_it():
    breaks = breaks_at(6, (1, 3, 4), (1, 4))
    part, released = joined_parts(breaks, [])
    # 0 1 | 2 3 : 4 | 5 6, the middle break being one that nothing contradicts
    assert [len(set(part[list(keys)])) for keys in ((0, 1), (2, 3, 4), (5, 6), (1, 2), (4, 5))] == [
        1,
        1,
        1,
        2,
        2,
    ]
    assert not released.any()
    part, released = joined_parts(breaks, [(6, 0)])
    assert part[6] == part[0] != part[2]
    assert released.tolist() == [False, False, False, False, False, False]
    part, released = joined_parts(breaks, [(6, 0), (3, 1)])
    assert len(set(part.tolist())) == 1
    assert released.tolist() == [False, True, False, False, True, False]


def ring_with_a_gap(wheels: float) -> float:
    """How far the last of six keys of a ring, one metre apart, lies off after its loop is closed: the third
    step is a gap, over which the scan says 4 m and the wheels so many."""
    said = np.array([1.0, 1.0, 4.0, 1.0, 1.0])
    steps = [
        Constraint(k, k + 1, np.array([x, 0.0, 0.0]), 1e4 * np.eye(3), Kind.STEP)
        for k, x in enumerate(said.tolist())
    ]
    over_gap = np.array([wheels, 0.0, 0.0])
    steps.append(Constraint(2, 3, over_gap, 1e3 * np.eye(3), Kind.WHEELS, Constraint.CAUCHY))
    loop = Constraint(0, 5, np.array([5.2, 0.0, 0.0]), 25.0 * np.eye(3), Kind.LOOP, Constraint.CAUCHY)
    start = SE2.from_xyt(np.append(0.0, np.cumsum([1.0, 1.0, 1.2, 1.0, 1.0])), 0.0, 0.0)
    bridged = relaxed(steps, np.arange(5) == 2)
    return float(optimise(start, [*bridged, loop]).x[5] - 5.0)


def test_wheels_bridge_a_gap_whose_ends_a_place_joins_and_give_way_to_loops():
    assert ring_with_a_gap(wheels=1.0) == pytest.approx(0.0, abs=0.03)
    # carried over the gap: the loop decides
    assert ring_with_a_gap(wheels=9.0) == pytest.approx(0.2, abs=0.03)


def judged(log: Recording, track: Track) -> TrackBreaks:
    return breaks_of(track, evidence_of(log, track, OdometryNoise()))


def scans_with_a_gap(odometry_agrees: bool, wait_s: int = 10) -> tuple[Recording, Track]:
    truth = around_the_room(60)
    odometry = SE2.from_array(truth)
    log = recording(ROOM, truth, odometry=truth)
    stamps = log.stamps_ns + np.where(np.arange(60) >= 30, wait_s * 10**9, 0)
    if not odometry_agrees:
        late = SE2.from_xyt(5.0, 2.0, 1.0) @ odometry[30:]
        odometry = SE2(np.concatenate([odometry.xyt[:30], late.xyt]))
    log = Recording("gap", stamps, log.ranges, log.lidar, log.T_base_lidar, odometry)
    return log, track_log(Scans.of(log, 30.0), TrackingConfig(), Lines)


@pytest.mark.parametrize("agrees", [True, False])
def test_gap_breaks_the_track_unless_scans_and_odometry_confirm_each_other(agrees):
    breaks = judged(*scans_with_a_gap(agrees))
    assert breaks.broken.sum() == (0 if agrees else 1)
    assert breaks.contradicted.sum() == (0 if agrees else 1)
    assert breaks.gaps.tolist() == ([] if agrees else [[29, 30]])


@pytest.mark.parametrize(("wait_s", "overlap", "broken"), [(3, 0.4, 0), (10, 0.4, 1), (10, 0.85, 0)])
def test_after_a_long_gap_a_scan_that_hardly_fits_confirms_nothing(wait_s, overlap, broken):
    """MIT CSAIL without 20 s of its scans: a match agreed with odometry that was 1.6 m off by then."""
    log, track = scans_with_a_gap(odometry_agrees=True, wait_s=wait_s)
    fits = track.overlap.copy()
    fits[30] = overlap
    breaks = judged(log, replace(track, overlap=fits))
    assert breaks.broken.sum() == broken
    assert not (breaks.alone | breaks.contradicted).any()


def test_after_a_gap_the_odometry_has_it_where_scans_fit_by_chance():
    """Seven of 26 drives with gaps of 20 s were 3 to 12 m off, their odometry right to centimetres."""
    poses = around_the_room(60)
    log, other = (recording(room, poses, odometry=poses) for room in (ROOM, 1.3 * ROOM))
    odometry = SE2.from_array(poses)
    driven = SE2.from_xyt(15.0, 2.0, 1.0) @ odometry[30:]
    log = replace(
        log,
        stamps_ns=log.stamps_ns + np.where(np.arange(60) >= 30, 10 * 10**9, 0),
        ranges=np.vstack([log.ranges[:30], other.ranges[30:]]),
        T_odom_base=SE2(np.concatenate([odometry.xyt[:30], driven.xyt])),
    )
    track = track_log(Scans.of(log, 30.0), TrackingConfig(), Lines)
    off = track.T_track_base[29].inverse() @ track.T_track_base[30]
    off = between((log.T_odom_base[29].inverse() @ log.T_odom_base[30]).xyt, off.xyt)
    assert np.hypot(*off[:2]) < 0.5


@pytest.mark.parametrize(("wheels", "from_scan"), [(0.0, 0), (-1.0, 0), (0.0, 29)])
def test_after_a_gap_wheels_that_were_wrong_before_and_scans_that_surely_fit_are_not_overruled(
    wheels, from_scan
):
    """Wheels that stand still or count backwards, all along or in the gap: up to 3 m off."""
    poses = np.delete(around_the_room(160)[:100], np.arange(30, 36), axis=0)
    steps = SE2.from_array(poses).steps()
    wrong = np.arange(len(steps)) == 29 if from_scan else np.ones(len(steps), dtype=bool)
    steps[wrong, :2] *= wheels
    odometry = [poses[0]]
    for step in steps:
        odometry.append(compose(odometry[-1], step))
    log = recording(ROOM, poses, SICK, odometry=np.array(odometry))
    log = replace(log, stamps_ns=log.stamps_ns + np.where(np.arange(len(poses)) >= 30, 3 * 10**9, 0))
    track = track_log(Scans.of(log, 30.0), TrackingConfig(), Lines)
    truth, found = (T[0].inverse() @ T for T in (SE2.from_array(poses), track.T_track_base))
    assert np.linalg.norm(truth.xy - found.xy, axis=1).max() < 0.1


def test_a_scan_that_fits_nothing_seen_before_breaks_the_track_though_none_is_missing():
    """Scans of another place for a tenth of a log: 13 m off, and called good."""
    log, track = scans_with_a_gap(odometry_agrees=True)
    log = replace(log, stamps_ns=np.arange(60, dtype=np.int64) * 200_000_000)
    assert not judged(log, track).broken.any()
    overlap = track.overlap.copy()
    overlap[[20, 21]] = 0.1
    breaks = judged(log, replace(track, overlap=overlap))
    step = int(np.searchsorted(track.keys, 20)) - 1
    assert np.flatnonzero(breaks.broken).tolist() == np.flatnonzero(breaks.alone).tolist() == [step]
    assert breaks.gaps.tolist() == [[19, 20]]
    # of a scan without surfaces nothing is asked
    usable = track.usable & ~np.isin(np.arange(60), [20, 21])
    assert not judged(log, replace(track, overlap=overlap, usable=usable)).broken.any()


@pytest.mark.parametrize(("wait_s", "moved_m", "broken"), [(3, 0.2, 0), (3, 0.8, 0), (9, 0.2, 1)])
def test_a_blind_direction_after_a_short_gap_is_left_to_the_odometry(wait_s, moved_m, broken):
    """Far from the map's origin, heading along its y, in a bare corridor."""
    poses = np.column_stack([np.full(20, 40.0), 0.4 * np.arange(20) - 60.0, np.full(20, math.pi / 2)])
    poses[10:, 1] += moved_m - 0.4
    log = recording(ROOM, poses, odometry=poses)
    stamps = log.stamps_ns + np.where(np.arange(20) >= 10, wait_s * 10**9, 0)
    log = replace(log, stamps_ns=stamps)
    along = np.tile(np.diag([0.0, 1e4, 1e4]), (20, 1, 1))
    track = dead_reckoning(log)
    keys = np.arange(20)
    blind = replace(track, keys=keys, information=along, overlap=np.ones(20), usable=np.ones(20, dtype=bool))
    assert judged(log, blind).broken.sum() == broken


@pytest.mark.parametrize("factor", [0.4, 2.5, 10.5])
def test_a_slower_clock_changes_neither_track_nor_breaks(factor):
    """A log of a scan each 2.1 s was all gaps."""
    truth = around_the_room(60)
    log = recording(ROOM, truth, odometry=drifted(truth))
    waits = np.full(59, 0.2)
    waits[30] = 3.0
    found = []
    for by in (1.0, factor):
        timed = replace(log, stamps_ns=nanoseconds(np.append(0.0, np.cumsum(by * waits))))
        track = track_log(Scans.of(timed, 30.0), TrackingConfig(), Lines)
        found.append((track.T_track_base.xyt, judged(timed, track).gaps))
        assert np.flatnonzero(~without_gap(by * waits)).tolist() == [30]
        assert gaps_between(timed.stamps_ns, np.ones(60, dtype=bool)).tolist() == [[30, 31]]
    assert all(np.array_equal(*both) for both in zip(*found, strict=True))


def test_scans_that_come_in_bursts_leave_no_gaps():
    waits = np.tile([0.1] * 9 + [1.1], 20)
    assert without_gap(waits).all()
    waits[77] = 3.0
    assert np.flatnonzero(~without_gap(waits)).tolist() == [77]
