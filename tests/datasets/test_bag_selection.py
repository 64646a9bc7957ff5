"""What `bag convert` copies: a stretch of time, without some topics and some transforms."""

import math
import re

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from tests.helpers.foreign_bags import SCAN, TF, laser_scan, tf, transform, write_foreign
from tests.helpers.ros1_bags import to_ros1_bag
from turtlebag.datasets.bags.convert import to_mcap, to_sqlite3
from turtlebag.datasets.bags.copying import into_mcap
from turtlebag.datasets.bags.folder import BagFolder
from turtlebag.datasets.bags.reader import bag_info
from turtlebag.datasets.bags.selection import Selection
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.recordings import load_recording
from turtlebag.pipeline.cli.main import main

S = 10**9
BEGINNING = 1_700_000_000 * S
STILL = (0.0, 0.0, 0.0, 1.0)


def contents(path):
    return sorted((m.topic.name, m.log_time_ns, m.topic.msgtype, m.data) for m in open_bag(path).messages())


def copied(path, out, **selection):
    to_mcap(path, out, Selection(**selection))
    return contents(out)


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """11 s: a scan and a /tf of two transforms each second, and one /tf_static at the beginning."""
    laser = transform(BEGINNING, "base_footprint", "base_scan", (0.3, 0.0, 0.2), STILL)
    camera = transform(BEGINNING, "base_footprint", "/camera", (0.1, 0.0, 0.4), STILL)
    messages = [("/tf_static", TF, BEGINNING, tf(laser, camera))]
    for k in range(12):
        time = BEGINNING + k * S
        base = transform(time, "odom", "base_footprint", (0.1 * k, 0.0, 0.0), STILL)
        odom = transform(time, "map", "odom", (5.0, 0.0, 0.0), STILL)
        messages += [
            ("/tf", TF, time, tf(base)),
            ("/tf", TF, time, tf(odom)),
            ("/scan", SCAN, time, laser_scan(time, np.full(360, 1.0 + 0.1 * k))),
        ]
    return write_foreign(tmp_path_factory.mktemp("bag") / "bag", messages)


def links(path):
    with AnyReader([path]) as reader:
        read = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages() if c.msgtype == TF]
    return [(link.header.frame_id, link.child_frame_id) for message in read for link in message.transforms]


def test_everything_is_copied_byte_by_byte_where_nothing_is_selected(bag, tmp_path):
    assert copied(bag, tmp_path / "copy") == contents(bag)


def test_topics_are_left_out(bag, tmp_path):
    expected = [message for message in contents(bag) if message[0] != "/tf"]
    assert copied(bag, tmp_path / "copy", exclude=("/tf",)) == expected


