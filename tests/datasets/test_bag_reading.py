"""Contents and mapping input of a bag, at the limits."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.helpers.foreign_bags import (
    ARRAY,
    LASER,
    ODOMETRY,
    SCAN,
    STORE,
    TF,
    TWIST,
    S,
    laser_scan,
    odometry,
    tf,
    transform,
    write_foreign,
)
from turtlebag.datasets.bags import cdr
from turtlebag.datasets.bags.mapping_input import read_for_mapping
from turtlebag.datasets.bags.reader import (
    BagInfo,
    TopicInfo,
    bag_info,
    read_commands,
    read_particles,
    read_poses,
)
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.se2 import SE2


def test_a_bag_is_told_topic_by_topic(tmp_path):
    messages = [("/b", SCAN, t * S, laser_scan(t * S, np.ones(5))) for t in (5, 2, 9, 3)]
    messages += [("/a", ODOMETRY, 7 * S, odometry(7 * S, 1.0))]
    info = bag_info(write_foreign(tmp_path / "bag", messages))
    assert [(t.name, t.count, t.start_ns, t.end_ns, t.longest_gap_ns) for t in info.topics] == [
        ("/a", 1, 7 * S, 7 * S, 0),
        ("/b", 4, 2 * S, 9 * S, 4 * S),
    ]
    assert [t.rate_hz() for t in info.topics] == [0.0, pytest.approx(3 / 7)]
    assert (info.count, info.start_ns, info.end_ns, info.duration()) == (5, 2 * S, 9 * S, pytest.approx(7.0))
    assert TopicInfo("/x", "y", 3, 5, 5, 0).rate_hz() == 0.0
    nothing = BagInfo(tmp_path, "mcap", (), (), ())
    assert (nothing.count, nothing.start_ns, nothing.end_ns, nothing.duration()) == (0, 0, 0, 0.0)


def test_single_streams_are_read_and_missing_ones_named(tmp_path):
    def twist(v, w):
        (data,) = cdr.twist().messages([(v, w)])
        return STORE.deserialize_cdr(data, TWIST)

    cloud = SE2(np.array([[1.0, 2.0, 0.5], [3.0, 4.0, -0.5]]))
    array = STORE.deserialize_cdr(cdr.pose_array("map", 9 * S, cloud), ARRAY)
    messages = [("/odom", ODOMETRY, k * S, odometry((5 - k) * S, 0.5 * k)) for k in (1, 2, 3)]
    messages += [("/cmd_vel", TWIST, k * S, twist(0.1 * k, -0.2 * k)) for k in (1, 2)]
    path = write_foreign(tmp_path / "bag", [*messages, ("/particlecloud", ARRAY, 8 * S, array)])
    poses = read_poses(path, "/odom")
    assert poses.stamps_ns.tolist() == [4 * S, 3 * S, 2 * S]
    np.testing.assert_allclose(poses.poses.x, [0.5, 1.0, 1.5])
    times, v, w = read_commands(path)
    assert times.tolist() == [S, 2 * S]
    np.testing.assert_allclose([v, w], [[0.1, 0.2], [-0.2, -0.4]])
    nothing = write_foreign(tmp_path / "nothing", [("/odom", ODOMETRY, S, odometry(S, 1.0))])
    assert read_particles(nothing) == []
    ((stamp, found),) = read_particles(path)
    assert stamp == 9 * S
    np.testing.assert_allclose(found.xyt, cloud.xyt)


def test_of_several_lasers_the_most_frequent_is_used(tmp_path):
    frames = ["a", "b", "a", "b", "b"]
    scans = [("/scan", SCAN, (5 + k) * S, laser_scan(k * S, np.ones(3), f)) for k, f in enumerate(frames)]
    found = read_for_mapping(open_bag(write_foreign(tmp_path / "a", scans)))
    assert found.stamps_ns.tolist() == [S, 3 * S, 4 * S]
    (mixed,) = (finding for finding in found.findings if finding.kind == "mixed frames")
    assert str(mixed) == "/scan: messages of 2 frames: 'b' (3), 'a' (2); the most frequent is used"
    assert mixed.count == 2


@pytest.mark.parametrize(
    ("roll", "tilt", "lines"), [(0.0, 0.19, 0), (0.0, 0.21, 1), (math.pi, 0.0, 1), (math.pi, 0.3, 2)]
)
def test_a_laser_is_planar_tilted_or_upside_down(tmp_path, roll, tilt, lines):
    turned = Rotation.from_euler("ZX", [0.7, roll + tilt]).as_quat()
    messages = [("/tf_static", TF, 0, tf(transform(0, "base_footprint", "base_scan", (1, 2, 3), turned)))]
    messages += [("/scan", SCAN, k * S, laser_scan(k * S, np.ones(3))) for k in range(2)]
    found = read_for_mapping(open_bag(write_foreign(tmp_path / "bag", messages)))
    np.testing.assert_allclose(found.T_base_lidar.xyt, [1.0, 2.0, 0.7], atol=1e-7)
    assert (found.lidar.angle_increment < 0.0) == (roll > 0.0)
    said = [str(finding) for finding in found.findings if finding.kind == "mounting"]
    assert len(said) == lines
    if tilt > 0.2:
        assert f"tilted by {math.degrees(tilt):.0f} degrees" in said[0]
    if roll:
        assert said[-1] == "/scan: the laser is mounted upside down; its scans were flipped"


def test_a_recording_has_its_scans_odometry_and_laser_or_a_line_that_says_why_not(tmp_path):
    def drive(*topics, static=LASER):
        messages = [("/tf_static", TF, 0, tf(transform(0, *static)))]
        for k in range(8):
            for name in topics:
                messages.append(
                    (name, SCAN, k * S + 5, laser_scan(k * S, np.full(5, 1.0 + k), time_increment=2.0**-6))
                )
            messages.append(("/odom", ODOMETRY, k * S, odometry(k * S, 0.5 * k)))
        return messages

    found = read_for_mapping(open_bag(write_foreign(tmp_path / "a", drive("/scan", "/other"))))
    assert found.stamps_ns.tolist() == [k * S for k in range(8)]
    np.testing.assert_allclose(found.T_odom_base.x, 0.5 * np.arange(8))
    np.testing.assert_allclose(found.T_base_lidar.xyt, [0.3, 0.0, 0.0])
    assert found.ranges[3].tolist() == [np.inf] * 5
    bag = write_foreign(tmp_path / "b", drive("/left", "/right"))
    told = read_for_mapping(open_bag(bag), topic="/left", T_base_lidar=SE2.from_xyt(9.0, 0.0, 0.0))
    assert float(told.T_base_lidar.x) == 9.0
    assert len(read_for_mapping(open_bag(write_foreign(tmp_path / "c", drive("/front/scan", "/x"))))) == 8
    over = (*LASER[:3], (1, 0, 0, 0))
    turned = read_for_mapping(open_bag(write_foreign(tmp_path / "d", drive("/scan", static=over))))
    # the beams go round the other way; each keeps its time, and the scan its stamp
    assert turned.stamps_ns.tolist() == [k * S for k in range(8)]
    assert turned.lidar.time_increment == 2.0**-6
    np.testing.assert_allclose(turned.lidar.angles, -found.lidar.angles)
