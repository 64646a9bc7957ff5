"""Places are recognised where drift exceeds every gate, but never in buildings that repeat themselves."""

import math
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.known import Known
from benchmarks.slam_scores import errors
from tests.helpers.made_drives import Drive, FloorPlan, Sensor, Wheels, make_log, sick
from tests.helpers.made_logs import WHEELS, interval, office_plan, without
from tests.helpers.slam_rooms import ROOM, SICK, around_the_room, dead_reckoning, recording
from turtlebag.datasets.se2 import SE2, between, compose
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam import icp_odometry, place_recognition
from turtlebag.pipeline.slam.align import Alignment
from turtlebag.pipeline.slam.clouds import KeyScans, make_clouds
from turtlebag.pipeline.slam.consistency import Recognised, agreeing_sets, competing, consistency
from turtlebag.pipeline.slam.drift import drift_of
from turtlebag.pipeline.slam.factors import Constraint
from turtlebag.pipeline.slam.icp_odometry import Lines
from turtlebag.pipeline.slam.line_match import LineMatch
from turtlebag.pipeline.slam.loop_search import LoopConfig
from turtlebag.pipeline.slam.place_recognition import PlaceRecognitionConfig
from turtlebag.pipeline.slam.slam import SlamConfig, run_slam
from turtlebag.pipeline.slam.submaps import HEADINGS, _headings, laid_on, make_submap, similarity, windows
from turtlebag.pipeline.slam.track import Track, TrackingConfig
from turtlebag.pipeline.slam.track_breaks import TrackBreaks, joined_parts, track_breaks_of
from turtlebag.pipeline.slam.tracker import track_log


@cache
def office() -> Known:
    """Round the office nearly twice, once into two rooms: 125 m; made once."""
    first = [(9.0, 7.0), (10.1, 7.0), (10.1, 4.0), (10.4, 4.0), (10.1, 7.0), (14.7, 7.0), (14.7, 10.5)]
    again = [(15.0, 10.5), (14.7, 7.0), *[(27.0, 7.0), (27.0, 15.0), (7.0, 15.0), (7.0, 7.0)] * 2]
    return make_log(
        "places", office_plan(1), np.array(first + again), Sensor(sick(180, 30.0), 0.4), drive=Drive(v=0.7),
        wheels=Wheels(0.02, -0.03, 0.003),
    )  # fmt: skip


def identical_rooms(seed: int, rooms: int = 8, there_and_back: bool = False) -> Known:
    """A corridor whose rooms are identical to the centimetre, furniture included; each is visited once."""
    plan = FloorPlan(10.0 + 4.0 * rooms, 14.0)
    plan.carve(1.0, 6.0, 5.0 + 4.0 * rooms, 8.0)
    route = [(2.0, 7.0)]
    for x in 3.0 + 4.0 * np.arange(rooms):
        for y, door in ((1.0, 5.8), (8.2, 8.0)):
            plan.carve(x, y, x + 3.6, y + 4.8)
            plan.carve(x + 1.3, door, x + 2.3, door + 0.2)
        plan.turned_box(x + 0.6, 2.0, 0.8, 0.4, 0.4)
        plan.turned_box(x + 2.8, 11.6, 0.8, 0.4, 0.4)
        route += [(x + 1.8, 7.0), (x + 1.8, 4.0), (x + 2.2, 4.0), (x + 1.8, 7.0)]
    if there_and_back:
        route.append((2.0, 7.0))
    return make_log(
        f"twins-{seed}", plan, np.array(route), Sensor(sick(180, 8.0), 0.4), drive=Drive(v=0.7),
        wheels=WHEELS[seed], seed=seed,
    )  # fmt: skip


def displaced(log: Known, start: float, offset: tuple[float, float, float]) -> Known:
    """The log whose odometry jumps by an offset (in the base frame) once, and is right again from there."""
    T = log.odometry
    first = int(np.argmax(interval(log, start, np.inf)))
    moved = (T[first] @ SE2(np.array(offset)) @ T[first].inverse()) @ T[first:]
    xyt = np.concatenate([T.xyt[:first], moved.xyt])
    return log.recorded(T_odom_base=SE2(xyt))


def carried(log: Known, start: float, length: float) -> Known:
    """The log of a robot that was carried: for an interval no scans, and wheels that stood still."""
    away, T = np.flatnonzero(interval(log, start, length)), log.odometry
    late = (T[away[0]] @ T[away[-1] + 1].inverse() @ T[away[-1] + 1 :]).xyt
    xyt = np.concatenate([T.xyt[: away[-1] + 1], late])
    return without(log.recorded(T_odom_base=SE2(xyt)), start, length)


