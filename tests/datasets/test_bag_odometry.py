"""Odometry's clocks and the frames of a robot, by hand-computed cases."""

import inspect
import math
import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.helpers.foreign_bags import (
    ODOMETRY,
    SCAN,
    TF,
    S,
    laser_scan,
    odometry,
    tf,
    transform,
    write_foreign,
)
from turtlebag.datasets.bags.contents import Contents
from turtlebag.datasets.bags.decode import RawTransform
from turtlebag.datasets.bags.frames import FrameTree, matrix
from turtlebag.datasets.bags.odometry import (
    OdometrySource,
    find_odometry,
    odometry_at,
    sensor_pose,
    without_repeats,
)
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.bags.stamps import check_order, running
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Trajectory


def straight(stamps, speed=1.0):
    t = np.asarray(stamps, dtype=float) * 1e-9
    return np.column_stack([speed * t, 0.0 * t, 0.0 * t])


def odometry_of(folder, poses):
    """Odometry and what was found in a bag of (stamp [ns], x, y, yaw), a message a second."""
    messages = []
    for k, (stamp, x, y, yaw) in enumerate(poses):
        message = odometry(int(stamp), x)
        message.pose.pose.position.y = y
        message.pose.pose.orientation.z, message.pose.pose.orientation.w = (
            math.sin(yaw / 2),
            math.cos(yaw / 2),
        )
        messages.append(("/odom", ODOMETRY, k * S, message))
    findings = []
    found = find_odometry(Contents(open_bag(write_foreign(folder, messages))), "base_footprint", findings)
    return found, [str(finding) for finding in findings]


def test_poses_are_sorted_by_stamp_and_each_stamp_counts_once(tmp_path):
    rows = [(3, 0.0, 0.1, 0.2), (1, 0.3, 0.4, 0.5), (2, 0.6, 0.7, 0.8), (1, 0.9, 1.0, 1.1)]
    found, said = odometry_of(tmp_path / "a", rows)
    assert found.poses.stamps_ns.tolist() == [1, 2, 3]
    np.testing.assert_allclose(found.poses.poses.xyt, [[0.3, 0.4, 0.5], [0.6, 0.7, 0.8], [0.0, 0.1, 0.2]])
    assert said == ["/odom: stamps go back 2 times, by up to 0.000 s; sorted"]
    assert odometry_of(tmp_path / "b", rows[1:3])[1] == []


def test_odometry_is_cleaned_of_places_that_are_none_and_of_millimetres(tmp_path):
    stamps = np.arange(12) * S
    rows = np.column_stack([stamps, straight(stamps)])
    rows[3, 2], rows[5, 3] = 2e8, math.nan
    found, said = odometry_of(tmp_path / "a", rows)
    assert said == [
        "/odom: 1 quaternion is zero or not finite; left out",
        "/odom: 1 pose is not finite or implausibly far away; left out",
    ]
    assert found.poses.stamps_ns.tolist() == [k * S for k in range(12) if k not in (3, 5)]
    turning = np.column_stack([stamps, straight(stamps, 100.0)])
    turning[:, 3] = 0.5
    found, said = odometry_of(tmp_path / "b", turning)
    np.testing.assert_allclose(found.poses.poses.xyt, turning[:, 1:] * [1e-3, 1e-3, 1.0])
    assert said == ["/odom: the robot would be implausibly fast; read as millimetres"]
    nothing, _ = odometry_of(tmp_path / "c", [(0, math.nan, math.nan, math.nan)])
    assert (nothing.base, nothing.poses, nothing.by_log_time) == ("base_footprint", None, None)


