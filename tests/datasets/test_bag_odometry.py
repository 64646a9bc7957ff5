"""Odometry's clocks and the frames of a robot, by hand-computed cases."""

import inspect
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.helpers.foreign_bags import ODOMETRY, TF, S, odometry, tf, transform, write_foreign
from turtlebag.datasets.bags.decode import RawTransform
from turtlebag.datasets.bags.odometry import (
    OdometrySource,
    _increasing,
    _source,
    find_odometry,
    odometry_at,
    running,
    sensor_matrix,
    without_repeats,
)
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.bags.streams import Streams
from turtlebag.datasets.bags.tf_frames import FrameTree, matrix
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Trajectory


def straight(stamps, speed=1.0):
    t = np.asarray(stamps, dtype=float) * 1e-9
    return np.column_stack([speed * t, 0.0 * t, 0.0 * t])


def test_poses_are_sorted_by_stamp_and_each_stamp_counts_once():
    notes = []
    found = _increasing(np.array([3, 1, 2, 1]), np.arange(12.0).reshape(4, 3) / 10.0, "/odom", notes)
    assert found.stamps_ns.tolist() == [1, 2, 3]
    np.testing.assert_allclose(found.poses.xyt, [[0.3, 0.4, 0.5], [0.6, 0.7, 0.8], [0.0, 0.1, 0.2]])
    assert notes == ["/odom: stamps go back 2 times; sorted"]
    notes = []
    _increasing(np.array([1, 1, 2]), np.zeros((3, 3)), "/odom", notes)
    assert notes == []


def test_odometry_is_cleaned_of_places_that_are_none_and_of_millimetres():
    stamps, notes = np.arange(12) * S, []
    xyt = straight(stamps)
    xyt[3, 1], xyt[5, 2] = 2e8, math.nan
    found = _source("base", stamps, stamps + 7, xyt, "/odom", notes)
    assert notes == ["/odom: 2 poses are not finite or implausibly far away, and left out"]
    assert found.poses.stamps_ns.tolist() == [k * S for k in range(12) if k not in (3, 5)]
    assert found.by_log_time.stamps_ns.tolist() == [k * S + 7 for k in range(12) if k not in (3, 5)]
    notes = []
    turning = straight(stamps, 100.0)
    turning[:, 2] = 0.5
    found = _source("base", stamps, stamps, turning, "/odom", notes)
    np.testing.assert_allclose(found.poses.poses.xyt, turning * [1e-3, 1e-3, 1.0])
    assert "read as millimetres" in notes[0]
    nothing = _source("base", stamps[:1], stamps[:1], np.full((1, 3), np.nan), "/odom", [])
    assert (nothing.base, nothing.poses, nothing.by_log_time) == ("base", None, None)