@pytest.mark.parametrize(
    ("start_s", "end_s", "seconds"),
    [(0.0, 3.0, range(4)), (2.0, 5.0, range(2, 6)), (2.1, 4.9, range(3, 5)), (9.0, math.inf, range(9, 12))],
)
@pytest.mark.parametrize("convert", [to_mcap, to_sqlite3])
def test_a_stretch_of_time_counts_from_the_beginning_and_keeps_what_is_latched(
    bag, tmp_path, convert, start_s, end_s, seconds
):
    convert(bag, tmp_path / "part", Selection(start_s=start_s, end_s=end_s))
    found = contents(tmp_path / "part")
    assert [(time - BEGINNING) // S for topic, time, _, _ in found if topic == "/scan"] == list(seconds)
    (static,) = (message for message in found if message[0] == "/tf_static")
    assert static[1] == BEGINNING + round(start_s * S)
    part, whole = load_recording(tmp_path / "part"), load_recording(bag)
    np.testing.assert_array_equal(part.ranges, whole.ranges[seconds.start : seconds.stop])
    np.testing.assert_array_equal(part.T_base_lidar.xyt, whole.T_base_lidar.xyt)
    np.testing.assert_allclose(part.T_odom_base.xyt, whole.T_odom_base[seconds.start : seconds.stop].xyt)
    assert open_bag(tmp_path / "part").notes == []


def test_two_parts_of_a_bag_share_no_message_but_the_latched_ones(bag, tmp_path):
    first = copied(bag, tmp_path / "a", end_s=4.5)
    second = copied(bag, tmp_path / "b", start_s=4.5)
    assert sorted(
        message for message in first + second if message[1] != BEGINNING + 4 * S + S // 2
    ) == contents(bag)


@pytest.mark.parametrize(
    ("frames", "left"),
    [
        (("camera",), {("base_footprint", "base_scan"), ("odom", "base_footprint"), ("map", "odom")}),
        (
            ("odom",),
            {("base_footprint", "base_scan"), ("base_footprint", "/camera"), ("odom", "base_footprint")},
        ),
        (("base_scan", "camera"), {("odom", "base_footprint"), ("map", "odom")}),
    ],
)
def test_transforms_to_a_frame_are_dropped_and_all_else_keeps_its_bytes(bag, tmp_path, frames, left):
    found = copied(bag, tmp_path / "copy", exclude_frames=frames)
    assert set(links(tmp_path / "copy")) == left
    others = [message for message in contents(bag) if not message[0].startswith("/tf")]
    assert [message for message in found if not message[0].startswith("/tf")] == others
    moving = {message for message in found if message[0] == "/tf"}
    assert moving <= set(contents(bag))
    assert len(moving) == (12 if "odom" in frames else 24)
    topics = [topic.name for topic in bag_info(tmp_path / "copy").topics]
    assert ("/tf_static" in topics) == (frames != ("base_scan", "camera"))


def test_damaged_transforms_are_left_out_and_said_to_be(bag, tmp_path):
    with BagFolder(tmp_path / "bad", custom={}) as out:
        copier = into_mcap(out)
        for k, message in enumerate(open_bag(bag).messages()):
            copier.write(message._replace(data=message.data[:30]) if k == 4 else message)
    count, notes = to_mcap(tmp_path / "bad", tmp_path / "copy", Selection(exclude_frames=("camera",)))
    assert notes == ["/tf: 1 message cannot be decoded; left out"]
    assert count == len(contents(bag)) - 1


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--from", "5", "--to", "3"], r"--to 3: must be later than --from 5"),
        (["--to", "0"], r"--to 0: must be later than --from 0"),
        (["--from", "-1"], r"--from: must be a number of seconds, 0 or more, not -1"),
        (["--from", "nan"], r"--from: must be a number of seconds, 0 or more, not nan"),
        (["--to", "1e999"], r"--to: must be a number of seconds, 0 or more, not 1e999"),
        (["--to", "soon"], r"--to: must be a number of seconds, 0 or more, not soon"),
        (["--from", "12"], r"--from 12: .*bag has no messages in this interval; it is 11.00 s long"),
        (["--from", "1e308"], r"--from 1e\+308: .* it is 11.00 s long"),
        (["--from", "4.2", "--to", "4.7"], r"--from 4.2 --to 4.7: .*bag has no messages in this interval"),
        (
            ["--exclude", "/tf_statik"],
            r"--exclude /tf_statik: no such topic; .*bag has /scan, /tf, /tf_static",
        ),
        (
            ["--exclude-frame", "laser"],
            r"--exclude-frame laser: no such child frame; .* has base_footprint, base_scan",
        ),
    ],
)
def test_a_bad_value_is_one_line_and_nothing_is_written(bag, tmp_path, capsys, options, says):
    assert main(["bag", "convert", str(bag), *options, "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert re.search(says, said)
    assert not any(tmp_path.iterdir())


def test_the_command_cuts_and_drops(bag, tmp_path):
    options = ["--from", "2", "--to", "6", "--exclude-frame", "/camera", "--exclude-frame", "odom"]
    assert main(["bag", "convert", str(bag), *options, "--out", str(tmp_path / "part")]) == 0
    assert set(links(tmp_path / "part" / "bag")) == {
        ("base_footprint", "base_scan"),
        ("odom", "base_footprint"),
    }
    assert len(load_recording(tmp_path / "part")) == 5


def test_a_carmen_log_is_converted_whole(tmp_path, capsys):
    line = "FLASER 180 " + "1.00 " * 180 + "0 0 0 0 0 0 {}.5 nohost 0\n"
    (tmp_path / "a.log").write_text("".join(line.format(k) for k in range(4)))
    for option in (["--from", "1"], ["--to", "2"], ["--exclude-frame", "x"], ["--exclude", "/odom"]):
        assert main(["bag", "convert", str(tmp_path / "a.log"), *option, "--out", str(tmp_path / "out")]) == 2
        assert f"{option[0]}: a CARMEN log is converted whole" in capsys.readouterr().err
    with pytest.raises(InputError, match="no such file"):
        open_bag(tmp_path / "out")


def test_a_ros1_bag_is_cut_and_loses_transforms_as_well(bag, tmp_path):
    to_ros1_bag(bag, tmp_path / "a.bag")
    selection = {"exclude_frames": ("camera", "odom"), "start_s": 2.0, "end_s": 6.0}
    assert copied(tmp_path / "a.bag", tmp_path / "of_ros1", **selection) == copied(
        bag, tmp_path / "b", **selection
    )
    assert set(links(tmp_path / "of_ros1")) == {
        ("base_footprint", "base_scan"),
        ("odom", "base_footprint"),
    }
