"""Which is trusted: odometry that the scans contradict, and scans that observe little."""

import numpy as np
import pytest

from tests.helpers.slam_rooms import ROOM, recording
from turtlebag.datasets.se2 import SE2, compose
from turtlebag.pipeline.slam.graph.constraints import Kind
from turtlebag.pipeline.slam.odometry.calibration import Calibration
from turtlebag.pipeline.slam.odometry.evidence import evidence_of
from turtlebag.pipeline.slam.odometry.track import OdometryNoise, Track, TrackingConfig, step_constraints
from turtlebag.pipeline.slam.odometry.trust import OdometryTrust
from turtlebag.pipeline.slam.scans.align import STEP_COVARIANCE_SCALE, contradiction


def believed(*told):
    """Whether wheels are believed after each step: they told the way, the scan saw what comes with it, and
    the robot drove 0.1 m."""
    wheels, pose, out = OdometryTrust(OdometryNoise()), np.zeros(3), []
    wheels.judge(np.zeros(3), pose, np.zeros((3, 3)))
    for way, seen in told:
        pose = compose(pose, np.array([0.1, 0.0, 0.0]))
        wheels.judge(np.array([way, 0.0, 0.0]), pose, seen)
        out.append(wheels.trusted)
    return out


SEES, BLIND = np.diag([1e6, 1e6, 1e6]), np.diag([0.0, 1e6, 1e6])


def test_wheels_contradicted_three_times_are_distrusted_until_they_agree_again():
    lie, truth = (0.3, SEES), (0.1, SEES)
    assert believed(lie, lie, truth, lie, lie) == [True] * 5
    assert believed(lie, lie, lie, (0.3, BLIND), truth) == [True, True, False, False, True]
    # where the scan is blind the robot went on steadily: wheels that say so are honest again
    assert believed(lie, lie, lie, (0.1, BLIND)) == [True, True, False, True]


def test_wheels_are_no_liars_for_what_nobody_saw_nor_for_a_start_told_late():
    assert believed(*[(0.3, BLIND)] * 6) == [True] * 6
    assert believed(*[(0.13, SEES)] * 6) == [True] * 6
    assert believed((0.1, SEES), *[(0.0, SEES)] * 2, *[(0.1, SEES)] * 3) == [True] * 6


def test_a_turn_that_comes_late_says_nothing_of_the_way():
    """The robot winds along, and the scans see it; the odometry has its turns two steps late."""
    wheels, pose, turns = OdometryTrust(OdometryNoise()), np.zeros(3), [0.0, 0.0, *[0.2, -0.2, -0.2, 0.2] * 4]
    for late, turn in zip(turns, turns[2:], strict=False):
        pose = compose(pose, np.array([0.1, 0.0, turn]))
        wheels.judge(np.array([0.1, 0.0, late]), pose, SEES)
        assert wheels.trusted


def test_a_turn_on_the_spot_gives_no_trust_in_the_way_back():
    wheels, pose = OdometryTrust(OdometryNoise()), np.zeros(3)
    for _ in range(5):
        pose = compose(pose, np.array([0.1, 0.0, 0.0]))
        wheels.judge(np.zeros(3), pose, SEES)
    for _ in range(2):
        wheels.judge(np.array([0.0, 0.0, 0.15]), pose, SEES)
        assert not wheels.trusted


def test_encoders_that_freeze_are_found_out():
    assert not believed((0.1, SEES), *[(0.0, SEES)] * 6)[-1]


def test_distrusted_wheels_count_for_nothing_where_scans_observe_little_either():
    """An odometry that stops in a corridor whose doors show a little of the way: in the graph it outweighed
    them, and the map was off by 0.7 m."""
    n = np.arange(20)
    poses = np.column_stack([0.1 * n, 0.0 * n, 0.0 * n])
    log = recording(ROOM, poses, odometry=np.minimum(poses, 0.95))
    little = np.broadcast_to(np.diag([3e4, 1e6, 1e6]), (20, 3, 3))
    source, none = np.zeros(20, np.int8), np.zeros(20)
    track = Track(SE2(poses), n, none + 1.0, none, little, source, np.zeros((19, 3)), Calibration(), n >= 0)
    evidence = evidence_of(log, track, OdometryNoise())
    assert not evidence.distrusted[:8].any()
    assert evidence.distrusted[12:].all()
    # what the scans saw needs no other evidence
    assert not evidence.unobserved_m.any()


@pytest.mark.filterwarnings("error")
def test_a_log_of_one_scan_has_no_way_to_see():
    log, one = recording(ROOM, np.zeros((1, 3)), odometry=np.zeros((1, 3))), np.ones(1)
    track = Track(
        SE2(np.zeros((1, 3))), np.zeros(1, np.int64), one, one, BLIND[None], np.zeros(1, np.int8),
        np.zeros((0, 3)), Calibration(), one > 0,
    )  # fmt: skip
    assert evidence_of(log, track, OdometryNoise()).unobserved_m.tolist() == [0.0]


@pytest.mark.parametrize("seed", range(4))
def test_a_contradiction_is_in_standard_deviations_of_both(seed):
    rng = np.random.default_rng(seed)
    a, b = (m.T @ m for m in rng.normal(size=(2, 5, 3)))
    apart = rng.normal(size=3)
    both = np.linalg.inv(a) + STEP_COVARIANCE_SCALE * np.linalg.inv(b)
    assert contradiction(apart, a, b) == pytest.approx(apart @ np.linalg.solve(both, apart), rel=1e-3)
    blind = b - np.outer(b[0], b[0]) / b[0, 0]
    assert contradiction(np.array([1.0, 0.0, 0.0]), a, blind) == pytest.approx(0.0, abs=1e-6)


def test_wheels_that_stood_still_while_the_scans_moved_are_no_surer_than_wheels_that_drove():
    """MIT CSAIL without scans for 20 s, in which the wheels said nothing: they were sure to 1 mm."""

    def sure(way):
        T, steps = SE2.from_xyt([0.0, 4.0], 0.0, 0.0), np.array([[way, 0.0, 0.0]])
        see = np.zeros((2, 3, 3)), np.ones(2)
        track = Track(
            T, np.arange(2), see[1], see[1], see[0], np.zeros(2, np.int8), steps, Calibration(), see[1] > 0
        )
        return next(c for c in step_constraints(track, TrackingConfig()) if c.kind is Kind.WHEELS).information

    assert np.array_equal(sure(0.0), sure(4.0))
    assert (np.diag(sure(8.0)) < np.diag(sure(4.0))).all()