BREAKS = {
    "gap in which odometry jumps": lambda log: displaced(without(log, 40.0, 12.0), 40.0, (14.0, -6.0, 1.4)),
    "robot carried away": lambda log: carried(log, 55.0, 14.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("broken", BREAKS.values(), ids=BREAKS.keys())
def test_log_broken_in_two_is_put_together_again(broken):
    log = broken(office())
    result = run_slam(log.recording, SlamConfig())
    found = errors(result.trajectory.poses, log.reference)
    assert found["folded"] == 0.0
    assert found["m"] < 0.02
    assert result.check.verdict == "good", result.check.reasons
    true = log.truth.poses[result.keys]
    accepted = [place for place in result.recognised if place.verdict == "accepted"]
    assert len(accepted) >= 3
    for place in accepted:
        apart = between((true[place.j].inverse() @ true[place.i]).xyt, place.T_j_i)
        assert np.hypot(*apart[:2]) < 0.2


@pytest.mark.slow
def test_broken_log_without_place_recognition_is_called_doubtful():
    log = BREAKS["gap in which odometry jumps"](office())
    off = SlamConfig.model_validate({"place_recognition": {"enabled": False}})
    result = run_slam(log.recording, off)
    assert result.check.verdict == "doubtful"
    assert any("breaks" in reason for reason in result.check.reasons)


@pytest.mark.slow
def test_rooms_like_one_another_are_not_taken_for_one():
    log = identical_rooms(1, rooms=6)
    result = run_slam(log.recording, SlamConfig())
    assert not any(place.verdict == "accepted" for place in result.recognised)
    assert errors(result.trajectory.poses, log.reference)["m"] < 0.03
    assert result.check.verdict == "good", result.check.reasons


@pytest.mark.slow
@pytest.mark.parametrize("there_and_back", [False, True])
def test_robot_lost_among_rooms_like_one_another_is_called_doubtful(there_and_back):
    log = identical_rooms(2, rooms=6, there_and_back=there_and_back)
    log = displaced(without(log, 45.0, 8.0), 45.0, (6.0, 3.0, 1.0))
    result = run_slam(log.recording, SlamConfig())
    assert not any(place.verdict == "accepted" for place in result.recognised)
    assert any("breaks" in reason for reason in result.check.reasons)


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


def scans_with_a_gap(odometry_agrees: bool, wait_s: int = 10) -> tuple[Recording, Track]:
    truth = around_the_room(60)
    odometry = SE2.from_array(truth)
    log = recording(ROOM, truth, odometry=truth)
    stamps = log.stamps_ns + np.where(np.arange(60) >= 30, wait_s * 10**9, 0)
    if not odometry_agrees:
        late = SE2.from_xyt(5.0, 2.0, 1.0) @ odometry[30:]
        odometry = SE2(np.concatenate([odometry.xyt[:30], late.xyt]))
    log = Recording("gap", stamps, log.ranges, log.lidar, log.T_base_lidar, odometry)
    scans = range(1, 60)
    return log, track_log(log, make_clouds(log, 30.0), TrackingConfig(), 30.0, scans, Lines)


@pytest.mark.parametrize("agrees", [True, False])
def test_gap_breaks_the_chain_unless_scans_and_odometry_confirm_each_other(agrees):
    breaks = track_breaks_of(*scans_with_a_gap(agrees))
    assert breaks.broken.sum() == (0 if agrees else 1)
    assert breaks.contradicted.sum() == (0 if agrees else 1)
    assert breaks.gaps.tolist() == ([] if agrees else [[29, 30]])


@pytest.mark.parametrize(("wait_s", "overlap", "broken"), [(3, 0.4, 0), (10, 0.4, 1), (10, 0.85, 0)])
def test_after_a_long_gap_a_scan_that_hardly_fits_confirms_nothing(wait_s, overlap, broken):
    """MIT CSAIL without 20 s of its scans: a match agreed with odometry that was 1.6 m off by then."""
    log, track = scans_with_a_gap(odometry_agrees=True, wait_s=wait_s)
    fits = track.overlap.copy()
    fits[30] = overlap
    breaks = track_breaks_of(log, replace(track, overlap=fits))
    assert breaks.broken.sum() == broken
    assert not (breaks.alone | breaks.contradicted).any()


@pytest.mark.parametrize("sure", [0.92, 0.0])
def test_after_a_gap_the_odometry_has_it_where_scans_fit_by_chance(sure, monkeypatch):
    """Seven of 26 drives with gaps of 20 s were 3 to 12 m off, their odometry right to centimetres."""
    monkeypatch.setattr(icp_odometry, "SURELY_THERE", sure)
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
    track = track_log(log, make_clouds(log, 30.0), TrackingConfig(), 30.0, range(1, 60), Lines)
    off = track.T_track_base[29].inverse() @ track.T_track_base[30]
    off = between((log.T_odom_base[29].inverse() @ log.T_odom_base[30]).xyt, off.xyt)
    assert (np.hypot(*off[:2]) < 0.5) == (sure > 0.0)


@pytest.mark.parametrize(("wheels", "from_scan"), [(0.0, 0), (-1.0, 0), (0.0, 29)])
def test_after_a_gap_wheels_that_lied_before_and_scans_that_surely_fit_are_not_overruled(wheels, from_scan):
    """Wheels that stand still or count backwards, all along or in the gap: up to 3 m off."""
    poses = np.delete(around_the_room(160)[:100], np.arange(30, 36), axis=0)
    steps = SE2.from_array(poses).steps()
    lying = np.arange(len(steps)) == 29 if from_scan else np.ones(len(steps), dtype=bool)
    steps[lying, :2] *= wheels
    odometry = [poses[0]]
    for step in steps:
        odometry.append(compose(odometry[-1], step))
    log = recording(ROOM, poses, SICK, odometry=np.array(odometry))
    log = replace(log, stamps_ns=log.stamps_ns + np.where(np.arange(len(poses)) >= 30, 3 * 10**9, 0))
    track = track_log(log, make_clouds(log, 30.0), TrackingConfig(), 30.0, range(1, len(poses)), Lines)
    truth, found = (T[0].inverse() @ T for T in (SE2.from_array(poses), track.T_track_base))
    assert np.linalg.norm(truth.xy - found.xy, axis=1).max() < 0.1


def test_a_scan_that_fits_nothing_seen_before_breaks_the_chain_though_none_is_missing():
    """Scans of another place for a tenth of a log: 13 m off, and called good."""
    log, track = scans_with_a_gap(odometry_agrees=True)
    log = replace(log, stamps_ns=np.arange(60, dtype=np.int64) * 200_000_000)
    assert not track_breaks_of(log, track).broken.any()
    overlap = track.overlap.copy()
    overlap[[20, 21]] = 0.1
    breaks = track_breaks_of(log, replace(track, overlap=overlap))
    step = int(np.searchsorted(track.keys, 20)) - 1
    assert np.flatnonzero(breaks.broken).tolist() == np.flatnonzero(breaks.alone).tolist() == [step]
    assert breaks.gaps.tolist() == [[19, 20]]
    # of a scan without surfaces nothing is asked
    usable = track.usable & ~np.isin(np.arange(60), [20, 21])
    assert not track_breaks_of(log, replace(track, overlap=overlap, usable=usable)).broken.any()


@pytest.mark.parametrize(("wait_s", "moved_m", "broken"), [(3, 0.2, 0), (3, 0.8, 0), (9, 0.2, 1)])
def test_a_blind_direction_after_a_short_gap_is_left_to_the_odometry(wait_s, moved_m, broken):
    """Far from the map's origin, heading along its y, in a bare corridor."""
    poses = np.column_stack([np.full(20, 40.0), 0.4 * np.arange(20) - 60.0, np.full(20, math.pi / 2)])
    poses[10:, 1] += moved_m - 0.4
    log = recording(ROOM, poses, odometry=poses)
    stamps = log.stamps_ns + np.where(np.arange(20) >= 10, wait_s * 10**9, 0)
    log = replace(log, stamps_ns=stamps)
    along = np.tile(np.diag([0.0, 1e4, 1e4]), (20, 1, 1))
    track = dead_reckoning(log, make_clouds(log, 30.0))
    keys = np.arange(20)
    blind = replace(track, keys=keys, information=along, overlap=np.ones(20), usable=np.ones(20, dtype=bool))
    assert track_breaks_of(log, blind).broken.sum() == broken


def test_submaps_lie_on_each_other_where_they_belong():
    truth = around_the_room(120, laps=2)
    clouds = make_clouds(recording(ROOM, truth), 30.0)
    keys = np.arange(0, 120, 2)
    turned = (SE2.from_xyt(40.0, -7.0, 2.5) @ SE2.from_array(truth[keys])).xyt
    broken = np.zeros(59, dtype=bool)
    broken[29] = True
    chosen = windows(len(keys), broken)
    assert all(len(set(window >= 30)) == 1 for window in chosen.values())
    submaps = [make_submap(clouds, keys, turned, *item) for item in chosen.items()]
    query, other = submaps[-1], submaps[0]
    true = between(truth[keys[other.middle]], truth[keys[query.middle]])
    score_, pose = laid_on(query, other)[0]
    assert score_ > 0.6
    assert np.hypot(*(pose[:2] - true[:2])) < 0.3
    assert similarity(query, [query])[0] == pytest.approx(1.0)


def place(i: int, j: int, T_j_i: tuple[float, float, float], overlap: float = 0.9) -> Recognised:
    return Recognised(i, j, np.array(T_j_i), 0.8, overlap, 0.0, 0.01, STEP)


STEP = np.diag([0.02**-2, 0.02**-2, 0.005**-2])


def test_places_that_agree_outvote_the_aliases():
    n = 40
    poses = np.column_stack([np.arange(n) * 1.0, np.zeros(n), np.zeros(n)])
    broken = np.arange(n - 1) == 19
    steps = [Constraint(k, k + 1, np.array([1.0, 0.0, 0.0]), STEP, "step") for k in range(n - 1)]
    # the second half truly runs beside the first, 3 m shifted; aliases say 7 m, and one says a turn
    true = [place(i, i - 20, (3.0, 0.0, 0.0)) for i in (22, 26, 30)]
    alias = [place(i, i - 20, (7.0, 0.0, 0.0)) for i in (24, 28)]
    turned = [place(34, 14, (3.0, 0.0, 3.0))]
    found = [*alias, *true, *turned]
    comparable, agree = consistency(found, drift_of(poses, steps, broken), 4.0, 50.0)
    assert comparable.sum() == 30
    sets = agreeing_sets(found, agree & comparable)
    assert [len(members) for members in sets] == [3, 2, 1]
    assert {found[k].i for k in sets[0]} == {22, 26, 30}
    assert competing(sets[0], sets[1], comparable, agree)
    assert PlaceRecognitionConfig().min_support == 3


def test_the_newer_part_is_moved_to_where_its_best_place_says_and_the_others_stay():
    poses, part = np.random.default_rng(1).normal(0.0, 1.0, (9, 3)), np.repeat([0, 1, 2], 3)
    members = [place(7, 1, (0.2, 0.1, 0.3), 0.7), place(8, 0, (0.5, -0.4, 1.0), 0.9)]
    moved, joined = place_recognition._laid_together(poses, part, members)
    np.testing.assert_allclose(between(moved[0], moved[8]), (0.5, -0.4, 1.0), atol=1e-12)
    np.testing.assert_allclose(SE2(moved[6:]).steps(), SE2(poses[6:]).steps(), atol=1e-12)
    np.testing.assert_array_equal(moved[:6], poses[:6])
    assert joined.tolist() == [0, 0, 0, 1, 1, 1, 0, 0, 0]
    again, _ = place_recognition._laid_together(moved, joined, [place(7, 1, (0.2, 0.1, 0.3))])
    np.testing.assert_array_equal(again, moved)


def test_a_place_is_looked_for_about_where_the_chain_has_it(monkeypatch):
    """Along a line, each metre known to two: on older places as the poses say, and not a kilometre away."""
    poses = np.column_stack([np.arange(60.0), np.zeros(60), np.zeros(60)])
    vague = np.diag([0.25, 0.25, 1e8])
    steps = [Constraint(k, k + 1, np.array([1.0, 0.0, 0.0]), vague, "step") for k in range(59)]
    begun = []

    def seen_from(query, other):
        return between(poses[other.middle], poses[query.middle])

    def laid(query, other):
        return [(1.0, seen_from(query, other) + np.array([away, 0.0, 0.0])) for away in (0.0, 1e3)]

    def settled(scans, query, other, start, *_):
        begun.append((start - seen_from(query, other)).tolist())

    monkeypatch.setattr(place_recognition, "make_submap", lambda *of: SimpleNamespace(middle=of[3]))
    monkeypatch.setattr(place_recognition, "similarity", lambda query, others: np.ones(len(others)))
    monkeypatch.setattr(place_recognition, "laid_on", laid)
    monkeypatch.setattr(place_recognition, "_settled", settled)
    drift = drift_of(poses, steps, np.zeros(59, dtype=bool))
    scans = KeyScans(make_clouds(recording(ROOM, poses[:2]), 30.0), np.arange(60))
    place_recognition._candidates(scans, drift, [], PlaceRecognitionConfig(candidates=2), LoopConfig())
    assert len(begun) > 4
    assert not np.any(begun)


@pytest.mark.parametrize(
    ("few", "verdict"), [((0.6, 0.9, 0.6), "candidate"), ((0.2, 0.9, 0.6), "low overlap")]
)
def test_a_place_fits_as_well_as_one_in_four_scans_do_and_violates_as_little_free_space(few, verdict):
    truth = around_the_room(40)
    scans = KeyScans(make_clouds(recording(ROOM, truth), 30.0), np.arange(40))
    told = iter([0.9, 0.9, *few])

    class Told(LineMatch):
        def match(self, clouds, query, place, start, limits):
            return Alignment(SE2(start), 1e4 * np.eye(3), next(told), 0.01, 0.0)

    def about(middle):
        keys = np.arange(middle - 4, middle + 5)
        T_middle_keys = (SE2(truth[middle]).inverse() @ SE2(truth[keys])).xyt
        return SimpleNamespace(middle=middle, keys=keys, T_middle_keys=T_middle_keys)

    start = between(truth[4], truth[12])
    config = PlaceRecognitionConfig(min_overlap=0.6)
    found = place_recognition._settled(scans, about(12), about(4), start, 0.8, config, Told())
    assert (found.i, found.j, found.verdict) == (12, 4, verdict)
    if verdict == "candidate":
        assert found.overlap == pytest.approx(0.7)
        assert found.violation < 0.01


def test_a_place_passed_again_and_again_is_looked_for_once(monkeypatch):
    """After a break nothing is known of, five rounds of a room cost what one does."""
    looked_at: list[int] = []
    monkeypatch.setattr(place_recognition, "make_submap", lambda *of: looked_at.append(of[3]))
    for laps in (1, 5):
        poses = around_the_room(60 * laps, laps=laps)
        moves = (SE2(poses[:-1]).inverse() @ SE2(poses[1:])).xyt
        steps = [Constraint(k, k + 1, move, 1e6 * np.eye(3), "step") for k, move in enumerate(moves)]
        drift = drift_of(poses, steps, np.arange(len(moves)) == 9)
        clouds, keys = make_clouds(recording(ROOM, poses[:2]), 30.0), np.arange(len(poses))
        place_recognition._candidates(
            KeyScans(clouds, keys), drift, [], PlaceRecognitionConfig(), LoopConfig()
        )
    assert looked_at.count(looked_at[0]) == 2
    assert 4 < len(looked_at) < 2.6 * (looked_at[1:].index(looked_at[0]) + 1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("usual", "laid", "verdict"),
    [(0.0, 0.04, "accepted"), (0.0, 0.08, "the stretch contradicts the place"), (0.04, 0.08, "accepted")],
)
def test_a_place_is_believed_where_visits_violate_free_space_little_more_than_usual(
    monkeypatch, usual, laid, verdict
):
    """Cells of a maze are alike: nothing that fits tells them apart, what each saw through does."""
    monkeypatch.setattr(place_recognition, "_usual_violation", lambda *of: usual)
    monkeypatch.setattr(place_recognition, "_stretch_violation", lambda *of: laid)
    poses = np.column_stack([np.arange(20.0), np.zeros(20), np.zeros(20)])
    broken = np.arange(19) == 9
    steps = [Constraint(k, k + 1, np.array([1.0, 0.0, 0.0]), 1e4 * np.eye(3), "step") for k in range(19)]
    found = [Recognised(i, i - 10, np.zeros(3), 1.0, 0.9, 0.0, 0.01, 1e6 * np.eye(3)) for i in (12, 14, 16)]
    drift = drift_of(poses, steps, broken)
    believed, record = place_recognition._believed(None, found, drift, PlaceRecognitionConfig(), LoopConfig())
    assert {place.verdict for place in record} == {verdict}
    assert len(believed) == (verdict == "accepted")


def test_place_recognition_finds_nothing_to_do_in_an_unbroken_track():
    truth = around_the_room(60)
    log = recording(ROOM, truth, odometry=truth)
    result = run_slam(log, SlamConfig())
    assert result.recognised == []
    assert errors(result.trajectory.poses, SE2.from_array(truth))["m"] < 0.02


def test_the_turn_between_two_histograms_of_normals_is_among_those_tried():
    rng = np.random.default_rng(3)
    query = rng.uniform(0.0, 1.0, HEADINGS) + 10.0 * (np.arange(HEADINGS) % (HEADINGS // 3) == 5)
    for turn in (0, 7, HEADINGS - 4):
        tried = _headings(query, np.roll(query, turn))
        assert {(turn + d) % HEADINGS for d in (-1, 0, 1)} <= set(tried)
        assert len(tried) < HEADINGS // 2
