"""Each defect is found, named and explained; a good bag has none."""

import math

import numpy as np
import pytest

from tests.helpers.bag_samples import write_drive
from tests.helpers.foreign_bags import ODOMETRY, SCAN, TF, laser_scan, odometry, tf, transform, write_foreign
from turtlebag.datasets.bags.cdr import transforms
from turtlebag.datasets.bags.doctor import examine
from turtlebag.datasets.bags.folder import BagFolder
from turtlebag.datasets.bags.topics import TOPICS, definition, metadata_text
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
    return {finding.check: finding for finding in examine(write_foreign(tmp_path / "bag", messages))}


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
    "sweep time": (only("/scan", lambda k, m: spoiled_scan(k, m, time_increment=0.01)), "3.590 s"),
    "no scans": (only("/scan", lambda k, m: None), "no LaserScan"),
    "bad quaternions": (
        only("/tf", lambda k, m: tf(transform(k * 10**8, "odom", "base_footprint", (0, 0, 0), (0, 0, 0, 0)))),
        "/tf: 60",
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
    assert "'base_scan' is not connected to 'base_footprint'" in found["frames do not connect"].what


def test_no_odometry(tmp_path):
    assert "no odometry" in checks(tmp_path, drive(lambda k, t, m: m if t == "/scan" else None))


def test_a_latched_topic_recorded_as_volatile(tmp_path):
    with BagFolder(tmp_path / "bag", custom={}) as bag:
        text, type_hash = definition(TF)
        qos = metadata_text(TOPICS["/tf"].qos())
        channel = bag.add_topic("/tf_static", TF, text, qos=qos, type_hash=type_hash)
        bag.write(channel, 0, transforms(0, [("a", "b", (0.0, 0.0, 0.0), 0.0)]))
    assert "quality of service" in {finding.check for finding in examine(tmp_path / "bag")}


def test_unfinished_and_damaged_files(tmp_path):
    folder = tmp_path / "bag"
    write_drive(folder, seconds=5)
    (folder / "metadata.yaml").unlink()
    content = (folder / "bag_0.mcap").read_bytes()
    (folder / "bag_0.mcap").write_bytes(content[:-2000])
    assert [f.check for f in examine(folder)] == ["missing metadata", "damaged file"]


def test_the_command_lists_what_and_why_and_fails_on_errors(tmp_path, capsys):
    write_drive(tmp_path / "good", seconds=5)
    assert main(["bag", "doctor", str(tmp_path / "good")]) == 0
    assert "no defect found" in capsys.readouterr().out
    write_foreign(tmp_path / "bad", drive(DEFECTS["mixed clocks"][0]))
    assert main(["bag", "doctor", str(tmp_path / "bad")]) == 1
    out = capsys.readouterr().out
    assert "mixed clocks" in out
    assert "use_sim_time" in out
