"""When a loop is accepted, and which steps of a log the accepted loops span: these are no breaks."""

import numpy as np

from tests.helpers.slam_rooms import ROOM, around_the_room, recording
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind, Loop
from turtlebag.pipeline.slam.loops.by_distance import LoopClosing, LoopConfig, LoopFinder, close_loops
from turtlebag.pipeline.slam.loops.closure import spanned_steps
from turtlebag.pipeline.slam.scans.align import Alignment
from turtlebag.pipeline.slam.scans.clouds import KeyScans, make_clouds


def loop(i: int, j: int, verdict: str) -> Loop:
    return Loop(i, j, np.zeros(3), 1.0, 1.0, 0.01, np.eye(3), verdict)


def test_accepted_loops_span_the_steps_between_their_keys():
    record = [loop(1, 4, "accepted"), loop(7, 6, "accepted"), loop(0, 9, "rejected")]
    spanned = spanned_steps(record, 10)
    assert spanned.tolist() == [False, True, True, True, False, False, True, False, False]
    assert not spanned_steps([], 10).any()


class Trusting:
    """A matcher that finds whatever it is asked for."""

    def match(self, clouds, query, place, start, limits):
        return Alignment(SE2(start), 1e3 * np.eye(3), 0.9, 0.01, 0.1)


def test_a_loop_that_would_let_visits_see_through_walls_is_not_believed():
    true = around_the_room(150)
    log = recording(ROOM, true, odometry=true)
    keys = np.arange(0, 150, 4)
    T, clouds = SE2(true[keys]), make_clouds(log, 8.0)
    closing, part = LoopClosing(LoopConfig(min_score=0.01)), np.zeros(len(keys), np.int64)
    finder = LoopFinder(KeyScans(clouds, keys), T, [], closing, part)
    finder.matcher = Trusting()
    i, j = len(keys) - 1, 0
    right = T[j].inverse() @ T[i]
    assert finder.match_from(i, j, right.xyt, 0.0, 0.0).verdict == "accepted"
    for off in (SE2.from_xyt(1.0, 0.0, 0.0), SE2.from_xyt(0.0, -1.2, 0.0), SE2.from_xyt(0.0, 0.0, 0.5)):
        wrong = (right @ off).xyt
        assert finder.match_from(i, j, wrong, 0.0, 0.0).verdict == "free-space violations", off.xyt


def test_loops_are_found_within_parts_of_the_log_and_not_across_a_break():
    true = around_the_room(300, laps=2)
    keys = np.arange(0, 300, 5)
    scans = KeyScans(make_clouds(recording(ROOM, true, odometry=true), 8.0), keys)
    T, n = SE2(true[keys]), len(keys)
    along = [
        Constraint(k, k + 1, step, np.diag([400.0, 400.0, 4e3]), Kind.STEP)
        for k, step in enumerate(T.steps())
    ]
    closing, part = LoopClosing(LoopConfig()), np.zeros(n, dtype=np.int64)
    whole = close_loops(scans, T, along, closing, part)
    assert [c.kind for c in whole.loops].count(Kind.LOOP) == sum(loop.accepted for loop in whole.record) > 3
    assert np.abs((whole.poses - T.xyt)[:, :2]).max() < 0.05
    torn = close_loops(scans, T, along, closing, (np.arange(n) > n // 2 - 1).astype(np.int64))
    assert all((loop.i < n // 2) == (loop.j < n // 2) for loop in torn.record)
