"""Places are recognised where drift exceeds every gate, but never in buildings that repeat themselves."""

import math
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.known_logs import Known
from benchmarks.slam_scores import errors
from tests.helpers.made_drives import Drive, FloorPlan, Sensor, Wheels, make_log, sick
from tests.helpers.made_logs import WHEELS, interval, office_plan, without
from tests.helpers.slam_rooms import ROOM, around_the_room, recording
from turtlebag.datasets.se2 import SE2, between
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind, Loop
from turtlebag.pipeline.slam.graph.drift import HONEST, SIGMAS, drift_of
from turtlebag.pipeline.slam.loops.by_appearance import (
    PlaceRecognitionConfig,
    accepted_sets,
    join_parts,
    judge_place,
    recognise_places,
    submap_searches,
)
from turtlebag.pipeline.slam.loops.by_distance import LoopClosing, LoopConfig
from turtlebag.pipeline.slam.loops.consistency import agreeing_sets, competing, consistency
from turtlebag.pipeline.slam.loops.matchers import LineMatch
from turtlebag.pipeline.slam.loops.submaps import (
    HEADINGS,
    MOST_SHIFT,
    RESOLUTION_M,
    laid_on,
    likely_turns,
    make_submap,
    similarity,
    windows,
)
from turtlebag.pipeline.slam.mapper import SlamConfig, run_slam
from turtlebag.pipeline.slam.odometry.breaks import TrackBreaks
from turtlebag.pipeline.slam.scans.align import Alignment
from turtlebag.pipeline.slam.scans.clouds import KeyScans, make_clouds


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
        f"alike-{seed}", plan, np.array(route), Sensor(sick(180, 8.0), 0.4), drive=Drive(v=0.7),
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
    accepted = [place for place in result.recognised if place.accepted]
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
    assert any("break where" in reason for reason in result.check.reasons)


@pytest.mark.slow
def test_rooms_like_one_another_are_not_taken_for_one():
    log = identical_rooms(1, rooms=6)
    result = run_slam(log.recording, SlamConfig())
    assert errors(result.trajectory.poses, log.reference)["m"] < 0.03
    assert result.check.verdict == "good", result.check.reasons


@pytest.mark.slow
@pytest.mark.parametrize("there_and_back", [False, True])
def test_robot_lost_among_rooms_like_one_another_is_called_doubtful(there_and_back):
    log = identical_rooms(2, rooms=6, there_and_back=there_and_back)
    log = displaced(without(log, 45.0, 8.0), 45.0, (6.0, 3.0, 1.0))
    result = run_slam(log.recording, SlamConfig())
    verdicts = {place.verdict for place in result.recognised}
    assert "ambiguous: another place fits as well" in verdicts
    assert "accepted" not in verdicts
    assert any("break where" in reason for reason in result.check.reasons)


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
    score_, pose = laid_on(query, other, {})
    assert score_ > 0.6
    assert np.hypot(*(pose[:2] - true[:2])) < 0.3
    assert similarity(query, [query])[0] == pytest.approx(1.0)


def place(i: int, j: int, T_j_i: tuple[float, float, float], overlap: float = 0.9) -> Loop:
    return Loop(i, j, np.array(T_j_i), 0.8, overlap, 0.01, STEP)


STEP = np.diag([0.02**-2, 0.02**-2, 0.005**-2])


def test_places_that_agree_outvote_the_aliases():
    n = 40
    poses = np.column_stack([np.arange(n) * 1.0, np.zeros(n), np.zeros(n)])
    broken = np.arange(n - 1) == 19
    steps = [Constraint(k, k + 1, np.array([1.0, 0.0, 0.0]), STEP, Kind.STEP) for k in range(n - 1)]
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
    moved, joined = join_parts(poses, part, members)
    np.testing.assert_allclose(between(moved[0], moved[8]), (0.5, -0.4, 1.0), atol=1e-12)
    np.testing.assert_allclose(SE2(moved[6:]).steps(), SE2(poses[6:]).steps(), atol=1e-12)
    np.testing.assert_array_equal(moved[:6], poses[:6])
    assert joined.tolist() == [0, 0, 0, 1, 1, 1, 0, 0, 0]
    again, _ = join_parts(moved, joined, [place(7, 1, (0.2, 0.1, 0.3))])
    np.testing.assert_array_equal(again, moved)


