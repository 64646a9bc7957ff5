"""Crashes, cuts and flipped bytes: what is read is right, what is lost is said, little is lost."""

import os
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from mcap.exceptions import McapError
from mcap.reader import make_reader

from benchmarks.bags_damage import campaign, messages_of
from tests.helpers.bag_samples import write_drive
from turtlebag.datasets.bags.recover import recover
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.recordings import load_recording

ROOT = Path(__file__).parents[2]
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


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive") / "bag"
    write_drive(folder, seconds=6)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("after_s", [0.02, 0.13, 0.3])
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
def test_random_cuts_and_flips_never_give_wrong_data_or_silence(drive, tmp_path):
    """Formats without checksums end in data or one error."""
    counts = Counter(campaign(drive, 10, 0, tmp_path))
    kinds = {what for what, _ in counts}
    assert len(kinds) == 10
    assert all(sum(n for (what, _), n in counts.items() if what == kind) == 10 for kind in kinds)
    assert not [outcome for outcome in counts if outcome[1].startswith("BAD")]
    assert counts["mcap flip, recover", "recovered"] == 10


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
    assert "bag recover" in bag.notes[1]
