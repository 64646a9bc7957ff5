"""Cache files: never other bytes than were stored, whatever happens to the folder."""

import os
import re
import shutil
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

from turtlebag.datasets.cache_files import MAGIC, read_cached, trim_cached, write_cached
from turtlebag.datasets.fingerprints import fingerprint

NAME = re.compile(r"\d\.kept")
LIMIT = 1_000_000


def flipped(content):
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


@pytest.mark.parametrize(
    "damage",
    [flipped, lambda c: c[: len(c) // 2], lambda c: b"", lambda c: c[: len(MAGIC)], lambda c: c + b"x"],
)
def test_damaged_bytes_are_none(tmp_path, damage):
    path = tmp_path / "1.kept"
    assert read_cached(path) is None
    assert write_cached(path, b"payload" * 100)
    assert read_cached(path) == b"payload" * 100
    path.write_bytes(damage(path.read_bytes()))
    assert read_cached(path) is None


def test_bytes_under_another_name_are_none(tmp_path):
    write_cached(tmp_path / "1.kept", b"one")
    shutil.copy(tmp_path / "1.kept", tmp_path / "2.kept")
    assert read_cached(tmp_path / "2.kept") is None
    assert read_cached(tmp_path / "1.kept") == b"one"


def test_the_least_recently_used_go_first(tmp_path):
    for number in range(4):
        write_cached(tmp_path / f"{number}.kept", bytes(400_000))
        os.utime(tmp_path / f"{number}.kept", (number, number))
    (tmp_path / "0.kept.77.1").write_bytes(b"what a killed process left")
    os.utime(tmp_path / "0.kept.77.1", (0, 0))
    assert read_cached(tmp_path / "0.kept") is not None
    trim_cached(tmp_path, NAME, LIMIT, 10)
    assert {path.name for path in tmp_path.iterdir()} == {"0.kept", "3.kept"}
    trim_cached(tmp_path, NAME, LIMIT, 1)
    assert {path.name for path in tmp_path.iterdir()} == {"0.kept"}


def test_a_folder_that_cannot_be_used_ends_no_run(tmp_path):
    (tmp_path / "file").write_text("")
    assert not write_cached(tmp_path / "file" / "1.kept", b"one")
    trim_cached(tmp_path / "file", NAME, LIMIT, 10)


def test_files_of_others_are_never_removed(tmp_path):
    (tmp_path / "thesis.pdf").write_bytes(bytes(2_000_000))
    os.utime(tmp_path / "thesis.pdf", (0, 0))
    for number in (1, 2):
        write_cached(tmp_path / f"{number}.kept", bytes(800_000))
    trim_cached(tmp_path, NAME, LIMIT, 10)
    assert (tmp_path / "thesis.pdf").exists()
    assert len(list(tmp_path.iterdir())) == 2


def hammer(folder):
    """Use six files over and over while others do the same; how often the bytes were not the right ones."""
    wrong = 0
    for turn in range(120):
        path, payload = folder / f"{turn % 6}.kept", bytes([turn % 6]) * 240_000
        found = read_cached(path)
        wrong += found is not None and found != payload
        write_cached(path, payload)
        trim_cached(folder, NAME, LIMIT, 10)
    return wrong


def test_processes_share_a_folder_that_is_too_small_for_them(tmp_path):
    with ProcessPoolExecutor(3) as pool:
        assert list(pool.map(hammer, [tmp_path] * 3)) == [0, 0, 0]
    trim_cached(tmp_path, NAME, LIMIT, 10)
    assert 0 < sum(path.stat().st_size for path in tmp_path.iterdir()) <= LIMIT


def test_values_that_look_alike_have_fingerprints_of_their_own():
    values = [
        ["ab", "c"], ["a", "bc"], [["ab"], "c"], 1, 1.0, True, "1", None, [], {}, [None],
        np.zeros(2), np.zeros((2, 1)), np.zeros(2, np.float32), np.zeros(2, np.int64), -np.zeros(2),
        {"a": 1, "b": 2}, {"a": 2, "b": 1},
    ]  # fmt: skip
    assert len({fingerprint(value) for value in values}) == len(values)
    view = np.arange(12.0).reshape(3, 4).T
    assert fingerprint(view) == fingerprint(view.copy())
    with pytest.raises(TypeError, match="no fingerprint"):
        fingerprint(object())
