"""Front ends and loop matchers by name: the map of each, what it must not change, and a user-defined one."""

import json
from dataclasses import replace
from itertools import product
from typing import ClassVar

import numpy as np
import pytest
import scipy

from benchmarks.slam_scores import errors
from tests.helpers.carmen_lines import carmen_text
from tests.helpers.slam_rooms import ROOM, around_the_room, drifted, recording
from turtlebag.datasets.se2 import SE2, compose
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.slam.loops.matcher import Stretch
from turtlebag.pipeline.slam.loops.matchers import MATCHERS
from turtlebag.pipeline.slam.mapper import SlamConfig, run_slam
from turtlebag.pipeline.slam.odometry.front_end import FrontEnd, Placed
from turtlebag.pipeline.slam.odometry.front_ends import FRONT_ENDS
from turtlebag.pipeline.slam.odometry.track import TrackingConfig
from turtlebag.pipeline.slam.odometry.tracker import Tracker, track_log
from turtlebag.pipeline.slam.odometry.wheels import Wheels
from turtlebag.pipeline.slam.scans.clouds import make_clouds, point_information
from turtlebag.pipeline.slam.scans.correspondences import Limits
from turtlebag.pipeline.slam.scans.scans import Scans

TRUTH = around_the_room(75, laps=1.3)
ERRORS_M = {"lines": 0.008, "kiss_icp": 0.012, "wheels": 0.012}
CHOICES = list(product(FRONT_ENDS, MATCHERS))


@pytest.fixture(scope="module")
def log():
    """More than a lap of the room with drifting odometry."""
    return recording(ROOM, TRUTH, odometry=drifted(TRUTH))


def settings(front_end="lines", match="lines", **others):
    loops = {"match": match, "held_m": 0.0}  # in a room the refinement would do without loops
    return SlamConfig.model_validate({"front_end": front_end, "loops": loops, **others})


def off(poses, log):
    return errors(poses, SE2.from_array(TRUTH))["m"]


@pytest.mark.slow
@pytest.mark.parametrize(("front_end", "match"), CHOICES)
def test_every_front_end_maps_with_every_loop_matcher(log, front_end, match):
    result = run_slam(log, settings(front_end, match))
    assert off(result.trajectory.poses, log) < ERRORS_M[front_end]
    assert sum(loop.accepted for loop in result.loops) > 0
    assert off(log.T_odom_base, log) > 20.0 * off(result.trajectory.poses, log)


@pytest.mark.slow
def test_libraries_alone_map_and_give_the_same_bits_again(log):
    alone = {
        "refine": {"rounds": 0},
        "tracking": {"calibration": False},
    }
    first, again = (run_slam(log, settings("kiss_icp", "open3d", **alone)) for _ in range(2))
    assert off(first.trajectory.poses, log) < 0.03
    assert first.track.source[1:].tolist() == [2] * (len(log) - 1)
    np.testing.assert_array_equal(first.trajectory.poses.xyt, again.trajectory.poses.xyt)
    np.testing.assert_array_equal(first.grid.cells, again.grid.cells)


@pytest.mark.slow
def test_without_odometry_kiss_icp_maps_by_a_steady_motion(log):
    result = run_slam(replace(log, T_odom_base=None), settings("kiss_icp", "open3d"))
    assert off(result.trajectory.poses, log) < 0.02


def test_wheels_without_odometry_are_one_line(log, tmp_path, capsys):
    path = tmp_path / "log.clf"
    path.write_text(carmen_text(log))
    out = tmp_path / "map"
    words = ["map", str(path), "--out", str(out), "--set", "front_end=wheels", "--set", "sensors=lidar", "-q"]
    assert main(words) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "front_end=wheels needs the odometry that sensors=lidar leaves out" in said
    assert not out.exists()


@pytest.mark.slow
def test_the_manifest_names_the_parts(log, tmp_path):
    path = tmp_path / "log.clf"
    path.write_text(carmen_text(log))

    def parts(out, *words):
        assert main(["map", str(path), "--out", str(tmp_path / out), "-q", *words]) == 0
        return json.loads((tmp_path / out / "manifest.json").read_text())["parts"]

    assert parts("usual") == {"front_end": "lines", "loops.match": "lines", "back_end": "gtsam"}
    chosen = ["--set", "front_end=kiss_icp", "--set", "loops.match=open3d"]
    assert parts("chosen", *chosen) == {"front_end": "kiss_icp", "loops.match": "open3d", "back_end": "gtsam"}
    unused = {"front_end": "wheels", "loops.match": None, "back_end": None}
    assert parts("alone", "--set", "sensors=odometry") == unused


def tracked(log, make, **changed):
    return track_log(Scans.of(log, 30.0), TrackingConfig(**changed), make)