def test_a_place_is_looked_for_near_where_the_track_has_it():
    """Along a line, each metre known to two: on older places that the drift allows, as far off as it is."""
    poses = np.column_stack([np.arange(60.0), np.zeros(60), np.zeros(60)])
    vague = np.diag([0.25, 0.25, 1e8])
    steps = [Constraint(k, k + 1, np.array([1.0, 0.0, 0.0]), vague, Kind.STEP) for k in range(59)]
    drift = drift_of(poses, steps, np.zeros(59, dtype=bool))
    searches = dict(submap_searches(drift, [], range(0, 60, 4), 10.0))
    assert len(searches) > 4
    for i in range(0, 60, 4):
        # Three standard deviations, which grow with the root of the way.
        off = {j: SIGMAS * math.sqrt(HONEST * 4.0 * (i - j)) for j in range(0, i, 4)}
        reached = {j: m for j, m in off.items() if m > 10.0 and i - j < m + MOST_SHIFT * RESOLUTION_M}
        assert searches.get(i, {}) == pytest.approx(reached, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sigma_m", "walls", "found"), [(0.5, 1.0, True), (0.05, 1.0, False), (0.5, 0.0, False)]
)
def test_what_looks_alike_is_a_place_where_the_drift_allows_it_and_there_are_walls(sigma_m, walls, found):
    """On the track the second round of a room lies up to 5 m beside the first."""
    truth = around_the_room(120, laps=2)
    clouds = make_clouds(recording(ROOM, truth), 30.0)
    scans = KeyScans(clouds._replace(normals=walls * clouds.normals), np.arange(120))
    drifted = truth + np.linspace(0.0, 5.0, 120)[:, None] * [1.0, 0.0, 0.0]
    information = np.diag([sigma_m**-2, sigma_m**-2, 1e8]) * HONEST
    moves = SE2(drifted).steps()
    steps = [Constraint(k, k + 1, move, information, Kind.STEP) for k, move in enumerate(moves)]
    no, gaps = np.zeros(119, dtype=bool), np.zeros((0, 2), dtype=np.int64)
    closing = LoopClosing(LoopConfig(reach_m=1.0))
    made = recognise_places(
        scans, SE2(drifted), steps, TrackBreaks(no, no, no, gaps), [], PlaceRecognitionConfig(), closing
    )
    assert bool(made.record) == found


@pytest.mark.parametrize(
    ("few", "verdict"), [((0.6, 0.9, 0.6), "candidate"), ((0.2, 0.9, 0.6), "low overlap")]
)
def test_a_place_fits_as_well_as_one_in_four_scans_do_and_violates_as_little_free_space(few, verdict):
    truth = around_the_room(40)
    scans = KeyScans(make_clouds(recording(ROOM, truth), 30.0), np.arange(40))
    told = iter([0.9, *few])

    class Told(LineMatch):
        def match(self, clouds, query, place, start, limits):
            return Alignment(SE2(start), 1e4 * np.eye(3), next(told), 0.01, 0.0)

    def about(middle):
        keys = np.arange(middle - 4, middle + 5)
        T_middle_keys = (SE2(truth[middle]).inverse() @ SE2(truth[keys])).xyt
        return SimpleNamespace(middle=middle, keys=keys, T_middle_keys=T_middle_keys)

    start = between(truth[4], truth[12])
    config = PlaceRecognitionConfig(min_overlap=0.6)
    found = judge_place(scans, about(12), about(4), 0.8, start, config, Told())
    assert (found.i, found.j, found.verdict) == (12, 4, verdict)
    if verdict == "candidate":
        assert found.overlap == pytest.approx(0.7)
        assert found.violation < 0.01


def test_a_place_passed_again_and_again_is_looked_for_once():
    """After a break nothing is known of, five rounds of a room cost what one does."""
    looked_at: list[set[int]] = []
    for laps in (1, 5):
        poses = around_the_room(60 * laps, laps=laps)
        moves = (SE2(poses[:-1]).inverse() @ SE2(poses[1:])).xyt
        steps = [Constraint(k, k + 1, move, 1e6 * np.eye(3), Kind.STEP) for k, move in enumerate(moves)]
        broken = np.arange(len(moves)) == 9
        searches = submap_searches(drift_of(poses, steps, broken), [], windows(len(poses), broken), 3.0)
        looked_at.append({middle for i, off in searches for middle in (i, *off)})
    assert 4 < len(looked_at[1]) < 1.6 * len(looked_at[0])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("usual", "laid", "verdict"),
    [(0.0, 0.04, "accepted"), (0.0, 0.08, "the stretch contradicts the place"), (0.04, 0.08, "accepted")],
)
def test_a_place_is_believed_where_visits_violate_free_space_little_more_than_usual(usual, laid, verdict):
    """Cells of a maze are alike: nothing that fits tells them apart, what each saw through does."""
    violations = SimpleNamespace(usual=lambda: usual, with_stretch=lambda stretch: laid)
    poses = np.column_stack([np.arange(20.0), np.zeros(20), np.zeros(20)])
    broken = np.arange(19) == 9
    steps = [Constraint(k, k + 1, np.array([1.0, 0.0, 0.0]), 1e4 * np.eye(3), Kind.STEP) for k in range(19)]
    found = [Loop(i, i - 10, np.zeros(3), 1.0, 0.9, 0.01, 1e6 * np.eye(3)) for i in (12, 14, 16)]
    drift = drift_of(poses, steps, broken)
    believed, record = accepted_sets(found, drift, violations, PlaceRecognitionConfig(), LoopConfig())
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
        tried = likely_turns(query, np.roll(query, turn))
        assert {(turn + d) % HEADINGS for d in (-1, 0, 1)} <= set(tried)
        assert len(tried) < HEADINGS // 2
