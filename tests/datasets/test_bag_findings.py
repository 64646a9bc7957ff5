"""`bag doctor` and mapping say the same of a bag, for they read the same findings."""

import math
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from tests.helpers.foreign_bags import (
    CLOUD,
    ODOMETRY,
    SCAN,
    STORE,
    TF,
    TYPES,
    header,
    laser_scan,
    odometry,
    tf,
    transform,
    write_foreign,
)
from turtlebag.datasets.bags import cdr
from turtlebag.datasets.bags.doctor import examine
from turtlebag.datasets.bags.topics import IMU
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.findings import KINDS, Finding
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.types import Imu
from turtlebag.pipeline.cli.main import main

STEP = 100_000_000
STILL = (0.0, 0.0, 0.0, 1.0)
RANGES = np.linspace(1.0, 3.0, 360)
LASER = transform(0, "base_footprint", "base_scan", (0.3, 0.0, 0.2), STILL)
DAMAGED = b"\0\1\0\0\xff\xff\xff\xff"


def static(*links):
    return [("/tf_static", TF, 0, tf(*links))]


def scan(k, topic="/scan", frame="base_scan", **changes):
    return topic, SCAN, k * STEP, laser_scan(k * STEP, RANGES, frame, **changes)


def odom(k, topic="/odom", step=0.02, **frames):
    return topic, ODOMETRY, k * STEP, odometry(k * STEP, step * k, **frames)


def drive(*each, before=None, steps=40):
    """A drive of 4 s with what `each` gives at every step."""
    messages = [*(static(LASER) if before is None else before)]
    for k in range(steps):
        messages += [make(k) for make in (each or (odom, scan))]
    return [message for message in messages if message is not None]


def written(folder, messages):
    """A bag of messages, those of bytes as they are; a topic has a connection for each of its types."""
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {}
        for topic, kind, time, message in messages:
            if (topic, kind) not in connections:
                connections[topic, kind] = writer.add_connection(topic, kind, typestore=STORE)
            data = message if isinstance(message, bytes) else bytes(STORE.serialize_cdr(message, kind))
            writer.write(connections[topic, kind], time, data)
    return folder


def empty_cloud(k):
    cloud = TYPES[CLOUD](header(k * STEP, "base_scan"), 1, 0, [], False, 0, 0, np.zeros(0, np.uint8), True)
    return "/scan", CLOUD, k * STEP, cloud


def moved(k, child="base_footprint", parent="odom", step=0.02, quaternion=STILL):
    return "/tf", TF, k * STEP, tf(transform(k * STEP, parent, child, (step * k, 0.0, 0.0), quaternion))


def unfilled(k):
    topic, kind, time, message = odom(k, step=0.0)
    message.twist.twist.linear.x = 0.2
    return topic, kind, time, message


def imu(k):
    stamp = k * STEP + (k > 20) * 9 * STEP
    layout = cdr.imu("imu_link", np.zeros(9), np.zeros(9))
    (data,) = layout.messages([layout.row(Imu(stamp, np.zeros(3), np.zeros(3)))])
    return "/imu", IMU, stamp, data


LOOP = [
    transform(0, "base_footprint", "base_link", (0.0, 0.0, 0.1), STILL),
    transform(0, "base_link", "base_scan", (0.3, 0.0, 0.1), STILL),
    transform(0, "base_scan", "base_footprint", (0.0, 0.0, 0.0), STILL),
]
TURNED_BACK = transform(0, "base_footprint", "base_scan", (0.3, 0.0, 0.2), (0.0, 0.0, 0.0, 0.0))
LONG = transform(0, "base_footprint", "base_scan", (0.3, 0.0, 0.2), (0.0, 0.0, 0.0, 2.0))