@pytest.mark.slow
@pytest.mark.parametrize("front_end", FRONT_ENDS)
def test_key_scans_and_calibration_are_the_driver_s_whoever_places_the_scans(log, front_end):
    track = tracked(log, FRONT_ENDS[front_end])
    steps = (track.T_track_base[track.keys[:-1]].inverse() @ track.T_track_base[track.keys[1:]]).xyt
    assert np.all((np.hypot(steps[:, 0], steps[:, 1]) > 0.3) | (np.abs(steps[:, 2]) > 0.4))
    assert track.calibration.scale == pytest.approx(1.0 / 1.03, abs=0.01)
    assert np.median(track.overlap) > 0.8


def test_wheels_uncalibrated_are_what_odometry_alone_draws(log):
    by_wheels = tracked(log, Wheels, calibration=False)
    alone = run_slam(log, SlamConfig(sensors="odometry"))
    np.testing.assert_allclose(by_wheels.T_track_base.xyt, log.T_odom_base.xyt, atol=1e-9)
    np.testing.assert_allclose(alone.trajectory.poses.xyt, log.T_odom_base.xyt, atol=1e-9)
    np.testing.assert_array_equal(by_wheels.information, 0.0)


class PointToPoint:
    """A front end of a user's own: each scan on the points of the last ones, by ICP in NumPy."""

    made: ClassVar[list] = []

    def __init__(self, tracker: Tracker) -> None:
        self.made.append(self)
        self.tracker, self.asked = tracker, []
        self.scans = [SE2(tracker.pose) @ tracker.clouds.of(tracker.scan)]

    def step(self, points, odometry_step, wait_s):
        self.asked.append((self.tracker.scan, wait_s))
        pose = compose(self.tracker.pose, self.tracker.velocity if odometry_step is None else odometry_step)
        tree = scipy.spatial.cKDTree(np.vstack(self.scans[-10:]))
        for _ in range(20):
            at = SE2(pose) @ points
            distance, row = tree.query(at)
            near = distance < 0.3
            a, b = at[near], tree.data[row[near]]
            turn = (a - a.mean(axis=0)).T @ (b - b.mean(axis=0))
            yaw = np.arctan2(turn[0, 1] - turn[1, 0], turn[0, 0] + turn[1, 1])
            moved = b.mean(axis=0) - SE2.from_xyt(0.0, 0.0, yaw) @ a.mean(axis=0)
            pose = (SE2.from_xyt(*moved, yaw) @ SE2(pose)).xyt
        self.scans.append(SE2(pose) @ points)
        rmse = float(np.sqrt((distance[near] ** 2).mean()))
        return Placed(pose, point_information(points[near]) / 0.1**2, float(near.mean()), rmse)


@pytest.mark.slow
def test_a_front_end_of_one_s_own_fits_in(log):
    PointToPoint.made.clear()
    result = run_slam(log, SlamConfig(front_end=f"{__name__}:PointToPoint"))
    assert off(result.trajectory.poses, log) < 0.01
    asked = PointToPoint.made[0].asked
    assert [scan for scan, _ in asked] == list(range(1, len(log)))
    assert {wait_s for _, wait_s in asked} == {0.2}


class Speeds(Wheels):
    """As the odometry says; notes the motion that is expected to go on."""

    def __init__(self, tracker: Tracker) -> None:
        super().__init__(tracker)
        self.expected = {}

    def step(self, points, odometry_step, wait_s):
        """As in `FrontEnd`."""
        self.expected[self._tracker.scan] = self._tracker.velocity
        return super().step(points, odometry_step, wait_s)


def test_the_motion_over_a_gap_is_not_expected_to_go_on(log):
    """ACES without odometry span after its gap of 3 s, in which the robot had turned by 1.4 rad."""
    made, stamps = [], log.stamps_ns.copy()
    stamps[40:] += 3_000_000_000
    track_log(
        Scans.of(replace(log, stamps_ns=stamps), 30.0), TrackingConfig(),
        lambda tracker: made.append(Speeds(tracker)) or made[0],
    )  # fmt: skip
    steps = log.T_odom_base.steps()
    (speeds,) = made
    np.testing.assert_allclose(speeds.expected[40], steps[38], rtol=0.1, atol=0.01)
    np.testing.assert_array_equal(speeds.expected[41], 0.0)
    np.testing.assert_allclose(speeds.expected[42], steps[40], rtol=0.1, atol=0.01)


class SetRight(Wheels):
    """Drifts sideways by 1.2 m and finds back at scan 60."""

    def step(self, points, odometry_step, wait_s):
        """As in `FrontEnd`."""
        scan, drift = self._tracker.scan, SE2.from_xyt(0.0, 0.03, 0.0)
        moved = SE2(self._tracker.pose) @ SE2(odometry_step)
        for _ in range(40 if scan == 60 else scan in range(20, 60)):
            moved = moved @ (drift.inverse() if scan == 60 else drift)
        return Placed(moved.xyt, np.zeros((3, 3)), 1.0)


