"""Bags with several scan topics: which are lidars of the robot, and their scans as one recording."""

import math

import numpy as np
import pytest

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
from tests.helpers.slam_rooms import around_the_room
from tests.helpers.two_lidars import REAR, WIDE, two_lidars
from turtlebag.datasets.bags.doctor import examine
from turtlebag.datasets.bags.mapping_input import read_for_mapping
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2

LOG = two_lidars(around_the_room(60), front=WIDE, rear=WIDE)
FRAMES = {"/scan": "base_scan", "/scan_rear": "rear", "/scan_merged": "base_footprint"}
MERGED_BEAMS = 720


def scan_of(number, frame):
    scan = LOG.scan(number)
    geometry = {
        "angle_min": scan.lidar.angle_min,
        "angle_max": -scan.lidar.angle_min,
        "angle_increment": scan.lidar.angle_increment,
        "range_max": 8.0,
    }
    return laser_scan(scan.stamp_ns, scan.ranges, frame, **geometry)


def merged(number):
    """A scan and the one before it as common mergers lay them on one grid about the base."""
    ranges, step = np.full(MERGED_BEAMS, np.inf), 2.0 * math.pi / MERGED_BEAMS
    for one in (number - 1, number):
        scan = LOG.scan(one)
        points = LOG.lidars[scan.sensor].T_base_lidar @ scan.points_lidar()
        beams = np.floor((np.arctan2(points[:, 1], points[:, 0]) + math.pi) / step).astype(int)
        np.minimum.at(ranges, beams % MERGED_BEAMS, np.hypot(*points.T))
    geometry = {"angle_min": -math.pi, "angle_max": math.pi - step, "angle_increment": step, "range_max": 9.0}
    return laser_scan(LOG.scan(number).stamp_ns, ranges, "base_footprint", **geometry)


def bag(folder, topics=("/scan", "/scan_rear"), frames=FRAMES, late_ns=0):
    """The log as a bag; `late_ns` is how much later than they say the rear scans were taken."""
    x, y, yaw = REAR.xyt
    links = [transform(0, "base_footprint", "base_scan", (0.1, 0.0, 0.2), (0, 0, 0, 1))]
    turn = (0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw))
    links.append(transform(0, "base_footprint", "rear", (x, y, 0.2), turn))
    messages = [("/tf_static", TF, 0, tf(*links))]
    for k in range(len(LOG)):
        stamp = int(LOG.stamps_ns[k])
        name = topics[int(LOG.lidar_of[k])]
        messages.append((name, SCAN, stamp + 5 + late_ns * int(LOG.lidar_of[k]), scan_of(k, frames[name])))
        if len(topics) > 2 and LOG.lidar_of[k] == 1:
            messages.append((topics[2], SCAN, stamp + 9, merged(k)))
        messages.append(("/odom", ODOMETRY, stamp, odometry(stamp, 0.01 * k)))
    return write_foreign(folder, sorted(messages, key=lambda message: message[2]))


def read(path, **options):
    return read_for_mapping(open_bag(path), **options)


def test_scans_of_all_lidars_are_one_recording_in_the_order_of_the_file(tmp_path):
    found = read(bag(tmp_path / "bag"))
    assert [lidar.topic for lidar in found.lidars] == ["/scan", "/scan_rear"]
    np.testing.assert_array_equal(found.lidar_of, LOG.lidar_of)
    np.testing.assert_array_equal(found.stamps_ns, LOG.stamps_ns)
    np.testing.assert_allclose(found.ranges, LOG.ranges)
    np.testing.assert_allclose(found.lidars[1].T_base_lidar.xyt, REAR.xyt, atol=1e-12)
    np.testing.assert_allclose(found.T_odom_base.x, 0.01 * np.arange(len(LOG)), atol=1e-12)
    assert found.notes == ("scans of 2 lidars: /scan, /scan_rear; all are used",)


def test_the_topics_may_be_chosen_and_then_the_first_one_named_is_the_first_lidar(tmp_path):
    path = bag(tmp_path / "bag")
    alone, both = read(path, topic="/scan_rear"), read(path, topic=("/scan_rear", "/scan"))
    assert (alone.topic, alone.others, len(alone)) == ("/scan_rear", (), len(LOG) // 2)
    assert [lidar.topic for lidar in both.lidars] == ["/scan_rear", "/scan"]
    np.testing.assert_array_equal(both.lidar_of, 1 - LOG.lidar_of)
    with pytest.raises(InputError, match="--laser: is the pose of one lidar"):
        read(path, topic=("/scan_rear", "/scan"), T_base_lidar=SE2.identity())
    assert read(path, T_base_lidar=SE2.identity()).topic == "/scan"


@pytest.mark.parametrize("names", [("/scan", "/scan_rear", "/merged"), ("/front", "/rear", "/scan")])
def test_a_topic_whose_points_are_others_is_left_out_whatever_its_name(names, tmp_path):
    frames = dict(zip(names, FRAMES.values(), strict=True))
    found = read(bag(tmp_path / "bag", names, frames))
    assert sorted(lidar.topic for lidar in found.lidars) == sorted(names[:2])
    left_out = [finding for finding in found.findings if finding.kind == "scans left out"]
    assert [finding.topic for finding in left_out] == [names[2]]
    assert "its points are those of" in left_out[0].detail


@pytest.mark.parametrize(
    ("names", "frames", "late_ns", "why"),
    [
        (("/scan", "/filtered"), ("base_scan", "base_scan"), 0, "its frame 'base_scan' is that of /scan"),
        (("/scan", "/other"), ("base_scan", "nowhere"), 0, "no fixed transform"),
        (("/scan", "/other"), ("base_scan", "rear"), 100 * S, "its clock is not that of /scan"),
    ],
)
def test_scans_that_are_no_second_lidar_are_left_out_and_named(names, frames, late_ns, why, tmp_path):
    found = read(bag(tmp_path / "bag", names, dict(zip(names, frames, strict=True)), late_ns))
    assert (found.topic, found.others) == ("/scan", ())
    assert [f.topic for f in found.findings if f.kind == "scans left out" and why in f.detail] == [names[1]]


def test_two_topics_of_one_lidar_without_the_usual_name_are_a_choice_for_the_user(tmp_path):
    names = ("/raw", "/filtered")
    path = bag(tmp_path / "bag", names, dict.fromkeys(names, "base_scan"))
    with pytest.raises(InputError, match="choose one with --topic: /raw, /filtered"):
        read(path)


def test_the_doctor_says_which_topics_are_mapped_together(tmp_path):
    names = ("/scan", "/scan_rear", "/merged")
    findings = examine(bag(tmp_path / "bag", names, dict(zip(names, FRAMES.values(), strict=True))))
    texts = [str(finding) for finding in findings if finding.kind in ("several lidars", "scans left out")]
    assert len(texts) == 2
    assert any(text.startswith("scans of 2 lidars: /scan, /scan_rear") for text in texts)