CASES = {
    "an empty /tf_static": (
        drive(before=static()),
        {("no static transforms", "/scan: no fixed transform base_footprint -> base_scan")},
        {"x": 0.0},
    ),
    "a topic of two types": (
        drive(odom, scan, empty_cloud),
        {("two types", f"/scan: messages of 2 types: {SCAN}, {CLOUD}")},
        {},
    ),
    "an angle increment of 0": (
        drive(odom, lambda k: scan(k, angle_increment=0.0)),
        {("beam angles", "/scan: angle_increment is 0")},
        {},
    ),
    "a zero quaternion": (
        drive(before=static(TURNED_BACK)),
        {
            ("bad quaternions", "/tf_static: 1 quaternion is zero or not finite"),
            ("no static transforms", "/scan: no fixed transform"),
        },
        {"x": 0.0},
    ),
    "a quaternion that is too long": (
        drive(before=static(LONG)),
        {("bad quaternions", "/tf_static: 1 quaternion is not normalised")},
        {},
    ),
    "odometry with zero quaternions": (
        drive(lambda k: moved(k, quaternion=(0.0, 0.0, 0.0, 0.0)), scan),
        {
            ("bad quaternions", "/tf: 40 quaternions are zero or not finite"),
            ("no odometry", "neither an Odometry topic"),
        },
        {"odometry": False},
    ),
    "damaged scans": (
        [*drive(), *[("/scan", SCAN, k * STEP, DAMAGED) for k in (50, 51)]],
        {("damaged messages", "/scan: 2 of 42 messages cannot be decoded")},
        {},
    ),
    "a loop in the transforms": (
        drive(before=static(*LOOP)),
        {
            (
                "transform loop",
                "the transforms form a loop: base_footprint -> base_link -> base_scan -> base_footprint",
            )
        },
        {},
    ),
    "two parents": (
        drive(before=static(LASER, transform(0, "map", "base_scan", (1.0, 0.0, 0.0), STILL))),
        {("two parents", "frame 'base_scan' has several parents: base_footprint, map")},
        {},
    ),
    "a pose that is not filled in": (
        drive(unfilled, scan),
        {("pose not filled in", "/odom: the pose never changes but the twist does")},
        {},
    ),
    "an IMU that pauses": (
        drive(odom, scan, imu),
        {("gaps", "/imu: 1 gap, the longest 1.00 s (usually 0.100 s)")},
        {},
    ),
    "gaps, repeats and steps back": (
        drive(lambda k: odom(k + (k > 20) * 9 - (k == 12)), lambda k: scan(k if k != 9 else 5)),
        {
            ("gaps", "/odom: 1 gap, the longest 1.00 s (usually 0.100 s)"),
            ("repeated stamps", "/odom: 1 message with the stamp of the one before"),
            ("time goes backwards", "/scan: stamps go back 1 time, by up to 0.300 s"),
        },
        {},
    ),
}


def no_notes(findings):
    return {finding for finding in findings if finding.severity != "note"}


@pytest.mark.parametrize("case", CASES)
def test_doctor_and_map_say_the_same(tmp_path, case):
    messages, expected, of_map = CASES[case]
    bag = written(tmp_path / "bag", messages)
    recording, findings = load_recording(bag), examine(bag)
    assert no_notes(recording.findings) == no_notes(findings)
    said = {(finding.kind, finding.what) for finding in no_notes(findings)}
    assert len(said) == len(expected)
    for kind, what in expected:
        assert any(kind == found and text.startswith(what) for found, text in said), said
    assert recording.notes == tuple(map(str, recording.findings))
    assert recording.T_base_lidar.x == pytest.approx(of_map.get("x", 0.3))
    assert (recording.T_odom_base is not None) == of_map.get("odometry", True)


def test_a_loop_leads_down_from_the_base_whatever_the_order_of_its_links(tmp_path):
    for turn in range(3):
        links = LOOP[turn:] + LOOP[:turn]
        recording = load_recording(written(tmp_path / f"bag{turn}", drive(before=static(*links))))
        assert recording.T_base_lidar.xyt.tolist() == pytest.approx([0.3, 0.0, 0.0])
        assert any("form a loop" in note for note in recording.notes)