def test_scans_that_saw_nothing_before_the_track_jumped_back_are_carried_by_the_key_before():
    truth = around_the_room(120, laps=1.0)
    log = recording(ROOM, truth, odometry=truth)
    log.ranges[52:60] = np.nan
    result = run_slam(log, SlamConfig(front_end=f"{__name__}:SetRight"))
    error = np.linalg.norm(result.trajectory.poses.xy - truth[:, :2], axis=1)
    assert error.max() < 0.3
    assert not any("jump" in reason for reason in result.check.reasons)


def test_odometry_carries_until_a_scan_has_something_to_match(log):
    blind = log.ranges.copy()
    blind[:7] = np.nan
    made = []

    def make(tracker: Tracker) -> FrontEnd:
        made.append((tracker.scan, list(tracker.keys)))
        return Wheels(tracker)

    track = tracked(replace(log, ranges=blind), make, calibration=False)
    assert made == [(7, [0, 7])]
    np.testing.assert_allclose(track.T_track_base.xyt, log.T_odom_base.xyt, atol=1e-9)
    assert not track.usable[:7].any()
    assert track.usable[7:].all()


def test_what_is_known_better_later_moves_the_scans_but_no_key_scan(log):
    class Hindsight(Wheels):
        def step(self, points, odometry_step, wait_s):
            placed = super().step(points, odometry_step, wait_s)
            there = np.array([9.0, 9.0, 0.0])
            late = tuple((k, there) for k in range(20)) if self._tracker.scan == 20 else ()
            seen = np.diag([3.0, 2.0, 1.0]) if late else np.eye(3)
            return replace(placed, revised=late, overlap=0.3 if late else 0.9, information=seen)

    track, plain = tracked(log, Hindsight), tracked(log, Wheels)
    moved = np.flatnonzero((track.T_track_base.xyt != plain.T_track_base.xyt).any(axis=1))
    assert moved.tolist() == [k for k in range(20) if k not in track.keys]
    # what they fitted was where they lay before
    assert np.flatnonzero(track.overlap == 0.3).tolist() == [*moved.tolist(), 20]
    assert np.flatnonzero(track.information[:, 0, 0] == 3.0).tolist() == [*moved.tolist(), 20]


def test_a_scan_that_is_not_sure_becomes_no_key_scan(log):
    class Unsure(Wheels):
        def step(self, points, odometry_step, wait_s):
            return replace(super().step(points, odometry_step, wait_s), sure=self._tracker.scan >= 50)

    keys = tracked(log, Unsure).keys
    assert keys[:2].tolist() == [0, 50]


@pytest.mark.parametrize("matcher", MATCHERS.values())
def test_loop_matchers_say_the_same_pose_in_the_same_frame(matcher):
    poses = around_the_room(60)
    clouds = make_clouds(recording(ROOM, poses), 30.0)

    def stretch(about, scans):
        scans = np.array(scans)
        return Stretch(about, scans, (SE2(poses[about]).inverse() @ SE2(poses[scans])).xyt)

    query, place, by = stretch(12, [10, 11, 12]), stretch(8, [5, 6, 7, 8, 9]), matcher()
    true = (SE2(poses[8]).inverse() @ SE2(poses[12])).xyt
    start = compose(true, np.array([0.05, -0.04, 0.03]))
    found = by.match(clouds, query, place, start, Limits(0.2, 0.05, 20))
    error = (SE2(true).inverse() @ found.T_map_base).xyt
    assert np.hypot(*error[:2]) < 0.02
    assert abs(error[2]) < 0.01
    assert found.overlap > 0.8
    assert found.rmse < 0.06
    assert np.linalg.eigvalsh(found.information)[0] > 1e3
    still = by.match(clouds, query, place, start, Limits(0.2, 0.05, 0))
    np.testing.assert_allclose(still.T_map_base.xyt, start, atol=1e-12)


@pytest.mark.slow
def test_where_the_front_end_is_told_nothing_it_answers_what_it_expects(log):
    """A scan without a return in the middle of the log, whoever places it."""
    holed = log.ranges.copy()
    holed[60:63] = np.inf
    for make in FRONT_ENDS.values():
        track = tracked(replace(log, ranges=holed), make)
        assert not track.usable[60:63].any()
        assert not np.isin([60, 61, 62], track.keys).any()
        np.testing.assert_array_equal(track.information[60:63], 0.0)
        steps = (track.T_track_base[59:62].inverse() @ track.T_track_base[60:63]).xyt
        assert np.all(np.hypot(steps[:, 0], steps[:, 1]) < 0.5)
