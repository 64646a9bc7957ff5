"""Each defect is found, named and explained; a good bag has none."""

import math

import numpy as np
import pytest

from tests.helpers.bag_samples import write_drive
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
from turtlebag.datasets.bags.cdr import transforms
from turtlebag.datasets.bags.doctor import examine
from turtlebag.datasets.bags.folder import BagFolder
from turtlebag.datasets.bags.topics import IMU, Publisher, definition, full_type, metadata_text
from turtlebag.datasets.types import Imu
from turtlebag.pipeline.cli.main import main

LASER = ("base_footprint", "base_scan", (0.0, 0.0, 0.2), (0, 0, 0, 1))
RANGES = np.linspace(1.0, 3.0, 360)


def drive(change=lambda k, topic, message: message, static=LASER, steps=60):
    """A good drive of 6 s at 10 Hz; `change` spoils messages, or drops them by returning None."""
    messages = []
    if static:
        messages.append(("/tf_static", TF, 0, tf(transform(0, *static))))
    for k in range(steps):
        time = k * 100_000_000
        link = transform(time, "odom", "base_footprint", (0.1 * k, 0, 0), (0, 0, 0, 1))
        for topic, msgtype, message in (
            ("/odom", ODOMETRY, odometry(time, 0.1 * k)),
            ("/tf", TF, tf(link)),
            ("/scan", SCAN, laser_scan(time, RANGES)),
        ):
            changed = change(k, topic, message)
            if changed is not None:
                messages.append((topic, msgtype, time, changed))
    return messages


def checks(tmp_path, messages):
    return {finding.kind: finding for finding in examine(write_foreign(tmp_path / "bag", messages))}


def only(topic, edit):
    """Apply `edit(k, message)` to one topic."""
    return lambda k, name, message: edit(k, message) if name == topic else message


def shifted(message, seconds):
    message.header.stamp.sec += seconds
    return message


def test_good_bags_have_no_findings(tmp_path):
    assert checks(tmp_path, drive()) == {}
    write_drive(tmp_path / "ours", seconds=5, navigation=True)
    assert examine(tmp_path / "ours") == []


def spoiled_scan(k, message, **changes):
    for name, value in changes.items():
        setattr(message, name, value)
    return message