@pytest.mark.parametrize("by_tf", [False, True], ids=["odometry topics", "transforms alone"])
def test_each_of_two_robots_is_judged_by_its_own_base(tmp_path, by_tf):
    robots = (("left", 0.02, 0.3), ("right", -0.05, -0.2))
    messages = static(
        *[transform(0, f"{r}/base_footprint", f"{r}/base_scan", (x, 0.0, 0.2), STILL) for r, _, x in robots]
    )
    for k in range(40):
        for robot, step, _ in robots:
            messages.append(moved(k, f"{robot}/base_footprint", f"{robot}/odom", step))
            if not by_tf:
                messages.append(
                    odom(k, f"/{robot}/odom", step, frame=f"{robot}/odom", child=f"{robot}/base_footprint")
                )
            messages.append(scan(k, f"/{robot}/scan", f"{robot}/base_scan"))
    bag = write_foreign(tmp_path / "bag", messages)
    assert no_notes(examine(bag)) == set()
    for robot, step, x in robots:
        recording = load_recording(bag, topic=f"/{robot}/scan")
        assert recording.T_base_lidar.x == pytest.approx(x)
        np.testing.assert_allclose(recording.T_odom_base.x, step * np.arange(40), atol=1e-9)


def test_one_robot_without_transforms_does_not_spoil_the_other(tmp_path):
    """The doctor names the lost laser with its own base alone."""
    messages = drive(
        odom, scan, lambda k: odom(k, "/b/odom", child="b/base", frame="b/odom"),
        lambda k: scan(k, "/b/scan", "b/laser"), steps=10,
    )  # fmt: skip
    lost = [f.what for f in examine(write_foreign(tmp_path / "bag", messages)) if f.severity == "error"]
    assert len(lost) == 2
    assert "/b/odom: its child frame 'b/base' is not in /tf" in lost
    assert any(text.startswith("/b/scan: no fixed transform base_footprint -> b/laser") for text in lost)


def test_scans_that_are_all_damaged_are_no_scans_for_both(tmp_path):
    messages = [message for message in drive() if message[0] != "/scan"]
    bag = written(tmp_path / "bag", [*messages, ("/scan", SCAN, 9, DAMAGED), ("/scan", SCAN, 10, DAMAGED)])
    why = "no /scan could be read: /scan: 2 of 2 messages cannot be decoded"
    with pytest.raises(InputError, match=why):
        load_recording(bag)
    assert {(f.kind, f.severity) for f in examine(bag) if why in f.what} == {("no scans", "error")}


def test_a_finding_has_a_place_a_count_and_a_time(tmp_path):
    messages = drive(odom, lambda k: scan(k, **({} if k < 25 else {"angle_min": math.nan})))
    bag = written(tmp_path / "bag", [*messages, ("/scan", SCAN, 70 * STEP, DAMAGED)])
    found = {finding.kind: finding for finding in load_recording(bag).findings}
    assert found["damaged messages"] == Finding(
        "damaged messages", "/scan", "1 of 41 messages cannot be decoded", 1, 70 * STEP, "skipped"
    )
    assert (found["beam angles"].count, found["beam angles"].remedy) == (15, "left empty")
    assert str(found["beam angles"]) == "/scan: 15 scans without a usable geometry; left empty"


def test_the_command_prints_what_breaks_and_what_is_done_about_it(tmp_path, capsys):
    bag = written(tmp_path / "bag", CASES["damaged scans"][0])
    assert main(["bag", "doctor", str(bag)]) == 1
    assert capsys.readouterr().out.splitlines() == [
        "error: damaged messages: /scan: 2 of 42 messages cannot be decoded",
        f"    breaks: {KINDS['damaged messages'].breaks}",
        "    here: skipped",
        "    first: at 5.000 s",
        "1 error, 0 warnings",
    ]
    bag = write_foreign(tmp_path / "good", drive(moved, scan))
    assert main(["bag", "doctor", str(bag)]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "note: odometry source: odometry from /tf (odom -> base_footprint)",
        "no defect found",
    ]


def test_every_kind_is_documented():
    page = (Path(__file__).parents[2] / "docs" / "bags.md").read_text()
    assert [kind for kind in KINDS if kind not in page] == []
