"""Crashes, truncation and flipped bytes: what is read is right, losses are small and reported."""

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from mcap.exceptions import McapError
from mcap.reader import make_reader

from tests.helpers.ros1_bags import to_ros1_bag
from turtlebag.datasets.bags.convert import to_sqlite3
from turtlebag.datasets.bags.reader import bag_info
from turtlebag.datasets.bags.recover import recover
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.recordings import load_recording

ROOT = Path(__file__).parents[2]
DAMAGES = int(os.environ.get("TURTLEBAG_DAMAGES", "10"))
"""Cuts and flips of each kind of file, and three kills for ten of them: `make bench-bags` makes 500."""
CHILD = """
import mmap, sys, time
sys.path.insert(0, sys.argv[1])
from pathlib import Path
from tests.helpers.bag_samples import LINKS, observation, pose, stamp
from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.types import Twist
file = open(sys.argv[3], "r+b")
progress = mmap.mmap(file.fileno(), 8)
samples = [observation(step) for step in range(1, 301)]
with BagWriter(Path(sys.argv[2]), custom={}) as writer:
    writer.static_transforms(0, LINKS)
    for sample in samples:
        writer.observation(sample)
        progress[:] = sample.stamp_ns.to_bytes(8, "little")
        time.sleep(0.001)
    time.sleep(60)
"""


def messages_of(path):
    return [(m.topic.name, m.log_time_ns, m.data) for m in open_bag(path).messages()]


def refusal(check, *given):
    """The one line with which a damaged file is refused; empty when it is read."""
    said = ""
    try:
        check(*given)
    except InputError as error:
        said = str(error)
    assert "\n" not in said
    return said


def read_up_to_the_damage(path, whole, *, checksums=True):
    """Without checksums a cut that takes no message may go unnoticed: of a database, within the last page."""
    bag = open_bag(path)
    found = [(m.topic.name, m.log_time_ns, m.data) for m in bag.messages()]
    assert found == whole[: len(found)]
    assert bag.notes or (found == whole and not checksums)


def scanned_up_to_the_damage(path, ranges):
    recording = load_recording(path)
    np.testing.assert_array_equal(recording.ranges, ranges[: len(recording)])
    assert recording.notes


def recovered_in_order(path, folder, whole):
    """All that is recovered was written, in this order."""
    recover(path, folder)
    rest = iter(whole)
    assert all(any(message == other for other in rest) for message in messages_of(folder))


def read_as_it_is(path):
    """Without checksums nothing else can be promised than data, or one error."""
    messages_of(path)
    load_recording(path)


def cuts(content, rng):
    return [content[:size] for size in rng.integers(1, len(content), DAMAGES)]


def flips(content, rng):
    places = zip(rng.integers(0, len(content), DAMAGES), rng.integers(1, 256, DAMAGES), strict=True)
    return [content[:k] + bytes([content[k] ^ int(bits)]) + content[k + 1 :] for k, bits in places]


