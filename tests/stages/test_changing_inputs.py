"""Recordings that change while they are read: one line, and no output of the mixture."""

import io
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.bag_samples import stamp, write_drive
from tests.helpers.ros1_bags import to_ros1_bag
from turtlebag.datasets.bags.reader import bag_info
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.files import PIECE_BYTES, FileBytes
from turtlebag.datasets.types import Cloud
from turtlebag.pipeline.cli.main import main


@pytest.fixture(params=["bag_0.mcap", "a.bag"])
def bag(request, tmp_path):
    """A bag file of several reads."""
    rng = np.random.default_rng(1)
    with BagWriter(tmp_path / "drive", custom={}) as writer:
        for k in range(40):
            cloud = Cloud(rng.normal(size=(10_000, 3)), np.zeros(10_000))
            writer.cloud(stamp(k), stamp(k), cloud, "base_scan")
    file = tmp_path / "drive" / "bag_0.mcap"
    if request.param == "a.bag":
        to_ros1_bag(tmp_path / "drive", tmp_path / "a.bag")
        file = tmp_path / "a.bag"
    assert file.stat().st_size > 3 * PIECE_BYTES
    return file


def cut(path):
    os.truncate(path, 40_000)


def replaced(path):
    other = path.with_name("other")
    other.write_bytes(path.read_bytes())
    other.replace(path)


def written_to(path):
    with path.open("r+b") as file:
        file.seek(path.stat().st_size - 100)
        file.write(bytes(100))


def grown(path):
    with path.open("ab") as file:
        file.write(bytes(100))


CHANGES = [cut, replaced, written_to, grown, Path.unlink]


@pytest.mark.slow
@pytest.mark.parametrize("change", CHANGES)
def test_a_bag_that_changes_while_it_is_read_is_one_line(bag, change):
    def read():
        for number, _ in enumerate(open_bag(bag).messages()):
            if number == 10:
                change(bag)

    with pytest.raises(InputError, match="changed while it was read") as refused:
        read()
    assert "\n" not in str(refused.value)


@pytest.mark.slow
def test_a_bag_that_changed_between_two_readings_is_refused(bag):
    opened = open_bag(bag)
    list(opened.messages())
    written_to(bag)
    with pytest.raises(InputError, match="changed"):
        list(opened.messages())
    bag_info(bag)  # who opens it now reads what is there now


def test_what_changed_while_it_was_mapped_is_not_written(tmp_path, monkeypatch):
    """It changes when what was noticed on reading is told."""
    write_drive(tmp_path / "drive", seconds=5.0)
    bag = tmp_path / "drive/bag_0.mcap"
    cut(bag)

    class Told(io.StringIO):
        def write(self, line):
            if "damaged at byte" in line:
                replaced(bag)
            return super().write(line)

    monkeypatch.setattr(sys, "stderr", told := Told())
    assert main(["map", str(bag), "--out", str(tmp_path / "map")]) == 2
    *_, last = told.getvalue().splitlines()
    assert last.startswith(f"turtlebag: {bag}: changed while it was read")
    assert not (tmp_path / "map").exists()
    assert not (tmp_path / "map.partial").exists()


def test_a_file_gives_the_same_bytes_however_it_is_asked(tmp_path):
    content = os.urandom(3_000_000)
    (tmp_path / "a").write_bytes(content)
    file = FileBytes(tmp_path / "a")
    assert len(file) == len(content)
    for piece in (slice(5, 9), slice(0, 3_000_000), slice(2_999_990, None), slice(-8, None), slice(9, 5)):
        assert file[piece] == content[piece]
    for at in (0, (1 << 20) - 2, 2_999_990):
        assert file.find(content[at : at + 8], 0) == at
    assert file.find(b"turtlebag turtlebag", 0) == -1
