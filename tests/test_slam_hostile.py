"""What goes wrong in real logs: the map is right all the same, or the output says where it is doubtful."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.slam_drives import (
    Drive,
    Lie,
    Log,
    Sensor,
    Wheels,
    blinded,
    clock_back,
    make_log,
    shaken_stamps,
    sick,
    without,
)
from benchmarks.slam_logs import hall, office_plan
from benchmarks.slam_scores import score
from pipeline.slam.clouds import make_clouds
from pipeline.slam.pose_graph import Constraint, optimise
from pipeline.slam.refine import refine
from pipeline.slam.selfcheck import contradicted_keys
from pipeline.slam.slam import SlamConfig, SlamResult, run_slam, step_constraints

WHEELS = Wheels(0.02, -0.03, 0.003)
ROUTE = [
    (9.0, 7.0),
    (10.1, 7.0),
    (10.1, 4.0),
    (10.4, 4.0),
    (10.1, 7.0),
    (14.7, 7.0),
    (14.7, 10.5),
    (15.0, 10.5),
]
ROUTE += [(14.7, 7.0), (27.0, 7.0), (27.0, 15.0), (7.0, 15.0), (7.0, 7.0), (16.0, 7.0)]


def office(*lies: Lie, person: bool = False) -> Log:
    """Round the office once into two rooms, 70 m and 120 s, on wheels that drift by metres."""
    return make_log(
        "hostile", office_plan(1), np.array(ROUTE), Sensor(sick(180, 30.0), 0.3), drive=Drive(v=0.7),
        wheels=WHEELS, lies=lies, person=person,
    )  # fmt: skip


def mapped(log: Log) -> SlamResult:
    return run_slam(log.recording, SlamConfig())


def assert_right(log: Log, result: SlamResult, ate: float = 0.02) -> None:
    s = score(result.trajectory.poses, log.truth)
    assert len(result.trajectory) == len(log.recording)
    assert np.array_equal(result.trajectory.stamps_ns, log.recording.stamps_ns)
    assert s.folded == 0.0
    assert s.ate_aligned < ate
    assert s.return_m < ate
    assert result.check.good, result.check.reasons


LIES = {
    "runs backwards": [Lie("reverse", 12.0, 6.0), Lie("reverse", 60.0, 8.0)],
    "freezes and catches up": [Lie("freeze", 10.0, 1.2), Lie("freeze", 45.0, 2.0)],
    "slips for five seconds": [Lie("slip", 20.0, 5.0), Lie("spin", 70.0, 5.0)],
    "jumps": [Lie("jump", 25.0, 0.1), Lie("jump", 80.0, 0.1)],
}


@pytest.mark.parametrize("lies", LIES.values(), ids=LIES.keys())
def test_odometry_that_lies_is_found_out(lies):
    log = office(*lies)
    assert_right(log, mapped(log))


DAMAGES = {
    "three seconds of scans missing, twice": lambda log: without(without(log, 25.0, 3.0), 70.0, 3.0),
    "scans of nothing but NaN": lambda log: blinded(blinded(log, 20.0, 2.0), 75.0, 3.0),
    "clock set back": lambda log: clock_back(log, 50.0, 30.0),
    "stamps out of order": lambda log: shaken_stamps(log, 0.1, 0.5),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES.keys())
def test_damaged_logs_are_mapped(damage):
    log = damage(office())
    assert_right(log, mapped(log), ate=0.03)


def test_person_walking_through_half_of_the_scans_is_not_in_the_map():
    log = office(person=True)
    result = mapped(log)
    assert_right(log, result)
    true = log.plan.grid()
    origin = log.truth.poses[0] @ result.trajectory.poses[0].inverse()
    rows, cols = np.nonzero(result.grid.cells > 65)
    walls = origin @ result.grid.center_of(np.stack([rows, cols], axis=1))
    inside = true.contains(true.cell_of(walls))
    assert np.mean(log.plan.clearance(walls[inside]) <= 0.15) > 0.98


def test_featureless_corridor_of_thirty_metres_is_as_long_as_the_wheels_say():
    log = hall(2, tours=1, period=0.4)
    assert_right(log, mapped(log), ate=0.05)


def test_corridor_seen_by_the_lidar_alone_is_called_doubtful():
    recording = hall(2, tours=1, period=0.4).recording
    assert not run_slam(replace(recording, T_odom_base=None), SlamConfig()).check.good


def test_corridor_walked_while_the_wheels_run_backwards_is_right_or_called_doubtful():
    log = hall(1, lies=(Lie("reverse", 25.0, 5.0),), tours=1, period=0.4)
    result = mapped(log)
    assert not result.check.good or score(result.trajectory.poses, log.truth).folded == 0.0


def test_few_contradicted_scans_of_many_are_noticed():
    pairs = np.array([[0, 5], [0, 6], [0, 7], [1, 5], [1, 6], [2, 7]])
    share = np.array([0.6, 0.5, 0.1, 0.6, 0.1, 0.0])
    np.testing.assert_array_equal(contradicted_keys(pairs, share, 0.35), [0, 5])


def test_false_loop_forced_into_the_graph_is_overruled():
    log = office()
    config, result = SlamConfig(), mapped(log)
    clouds, track = make_clouds(log.recording, 30.0), result.track
    found = [loop for loop in result.loops if loop.accepted]
    assert len(found) >= 5
    soft = config.loops.soft
    loops = [
        Constraint(x.j, x.i, x.T_j_i, x.information / config.loops.inflation, "loop", soft) for x in found
    ]
    # the start of the log and its middle, 20 m away, said to be one place, as surely as a true loop
    lie = Constraint(5, len(track.keys) // 2, np.zeros(3), loops[0].information, "loop", soft)
    steps = step_constraints(track, config.tracking)
    closed = optimise(track.T_track_base[track.keys], [*steps, *loops, lie])
    refined, _ = refine(clouds, track.keys, closed, [*steps, lie], config.refine)
    true = log.truth.poses[track.keys]
    error = true.inverse() @ true[0] @ refined[0].inverse() @ refined
    assert np.abs(error.xy).max() < 0.05


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0])
def test_log_without_a_single_surface_follows_the_odometry(value):
    log = office()
    r = log.recording
    assert r.T_odom_base is not None
    odometry = r.T_odom_base[:40]
    ranges = np.full((40, 180), value, dtype=np.float32)
    result = run_slam(
        replace(r, ranges=ranges, stamps_ns=r.stamps_ns[:40], T_odom_base=odometry), SlamConfig()
    )
    np.testing.assert_allclose(result.trajectory.poses.xy, odometry.xy, atol=0.02)
    assert not result.check.good