@pytest.mark.slow
@pytest.mark.parametrize("after_s", np.linspace(0.02, 0.3, 3 * DAMAGES // 10))
def test_a_kill_loses_less_than_two_seconds_and_leaves_nothing_that_looks_whole(tmp_path, after_s):
    progress, folder = tmp_path / "progress", tmp_path / "bag"
    progress.write_bytes(bytes(8))
    arguments = [sys.executable, "-c", CHILD, str(ROOT), str(folder), str(progress)]
    child = subprocess.Popen(arguments)
    while not any(progress.read_bytes()):
        assert child.poll() is None
        time.sleep(0.005)
    time.sleep(after_s)
    os.kill(child.pid, signal.SIGKILL)
    child.wait()
    written = int.from_bytes(progress.read_bytes(), "little")
    assert not (folder / "metadata.yaml").exists()
    with (folder / "bag_0.mcap").open("rb") as file, pytest.raises(McapError):
        make_reader(file).get_summary()
    if written > 2_000_000_000:
        saved = recover(folder, tmp_path / "saved")
        assert written - saved.end_ns < 2_000_000_000
        assert load_recording(folder).notes[0].startswith("metadata.yaml is missing")
        expected = messages_of(folder)
        assert messages_of(tmp_path / "saved") == expected


@pytest.mark.slow
@pytest.mark.parametrize("damage", [cuts, flips])
def test_a_damaged_bag_never_gives_wrong_data_or_silence(drive, tmp_path, damage):
    content, whole = (drive / "bag_0.mcap").read_bytes(), messages_of(drive)
    ranges, path, saved = load_recording(drive).ranges, tmp_path / "damaged.mcap", 0
    for k, damaged in enumerate(damage(content, np.random.default_rng(0))):
        path.write_bytes(damaged)
        refusal(read_up_to_the_damage, path, whole)
        refusal(scanned_up_to_the_damage, path, ranges)
        saved += not refusal(recovered_in_order, path, tmp_path / str(k), whole)
    assert saved == DAMAGES or damage is cuts


@pytest.mark.slow
@pytest.mark.parametrize(("convert", "name"), [(to_ros1_bag, "a.bag"), (to_sqlite3, "a")])
def test_bags_without_checksums_end_in_data_or_one_error(drive, tmp_path, convert, name):
    convert(drive, tmp_path / name)
    (file,) = [path for path in tmp_path.rglob("*") if path.suffix in (".bag", ".db3")]
    content, whole, path = file.read_bytes(), messages_of(file), tmp_path / f"damaged{file.suffix}"
    for damaged in cuts(content, np.random.default_rng(0)):
        path.write_bytes(damaged)
        refusal(partial(read_up_to_the_damage, checksums=False), path, whole)
    for damaged in flips(content, np.random.default_rng(0)):
        path.write_bytes(damaged)
        refusal(read_as_it_is, path)


def test_recovery_steps_over_a_damaged_chunk(drive, tmp_path):
    content = bytearray((drive / "bag_0.mcap").read_bytes())
    content[len(content) // 2] ^= 0xFF
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    whole, before = messages_of(drive), messages_of(path)
    saved = recover(path, tmp_path / "saved")
    times = np.array([time for _, time, _ in messages_of(tmp_path / "saved")])
    assert len(before) < len(times) < len(whole)
    assert times[-1] == whole[-1][1]
    assert np.diff(times).max() < 2_000_000_000
    assert any("damaged at byte" in note for note in saved.notes)


def test_a_damaged_first_chunk_costs_only_itself(drive, tmp_path):
    content = bytearray((drive / "bag_0.mcap").read_bytes())
    content[2000] ^= 1
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    assert recover(path, tmp_path / "saved").messages > 0.7 * len(messages_of(drive))


def test_recovery_keeps_what_was_noted_of_the_recording(drive, tmp_path):
    content = (drive / "bag_0.mcap").read_bytes()
    (tmp_path / "a.mcap").write_bytes(content[: len(content) // 2])
    recover(tmp_path / "a.mcap", tmp_path / "saved")
    assert open_bag(tmp_path / "saved").custom_data() == {"seed": "7", "recovered": "true"}


def test_the_warning_says_where_and_what_to_do(drive, tmp_path):
    content = (drive / "bag_0.mcap").read_bytes()
    (tmp_path / "a.mcap").write_bytes(content[: len(content) // 2])
    bag = open_bag(tmp_path / "a.mcap")
    assert sum(1 for _ in bag.messages()) > 0
    assert "a.mcap: " in bag.notes[0]
    assert "byte" in bag.notes[0]
    assert "bag recover" in bag.notes[0]


@pytest.mark.parametrize("missing", [1, 512, 4095])
def test_a_sqlite3_bag_cut_in_its_last_page_is_noted(drive, tmp_path, missing):
    to_sqlite3(drive, tmp_path / "a")
    (file,) = (tmp_path / "a").glob("*.db3")
    assert bag_info(tmp_path / "a").notes == ()
    os.truncate(file, file.stat().st_size - missing)
    (note,) = bag_info(tmp_path / "a").notes
    assert "cut off inside its last page" in note