@pytest.mark.parametrize("times", [2, 6, 30])
def test_poses_sent_again_until_there_are_new_ones_are_taken_once(times):
    """Six times each they bent every sweep: a house drive was 0.16 m off, not 0.02, and called good."""
    stamps, notes = np.arange(600) * S // 30, []
    moving = np.minimum(np.abs(np.arange(600) - 300), 200)  # a rest, there, back, and a rest
    true = Trajectory(stamps, SE2(straight(-moving * S // 30)))
    held = Trajectory(stamps, true.poses[np.arange(600) // times * times])
    found = without_repeats(held, "/odom", notes)
    assert notes == [f"/odom: each pose is sent about {times} times; used once"]
    np.testing.assert_allclose(found.at(stamps).xy[:-times], true.poses.xy[:-times], atol=1.1 * times / 30)
    on = (moving < 200 - 2 * times) & (np.abs(np.arange(600) - 300) > times)
    np.testing.assert_allclose(found.at(stamps).xy[on], true.poses.xy[on], atol=1e-6)
    assert np.diff(found.stamps_ns).max() <= times * S // 30 + 1


@pytest.mark.parametrize("poses", [np.zeros(50), np.arange(50.0), np.maximum(np.arange(50.0), 30.0), [7.0]])
def test_a_robot_that_stands_sends_no_repeats(poses):
    stamps, notes = np.arange(len(poses)) * S, []
    whole = Trajectory(stamps, SE2.from_xyt(poses, 0.0, 0.0))
    assert without_repeats(whole, "/odom", notes) is whole
    assert notes == []


def test_a_clock_that_never_ran_gives_way_to_the_times_of_recording():
    still, log, notes = np.array([5, 5, 5]), np.array([1, 2, 3]), []
    assert running(still, log, "/odom", notes) is log
    assert len(notes) == 1
    assert running(log, still, "/odom", notes) is log
    assert running(still, np.array([7, 7, 7]), "/odom", notes) is still
    assert len(notes) == 1


def test_odometry_is_looked_up_at_the_scans_stamps_or_their_times_of_recording():
    stamps = np.arange(11) * S // 2 + 100 * S
    poses = Trajectory(stamps, SE2.from_array(straight(stamps)))
    by_log = Trajectory(stamps + 900 * S, SE2.from_array(straight(stamps)))
    both = OdometrySource("base", poses, by_log)
    at, notes = np.array([101, 102]) * S, []
    np.testing.assert_allclose(odometry_at(both, at, at, notes).x, [101.0, 102.0])
    assert notes == []
    for late, other in (
        (0, False),
        (5 * S + S, False),
        (6 * S + 1, True),
        (-2 * S, False),
        (-3 * S - 1, True),
    ):
        notes = []
        scans = np.array([100, 102]) * S + late
        found = odometry_at(both, scans, np.array([1001, 1002]) * S, notes)
        assert any("different clocks" in note for note in notes) == other
        if other:
            np.testing.assert_allclose(found.x, [101.0, 102.0])
    notes = []
    assert odometry_at(OdometrySource("base", poses), at + 60 * S, at, notes) is None
    assert notes == ["scans and odometry have different clocks; odometry not used"]
    assert odometry_at(OdometrySource("base"), at, at, []) is None
    for off, outside in ((S // 10, 0), (S // 10 + 1, 1)):
        notes = []
        odometry_at(both, np.array([100 * S - off, 102 * S, 105 * S + S // 10]), at, notes)
        assert notes == [f"{outside} scans lie outside the odometry's time; its nearest pose is used"] * bool(
            outside
        )
    notes = []
    gappy = Trajectory(np.array([0, 1, 2, 5]) * S, SE2.from_array(straight(np.arange(4) * S)))
    odometry_at(OdometrySource("base", gappy), np.array([1, 2]) * S, at, notes)
    assert notes == ["odometry has a gap of 3.0 s, interpolated"]


def link(parent, child, xyz=(0.0, 0.0, 0.0), quaternion=(0.0, 0.0, 0.0, 1.0), stamp=0):
    values = {"parent": parent, "child": child, "xyz": xyz, "quaternion": quaternion, "stamp_ns": stamp}
    for name in inspect.signature(RawTransform).parameters:
        values.setdefault(name, 0)
    return RawTransform(**values)


@pytest.mark.parametrize("seed", range(4))
def test_a_matrix_is_that_of_scipys_rotation_normalised_or_not(seed):
    rng = np.random.default_rng(seed)
    quaternion, xyz = rng.normal(size=4), rng.normal(size=3)
    made = matrix(xyz, quaternion)
    np.testing.assert_allclose(made[:3, :3], Rotation.from_quat(quaternion).as_matrix(), atol=1e-12)
    np.testing.assert_array_equal(made[:, 3], [*xyz, 1.0])
    np.testing.assert_array_equal(matrix(xyz, np.zeros(4))[:3, :3], np.eye(3))


def test_frames_are_joined_over_fixed_links_both_ways():
    rng, tree = np.random.default_rng(5), FrameTree()
    links = [("base", "a"), ("a", "b"), ("c", "b"), ("base", "d"), ("x", "y")]
    T = {}
    for parent, child in links:
        xyz, quaternion = tuple(rng.normal(size=3)), tuple(rng.normal(size=4))
        tree.add(link(parent, child, xyz, quaternion), static=True)
        T[parent, child] = matrix(xyz, quaternion)
    expected = np.linalg.inv(T["base", "d"]) @ T["base", "a"] @ T["a", "b"] @ np.linalg.inv(T["c", "b"])
    np.testing.assert_allclose(tree.lookup("d", "c"), expected, atol=1e-12)
    np.testing.assert_allclose(tree.lookup("c", "d"), np.linalg.inv(expected), atol=1e-12)
    assert tree.lookup("base", "y") is None
    np.testing.assert_array_equal(tree.lookup("q", "q"), np.eye(4))
    assert tree.frames() == {"base", "a", "b", "c", "d", "x", "y"}


def test_a_link_that_moves_is_a_stream_and_one_of_the_odometry_always():
    tree = FrameTree()
    for k in range(3):
        tree.add(link("base", "lift", (0.0, 0.0, 0.1 * max(k - 1, 0)), stamp=k), static=False)
        tree.add(link("odom", "base", stamp=k), static=False)
        tree.add(link("base", "laser", (1.0, 0.0, 0.0), stamp=k), static=False)
    assert [t.stamp_ns for t in tree.moving["base", "lift"]] == [0, 2]
    assert [t.stamp_ns for t in tree.moving["odom", "base"]] == [0, 1, 2]
    assert set(tree.fixed) == {("base", "laser")}
    turned = FrameTree()
    turned.add(link("base", "arm"), static=False)
    turned.add(link("base", "arm", quaternion=(0.0, 0.0, 1.0, 0.0), stamp=4), static=False)
    assert [t.stamp_ns for t in turned.moving["base", "arm"]] == [0, 4]
    turned.add(link("base", "far", (2e8, 0.0, 0.0)), static=True)
    turned.add(link("base", "none", (math.nan, 0.0, 0.0)), static=True)
    assert turned.far == {("base", "far")}
    assert turned.frames() == {"base", "arm"}


def test_a_sensor_is_looked_for_from_the_odometrys_base_and_then_from_the_usual_ones():
    tree, notes, path = FrameTree(), [], Path("x")
    tree.add(link("base_link", "laser", (0.3, 0.0, 0.2)), static=True)
    assert tree.base() == "base_link"
    assert FrameTree().base() == "base_footprint"
    np.testing.assert_array_equal(sensor_matrix(path, tree, "laser", "laser", notes), np.eye(4))
    np.testing.assert_array_equal(sensor_matrix(path, tree, "robot", "laser", notes)[:3, 3], [0.3, 0.0, 0.2])
    assert notes == []
    np.testing.assert_array_equal(sensor_matrix(path, tree, "robot", "camera", notes), np.eye(4))
    assert notes[0].startswith(
        "no fixed transform robot -> camera (frames in /tf and /tf_static: base_link, laser)"
    )
    for x, refused in ((30.0, False), (30.1, True)):
        far = FrameTree()
        far.add(link("base_link", "laser", (x, 0.0, 0.0)), static=True)
        if refused:
            with pytest.raises(InputError, match=r"30\.1 m from 'base_link'"):
                sensor_matrix(path, far, "base_link", "laser", notes)
        else:
            assert sensor_matrix(path, far, "base_link", "laser", notes)[0, 3] == x
    tree.add(link("base_footprint", "base_link", (0.0, 0.0, 0.1)), static=True)
    assert tree.base() == "base_footprint"


def test_odometry_is_the_one_topic_or_odom_and_else_the_transforms(tmp_path):
    def bag(name, *topics, moving=True):
        messages = [
            ("/tf_static", TF, 0, tf(transform(0, "base_footprint", "base_scan", (0, 0, 0), (0, 0, 0, 1))))
        ]
        for k in range(4):
            messages += [(topic, ODOMETRY, k * S, odometry(k * S, float(k))) for topic in topics]
            if moving:
                step = transform(k * S, "odom", "base_footprint", (2.0 * k, 0, 0), (0, 0, 0, 1))
                messages.append(("/tf", TF, k * S, tf(step)))
        return Streams(open_bag(write_foreign(tmp_path / name, messages)))

    several = "several odometry topics and no /odom (/a, /b): /tf is used"
    by_tf, none = (
        "odometry from /tf (odom -> base_footprint)",
        "no odometry: neither an Odometry topic nor odom -> base in /tf",
    )
    for name, topics, moving, notes, step in (
        ("a", ["/x"], True, [], 1.0),
        ("b", ["/odom", "/x"], True, [], 1.0),
        ("c", ["/a", "/b"], True, [several, by_tf], 2.0),
        ("d", [], True, [by_tf], 2.0),
        ("e", [], False, [none], None),
    ):
        said = []
        found = find_odometry(bag(name, *topics, moving=moving), "base_scan", said)
        assert (found.base, said) == ("base_footprint", notes)
        if step is None:
            assert found.poses is None
        else:
            np.testing.assert_allclose(found.poses.poses.x, step * np.arange(4))
