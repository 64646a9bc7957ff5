"""Place recognition without an initial guess, and several recordings in one map."""

import numpy as np
import pytest

from tests.helpers.slam_rooms import ROOM, around_the_room, drifted, recording
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Trajectory
from turtlebag.pipeline.slam.graph.constraints import Kind
from turtlebag.pipeline.slam.mapper import SlamConfig, run_slam
from turtlebag.pipeline.slam.scans.clouds import make_clouds
from turtlebag.pipeline.slam.sessions import joined_clouds
from turtlebag.reports.metrics.trajectory import ate

FIRST = around_the_room(100)
SECOND = around_the_room(100)[::-1] + np.array([0.1, 0.1, np.pi])


def test_joined_clouds_keep_every_scan():
    a = make_clouds(recording(ROOM, FIRST[:3]), 30.0)
    b = make_clouds(recording(ROOM, SECOND[:2]), 30.0)
    both = joined_clouds([a, b])
    assert len(both.starts) == 6
    np.testing.assert_array_equal(both.of(4), b.of(1))
    kept = both.table[3][both.table[3] >= 0]
    np.testing.assert_array_equal(both.points[kept], b.points[b.table[0][b.table[0] >= 0]])


@pytest.mark.slow
def test_second_session_joins_the_first_map():
    a = recording(ROOM, FIRST, odometry=drifted(FIRST))
    elsewhere = SE2.from_xyt(-4.0, 9.0, -2.2) @ SE2.from_array(SECOND)
    b = recording(ROOM, SECOND, odometry=drifted(elsewhere.xyt, seed=3), seed=7)
    result = run_slam(a, SlamConfig(), more=[b])
    assert len(result.trajectory) == 200
    truth = SE2.from_array(np.vstack([FIRST, SECOND]))
    stamps = np.arange(200) * 10**9
    both = ate(Trajectory(stamps, result.trajectory.poses), Trajectory(stamps, truth), align=False)
    assert both["rmse"] < 0.01


@pytest.mark.slow
def test_a_third_session_joins_and_no_step_leads_from_one_to_the_next():
    a, few = recording(ROOM, FIRST, odometry=drifted(FIRST)), SECOND[:26]
    later = [
        recording(ROOM, few, odometry=(SE2.from_xyt(x, 9.0, -2.2) @ SE2.from_array(few)).xyt, seed=seed)
        for x, seed in ((-4.0, 7), (20.0, 8))
    ]
    session = run_slam(a, SlamConfig(), more=later).session
    assert session.evidence.borders.tolist() == [100, 126]
    for j in np.searchsorted(session.track.keys, [100, 126]).tolist():
        kinds = {c.kind for c in session.graph.constraints if (c.i, c.j) == (j - 1, j)}
        assert Kind.BORDER in kinds
        assert not kinds & {Kind.STEP, Kind.WHEELS, Kind.STEADY}


@pytest.mark.slow
def test_a_second_session_of_three_metres_joins():
    a = recording(ROOM, FIRST, odometry=drifted(FIRST))
    few = SECOND[:26]
    elsewhere = SE2.from_xyt(-4.0, 9.0, -2.2) @ SE2.from_array(few)
    result = run_slam(a, SlamConfig(), more=[recording(ROOM, few, odometry=elsewhere.xyt, seed=7)])
    assert np.count_nonzero(result.keys >= 100) < 17
    off = np.linalg.norm(result.trajectory.poses.xy[100:] - few[:, :2], axis=1)
    assert off.max() < 0.05
