"""Recordings that change while they are read: one line, and no output of the mixture."""

import os
import shutil
from pathlib import Path

import pytest

import turtlebag.pipeline.stages.sources
from tests.helpers.bag_samples import write_drive
from tests.helpers.ros1_bags import to_ros1_bag
from turtlebag.datasets.bags.reader import bag_info
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.files import FileBytes
from turtlebag.pipeline.cli.main import main


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """Bag files of more than what is read of them at once, a MiB."""
    folder = tmp_path_factory.mktemp("bags")
    write_drive(folder / "drive", seconds=80.0)
    shutil.copy(folder / "drive/bag_0.mcap", folder)
    to_ros1_bag(folder / "drive", folder / "a.bag")
    assert all((folder / name).stat().st_size > 5 << 18 for name in ("bag_0.mcap", "a.bag"))
    return folder


@pytest.fixture(params=["bag_0.mcap", "a.bag"])
def bag(request, bags, tmp_path):
    """A copy of one, to change."""
    return shutil.copy(bags / request.param, tmp_path / request.param)


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


def test_what_changed_while_it_was_mapped_is_not_written(bag, tmp_path, monkeypatch, capsys):
    load = turtlebag.pipeline.stages.sources.load_recording

    def meanwhile(path, **options):
        recording = load(path, **options)
        replaced(path)
        return recording

    monkeypatch.setattr(turtlebag.pipeline.stages.sources, "load_recording", meanwhile)
    assert main(["map", str(bag), "--out", str(tmp_path / "map")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
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