@pytest.mark.parametrize("times", [2, 6, 30])
def test_poses_sent_again_until_there_are_new_ones_are_taken_once(times):
    """Six times each they bent every sweep: a house drive was 0.16 m off, not 0.02, and called good."""
    stamps = np.arange(600) * S // 30
    moving = np.minimum(np.abs(np.arange(600) - 300), 200)  # a rest, there, back, and a rest
    true = Trajectory(stamps, SE2(straight(-moving * S // 30)))
    held = Trajectory(stamps, true.poses[np.arange(600) // times * times])
    found, usual = without_repeats(held)
    assert usual == times
    np.testing.assert_allclose(found.at(stamps).xy[:-times], true.poses.xy[:-times], atol=1.1 * times / 30)
    on = (moving < 200 - 2 * times) & (np.abs(np.arange(600) - 300) > times)
    np.testing.assert_allclose(found.at(stamps).xy[on], true.poses.xy[on], atol=1e-6)
    assert np.diff(found.stamps_ns).max() <= times * S // 30 + 1


def test_repeated_poses_are_said_to_be(tmp_path):
    found, said = odometry_of(tmp_path / "a", [(k * S // 30, 0.01 * (k // 6), 0.0, 0.0) for k in range(60)])
    assert said == ["/odom: each pose is sent about 6 times; used once"]
    assert len(found.poses.stamps_ns) == len(found.by_log_time.stamps_ns) == 15  # the last run has no end


@pytest.mark.parametrize("poses", [np.zeros(50), np.arange(50.0), np.maximum(np.arange(50.0), 30.0), [7.0]])
def test_a_robot_that_stands_sends_no_repeats(poses):
    stamps = np.arange(len(poses)) * S
    whole = Trajectory(stamps, SE2.from_xyt(poses, 0.0, 0.0))
    assert without_repeats(whole) == (whole, 1)


def test_a_clock_that_never_ran_gives_way_to_the_times_of_recording():
    still, log, findings = np.array([5, 5, 5]), np.array([1, 2, 3]), []
    assert running("/odom", still, log, findings) is log
    assert running("/odom", log, still, findings) is log
    np.testing.assert_array_equal(running("/odom", still, np.array([7, 7, 7]), findings), still)
    assert [str(finding) for finding in findings] == [
        "/odom: all 3 stamps are 5e-09 s; the recording times are used instead",
        "/odom: all 3 stamps are 5e-09 s; and so are the recording times",
    ]


def said_of(stamps, remedy=""):
    return [str(f) for f in check_order("/a", stamps, np.arange(len(stamps)) * 7, remedy)]


def test_stamps_that_go_back_or_repeat_are_counted():
    back = "/a: stamps go back 2 times, by up to 2.500 s; sorted"
    assert said_of([0, 2 * S, S, 3 * S, S // 2], "sorted")[0] == back
    assert said_of([0, S, S, 2 * S, 2 * S]) == ["/a: 2 messages with the stamp of the one before"]
    assert said_of([5, 5, 5]) == said_of([1, 2, 3]) == said_of([]) == []
    (found,) = check_order("/a", [0, 2, 1, 3], np.array([10, 20, 30, 40]))
    assert (found.count, found.first_ns) == (1, 30)


def test_a_gap_is_five_usual_steps_and_three_tenths_of_a_second():
    for usual, longest, gaps in (
        (10**8, 5 * 10**8, 1),
        (10**8, 5 * 10**8 - 1, 0),
        (10**7, 3 * 10**8, 1),
        (10**7, 299_999_999, 0),
    ):
        times = np.cumsum([0, *[usual] * 6, longest, usual])
        said = f"/a: 1 gap, the longest {longest * 1e-9:.2f} s (usually {usual * 1e-9:.3f} s)"
        assert said_of(times) == [said] * gaps
        assert said_of(times[::-1])[1:] == [said] * gaps
    assert said_of([0, 1, 10 * S]) == []
    many = np.cumsum([0, *[10**8] * 9, S, S, 2 * S])
    assert "3 gaps, the longest 2.00 s" in said_of(many)[0]
    (found,) = check_order("/a", many, many + 5)
    assert (found.count, found.first_ns) == (3, 9 * 10**8 + 5)


def test_odometry_is_looked_up_at_the_scans_stamps_or_their_times_of_recording():
    stamps = np.arange(11) * S // 2 + 100 * S
    poses = Trajectory(stamps, SE2.from_array(straight(stamps)))
    by_log = Trajectory(stamps + 900 * S, SE2.from_array(straight(stamps)))
    both = OdometrySource("base", "/odom", poses, by_log)
    at, findings = np.array([101, 102]) * S, []
    np.testing.assert_allclose(odometry_at(both, "/scan", at, at, findings).x, [101.0, 102.0])
    assert findings == []
    for late, other in (
        (0, False),
        (5 * S + S, False),
        (6 * S + 1, True),
        (-2 * S, False),
        (-3 * S - 1, True),
    ):
        findings = []
        scans = np.array([100, 102]) * S + late
        found = odometry_at(both, "/scan", scans, np.array([1001, 1002]) * S, findings)
        assert any(finding.kind == "mixed clocks" for finding in findings) == other
        if other:
            np.testing.assert_allclose(found.x, [101.0, 102.0])
    findings = []
    assert odometry_at(OdometrySource("base", "/odom", poses), "/scan", at + 60 * S, at, findings) is None
    assert [str(finding) for finding in findings] == [
        "/scan: its stamps are 61.0 s off those of the odometry (different clocks); odometry not used"
    ]
    assert odometry_at(OdometrySource("base"), "/scan", at, at, []) is None
    for off, outside in ((S // 10, 0), (S // 10 + 1, 1)):
        findings = []
        odometry_at(
            both, "/scan", np.array([100 * S - off, 102 * S, 105 * S + S // 10]), np.arange(3), findings
        )
        what = "/scan: 1 scan lies outside the odometry's time; its nearest pose is used"
        assert [str(finding) for finding in findings] == [what] * outside


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


@pytest.mark.parametrize("loop", [False, True])
def test_a_tree_of_many_frames_is_gone_through_in_a_moment(loop):
    """Frame by frame and link by link, a hostile bag took minutes."""
    tree, n, no_turn = FrameTree(), 5_000, (0.0, 0.0, 0.0, 1.0)
    for k in range(n):
        tree.add(RawTransform(0, f"a{k}", f"a{k + 1}", (1.0, 0.0, 0.0), no_turn), static=True)
        tree.add(RawTransform(0, "a0", f"b{k}", (0.0, 0.0, 0.0), no_turn), static=True)
    if loop:
        tree.add(RawTransform(0, f"a{n}", "a0", (0.0, 0.0, 0.0), no_turn), static=True)
    begin = time.process_time()
    np.testing.assert_allclose(tree.lookup("a0", f"a{n}")[0, 3], n)
    assert tree.lookup("a0", "nowhere") is None
    said = [str(finding) for finding in tree.findings()]
    assert time.process_time() - begin < 5.0
    assert len(said) == loop
    if loop:
        assert said[0].startswith("the transforms form a loop: a0 -> a1 -> a2 -> a3 ")
        assert "-> a8 -> 4989 more -> a4998 -> a4999 -> a5000 -> a0; the way down" in said[0]


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
    assert [str(finding) for finding in turned.findings()] == [
        "the transform base -> far is implausibly far away; left out",
        "the transform base -> none is implausibly far away; left out",
    ]
    assert turned.frames() == {"base", "arm"}


def test_a_sensor_is_looked_for_from_the_odometrys_base_and_then_from_the_usual_ones():
    tree = FrameTree()
    tree.add(link("base_link", "laser", (0.3, 0.0, 0.2)), static=True)
    assert tree.base() == "base_link"
    assert FrameTree().base() == "base_footprint"
    np.testing.assert_array_equal(sensor_pose(tree, "laser", "laser"), np.eye(4))
    np.testing.assert_array_equal(sensor_pose(tree, "robot", "laser")[:3, 3], [0.3, 0.0, 0.2])
    assert sensor_pose(tree, "robot", "camera") is None
    tree.add(link("base_footprint", "base_link", (0.0, 0.0, 0.1)), static=True)
    assert tree.base() == "base_footprint"


def test_a_sensor_may_sit_as_far_from_its_robot_as_any_is_large(tmp_path):
    messages = [("/tf_static", TF, 0, tf(transform(0, "base_link", "base_scan", (30.0, 0, 0), (0, 0, 0, 1))))]
    messages += [("/scan", SCAN, k * S, laser_scan(k * S, np.ones(9))) for k in range(2)]
    assert load_recording(write_foreign(tmp_path / "bag", messages)).T_base_lidar.x == 30.0


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
        return Contents(open_bag(write_foreign(tmp_path / name, messages)))

    several = "several odometry topics and no /odom: /a, /b; /tf is used"
    by_tf, none = (
        "odometry from /tf (odom -> base_footprint)",
        "neither an Odometry topic nor odom -> base in /tf; the scans alone are used",
    )
    for name, topics, moving, notes, step in (
        ("a", ["/x"], True, [], 1.0),
        ("b", ["/odom", "/x"], True, [], 1.0),
        ("c", ["/a", "/b"], True, [several, by_tf], 2.0),
        ("d", [], True, [by_tf], 2.0),
        ("e", [], False, [none], None),
    ):
        findings = []
        found = find_odometry(bag(name, *topics, moving=moving), "base_scan", findings)
        assert (found.base, [str(finding) for finding in findings]) == ("base_footprint", notes)
        if step is None:
            assert found.poses is None
        else:
            np.testing.assert_allclose(found.poses.poses.x, step * np.arange(4))