DEFECTS = {
    "time goes backwards": (only("/scan", lambda k, m: shifted(m, -2 if k == 30 else 0)), "up to 1.900 s"),
    "repeated stamps": (only("/odom", lambda k, m: m if k != 30 else odometry(29 * 10**8, 0.0)), "/odom: 1"),
    "mixed clocks": (only("/scan", lambda k, m: shifted(m, 1_700_000_000)), "1700000000.0 s off"),
    "gaps": (only("/scan", lambda k, m: None if 20 < k < 40 else m), "the longest 2.00 s"),
    "fence-post": (
        only("/scan", lambda k, m: spoiled_scan(k, m, angle_max=2.0 * math.pi)),
        "imply 361",
    ),
    "empty scans": (
        only("/scan", lambda k, m: laser_scan(k * 10**8, np.full(360, np.nan)) if k < 5 else m),
        "5 of 60 scans are NaN only",
    ),
    "zero readings": (
        only("/scan", lambda k, m: laser_scan(k * 10**8, np.where(np.arange(360) < 90, 0.0, 1.0))),
        "25.0 %",
    ),
    "range limits": (only("/scan", lambda k, m: spoiled_scan(k, m, range_max=0.0)), "0.12..0 m"),
    "beam angles": (only("/scan", lambda k, m: spoiled_scan(k, m, angle_increment=1e-30)), "1e-30 rad apart"),
    "sweep time": (only("/scan", lambda k, m: spoiled_scan(k, m, time_increment=0.01)), "3.600 s"),
    "no scans": (only("/scan", lambda k, m: None), "no /scan (sensor_msgs/LaserScan)"),
    "bad quaternions": (
        only("/tf", lambda k, m: tf(transform(k * 10**8, "odom", "base_footprint", (0, 0, 0), (0, 0, 0, 0)))),
        "/tf: 60 quaternions are zero",
    ),
    "two parents": (
        only(
            "/tf",
            lambda k, m: tf(
                *m.transforms, transform(k * 10**8, "x", "base_footprint", (k, 0, 0), (0, 0, 0, 1))
            ),
        ),
        "odom, x",
    ),
    "truth in /tf": (
        only(
            "/tf",
            lambda k, m: tf(*m.transforms, transform(k * 10**8, "world", "odom", (k, 0, 0), (0, 0, 0, 1))),
        ),
        "odom",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("check", DEFECTS)
def test_a_defect_is_found_and_explained(tmp_path, check):
    change, says = DEFECTS[check]
    found = checks(tmp_path, drive(change))
    assert says in found[check].what
    assert found[check].breaks


def test_varying_sizes(tmp_path):
    change = only("/scan", lambda k, m: laser_scan(k * 10**8, RANGES[: 359 + k % 2]))
    assert "359..360" in checks(tmp_path, drive(change))["fence-post"].what


def test_frames(tmp_path):
    assert "no static transforms" in checks(tmp_path, drive(static=None))
    found = checks(tmp_path / "b", drive(static=("base_footprint", "laser", (0, 0, 0), (0, 0, 0, 1))))
    assert "/scan: no fixed transform base_footprint -> base_scan" in found["frames do not connect"].what


def test_no_odometry(tmp_path):
    assert "no odometry" in checks(tmp_path, drive(lambda k, t, m: m if t == "/scan" else None))


@pytest.mark.parametrize(
    ("topic", "durability", "volatile"),
    [
        ("/tf_static", "volatile", True),
        ("/tf_static", "transient_local", False),
        ("/tf", "volatile", False),
        ("/tf_static", None, False),
    ],
)
def test_a_latched_topic_recorded_as_volatile(tmp_path, topic, durability, volatile):
    with BagFolder(tmp_path / "bag", custom={}) as bag:
        text, type_hash = definition(TF)
        qos = "" if durability is None else metadata_text(Publisher(TF, durability=durability).qos())
        channel = bag.add_topic(topic, TF, text, qos=qos, type_hash=type_hash)
        bag.write(channel, 0, transforms(0, [("a", "b", (0.0, 0.0, 0.0), 0.0)]))
    found = [finding.what for finding in examine(tmp_path / "bag") if finding.kind == "quality of service"]
    assert found == [f"{topic}: was recorded as volatile"] * volatile


def imu(k, lag_s=0.0):
    stamp = k * 10**8 + round(lag_s * 1e9)
    layout = cdr.imu("imu_link", np.zeros(9), np.zeros(9))
    (data,) = layout.messages([layout.row(Imu(stamp, np.zeros(3), np.zeros(3)))])
    return "/imu", IMU, k * 10**8, STORE.deserialize_cdr(data, IMU)


@pytest.mark.parametrize(("lag_s", "other"), [(1.0, False), (1.01, True), (-1.01, True)])
def test_a_clock_is_another_when_it_is_a_second_off_the_others(tmp_path, lag_s, other):
    messages = [*drive(), *[imu(k, -lag_s) for k in range(60)]]
    found = [f.what for f in examine(write_foreign(tmp_path / "bag", messages)) if f.kind == "mixed clocks"]
    assert found == ["/imu: its stamps are 1.0 s off those of the other topics"] * other


def paused(k):
    """Steps of a drive that pauses for 2 s."""
    return k if k < 20 else k + 20


def test_gaps_are_named_of_sensors_and_of_links_that_move(tmp_path):
    messages = drive(lambda k, topic, m: None if topic == "/tf" and 20 < k < 40 else m)
    messages += [imu(paused(k)) for k in range(60)]
    for k in range(60):
        time = paused(k) * 10**8
        for link in (("map", "odom", (0.1 * k, 0, 0)), ("base_footprint", "arm", (0.0, 0.0, 0.1))):
            messages.append(("/tf", TF, time, tf(transform(time, *link, (0, 0, 0, 1)))))
    found = examine(write_foreign(tmp_path / "bag", messages))
    gaps = {f.topic for f in found if f.kind == "gaps" and "the longest 2." in f.detail}
    assert gaps == {"/imu", "/tf: odom -> base_footprint"}


def test_links_that_go_back_in_time_are_named(tmp_path):
    def back(k, message):
        time = (k - 5 if k == 30 else k) * 10**8
        return tf(transform(time, "odom", "base_footprint", (0.1 * k, 0, 0), (0, 0, 0, 1)))

    found = examine(write_foreign(tmp_path / "bag", drive(only("/tf", back))))
    (finding,) = (f for f in found if f.severity == "error")
    assert finding.what == "/tf: odom -> base_footprint: stamps go back 1 time, by up to 0.400 s"


def test_odometry_of_no_tree_is_named_but_not_the_truth(tmp_path):
    messages = drive()
    for k in range(60):
        messages.append(("/ground_truth/odom", ODOMETRY, k * 10**8, odometry(k * 10**8, 0.0, child="other")))
        messages.append(("/wheels", ODOMETRY, k * 10**8, odometry(k * 10**8, 100.0 * k, child="lost")))
    found = {(f.kind, f.what) for f in examine(write_foreign(tmp_path / "bag", messages))}
    assert found == {
        ("frames do not connect", "/wheels: its child frame 'lost' is not in /tf"),
        ("millimetres", "/wheels: the robot would be implausibly fast"),
    }


def test_transforms_in_millimetres_are_named_where_odometry_has_a_topic_too(tmp_path):
    def far(k, message):
        link = transform(k * 10**8, "odom", "base_footprint", (100.0 * k, 0, 0), (0, 0, 0, 1))
        return tf(link)

    found = examine(write_foreign(tmp_path / "bag", drive(only("/tf", far))))
    what = "/tf: odom -> base_footprint: the robot would be implausibly fast"
    assert [(f.kind, f.what) for f in found] == [("millimetres", what)]


def test_a_bag_of_clouds_alone_has_scans_enough(tmp_path):
    empty = TYPES[CLOUD](header(0, "a"), 1, 0, [], False, 0, 0, np.zeros(0, dtype=np.uint8), True)
    assert examine(write_foreign(tmp_path / "bag", [("/points", CLOUD, 0, empty)])) == []


def test_a_type_name_gets_the_middle_part_that_ros_1_leaves_out():
    assert [full_type(t) for t in ("a/B", "a/msg/B", "B")] == ["a/msg/B", "a/msg/B", "B"]


def test_unfinished_and_damaged_files(tmp_path):
    folder = tmp_path / "bag"
    write_drive(folder, seconds=5)
    (folder / "metadata.yaml").unlink()
    content = (folder / "bag_0.mcap").read_bytes()
    (folder / "bag_0.mcap").write_bytes(content[:-2000])
    assert [f.kind for f in examine(folder)] == ["missing metadata", "damaged file"]


def test_the_command_lists_what_and_why_and_fails_on_errors(tmp_path, capsys):
    write_drive(tmp_path / "good", seconds=5)
    assert main(["bag", "doctor", str(tmp_path / "good")]) == 0
    assert "no defect found" in capsys.readouterr().out
    write_foreign(tmp_path / "bad", drive(DEFECTS["mixed clocks"][0]))
    assert main(["bag", "doctor", str(tmp_path / "bad")]) == 1
    out = capsys.readouterr().out
    assert "mixed clocks" in out
    assert "use_sim_time" in out
