"""Results kept by what made them: only what changed is done again, and never with other bytes."""

import hashlib
import json
import os
import pickle
import re
import shutil
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from tests.slam_rooms import ROOM, around_the_room, drifted, recording
from turtlebag.datasets import stage_cache as caching
from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.fingerprints import fingerprint
from turtlebag.datasets.kept import MAGIC
from turtlebag.datasets.outputs import sha256_tree
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.stage_cache import StageCache, default_cache
from turtlebag.datasets.types import Joints, Observation, Odometry, Twist
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.slam.slam import SlamConfig, run_slam

POSES = around_the_room(60)
STEPS = ["turns", "front end", "loops", "refinement", "scan poses", "grid", "self-check"]


@pytest.fixture(scope="module")
def log():
    return recording(ROOM, POSES, odometry=drifted(POSES))


@pytest.fixture(scope="module")
def filled(log, tmp_path_factory):
    """A folder that knows the map of `log` with the usual settings."""
    folder = tmp_path_factory.mktemp("cache")
    run_slam(log, SlamConfig(), cache=StageCache(folder))
    return folder


def everything(result):
    """All that a map's files are made of, as one hash."""
    loops = [vars(loop) for loop in result.loops]
    edges = [vars(edge) for edge in result.constraints]
    return fingerprint(
        [result.trajectory, result.grid, result.track, result.T_map_keys, edges, loops, result.check]
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "made"),
    [
        ({}, []),
        ({"grid": {"resolution_m": 0.1}}, ["grid", "self-check"]),
        ({"posing": {"enabled": False}}, ["scan poses", "grid", "self-check"]),
        ({"refine": {"rounds": 1}}, STEPS[3:]),
        ({"loops": {"min_overlap": 0.8}}, STEPS[2:]),
        ({"tracking": {"key_distance_m": 0.4}}, STEPS[1:]),
        ({"usable_range_m": 6.0}, STEPS[1:]),
    ],
)
def test_only_what_a_setting_reaches_is_done_again_and_nothing_differs(log, filled, tmp_path, change, made):
    shutil.copytree(filled, tmp_path / "cache")
    config = SlamConfig.model_validate(change)
    cache = StageCache(tmp_path / "cache")
    with_cache = run_slam(log, config, cache=cache)
    assert cache.made == made
    assert cache.found == [step for step in STEPS if step not in made]
    assert everything(with_cache) == everything(run_slam(log, config))


@pytest.mark.slow
def test_other_scans_are_another_recording(filled):
    cache = StageCache(filled)
    run_slam(recording(ROOM, POSES, odometry=drifted(POSES), seed=1), SlamConfig(), cache=cache)
    assert cache.found == []


@pytest.mark.slow
def test_joined_sessions_keep_their_steps(log, tmp_path):
    other = recording(ROOM, POSES[::-1] + np.array([0.1, 0.1, np.pi]), seed=4)
    plain = run_slam(log, SlamConfig(), more=[other])
    for made in ([*STEPS[:4], "joining", *STEPS[4:]], []):
        cache = StageCache(tmp_path)
        assert everything(run_slam(log, SlamConfig(), more=[other], cache=cache)) == everything(plain)
        assert cache.made == made
    cache = StageCache(tmp_path)
    run_slam(log, SlamConfig(refine={"rounds": 1}), more=[other], cache=cache)
    assert cache.found == ["turns", "front end", "loops"]


def flipped(content):
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


@pytest.mark.parametrize(
    "damage",
    [flipped, lambda c: c[: len(c) // 2], lambda c: b"", lambda c: c[: len(MAGIC)], lambda c: c + b"x"],
)
def test_a_damaged_entry_is_made_again(tmp_path, damage):
    values = np.arange(100.0)
    StageCache(tmp_path).step("a", [1], lambda: values)
    (entry,) = tmp_path.iterdir()
    whole = entry.read_bytes()
    entry.write_bytes(damage(whole))
    cache = StageCache(tmp_path)
    np.testing.assert_array_equal(cache.step("a", [1], lambda: values)[0], values)
    assert cache.made == ["a"]
    assert entry.read_bytes() == whole


@pytest.mark.slow
def test_a_map_of_broken_entries_is_the_map(log, tmp_path):
    plain = everything(run_slam(log, SlamConfig()))
    rng = np.random.default_rng(3)
    for turn in range(2):
        run_slam(log, SlamConfig(), cache=StageCache(tmp_path / f"{turn}"))
        entries = sorted((tmp_path / f"{turn}").iterdir())
        for entry in entries[turn::2]:
            content = bytearray(entry.read_bytes())
            content[int(rng.integers(len(content)))] ^= 1 << int(rng.integers(8))
            entry.write_bytes(content)
        cache = StageCache(tmp_path / f"{turn}")
        assert everything(run_slam(log, SlamConfig(), cache=cache)) == plain
        assert len(cache.made) == len(entries[turn::2])


def test_an_entry_under_another_name_is_no_entry(tmp_path):
    cache = StageCache(tmp_path)
    for number in (1, 2):
        cache.step("a", [number], lambda number=number: number)
    one, two = sorted(tmp_path.iterdir())
    shutil.copy(one, two)
    assert {cache.step("a", [number], lambda number=number: number)[0] for number in (1, 2)} == {1, 2}


@pytest.mark.parametrize("evil", [os.system, shutil.rmtree, Path, fingerprint])
def test_entries_hold_nothing_that_acts(tmp_path, evil):
    _, key = StageCache(tmp_path).step("a", [1], lambda: 1)
    payload = pickle.dumps((evil,), protocol=5)
    seal = hashlib.sha256(key.encode() + payload).digest()
    (tmp_path / key).write_bytes(MAGIC + seal + payload)
    cache = StageCache(tmp_path)
    assert cache.step("a", [1], lambda: 5)[0] == 5
    assert cache.made == ["a"]


def test_the_least_recently_used_go_first(tmp_path):
    cache = StageCache(tmp_path, limit_mb=1)
    keys = []
    for number in range(4):
        keys.append(cache.step("a", [number], lambda: np.zeros(40_000))[1])
        os.utime(tmp_path / keys[-1], (number, number))
    (tmp_path / f"{keys[0]}.77.1").write_bytes(b"what a killed process left")
    os.utime(tmp_path / f"{keys[0]}.77.1", (0, 0))
    cache.step("a", [0], lambda: pytest.fail("was there"))
    cache.trim()
    assert {path.name for path in tmp_path.iterdir()} == {keys[0], keys[2], keys[3]}
    cache.step("a", [9], lambda: np.zeros(200_000))
    assert len(list(tmp_path.iterdir())) == 3


def test_a_folder_that_cannot_be_used_ends_no_run(tmp_path):
    (tmp_path / "file").write_text("")
    cache = StageCache(tmp_path / "file" / "cache")
    assert cache.step("a", [1], lambda: 7)[0] == 7
    cache.trim()


def test_files_that_are_no_entries_are_never_removed(tmp_path):
    (tmp_path / "thesis.pdf").write_bytes(bytes(2_000_000))
    os.utime(tmp_path / "thesis.pdf", (0, 0))
    cache = StageCache(tmp_path, limit_mb=1)
    cache.step("a", [1], lambda: np.zeros(100_000))
    cache.step("a", [2], lambda: np.zeros(100_000))
    cache.trim()
    assert (tmp_path / "thesis.pdf").exists()
    assert len(list(tmp_path.iterdir())) == 2


def hammer(folder):
    """Use six entries over and over while others do the same; how often a value was not the right one."""
    wrong = 0
    for turn in range(120):
        number = turn % 6
        cache = StageCache(folder, limit_mb=1)
        found, _ = cache.step("a", [number], lambda number=number: np.full(30_000, float(number)))
        wrong += not np.array_equal(found, np.full(30_000, float(number)))
        cache.trim()
    return wrong


def test_processes_share_a_folder_that_is_too_small_for_them(tmp_path):
    with ProcessPoolExecutor(3) as pool:
        assert list(pool.map(hammer, [tmp_path] * 3)) == [0, 0, 0]
    StageCache(tmp_path, limit_mb=1).trim()
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 1_000_000


def test_values_that_look_alike_have_fingerprints_of_their_own():
    pose = SE2.from_xyt(1.0, 2.0, 0.0)
    values = [
        ["ab", "c"], ["a", "bc"], [["ab"], "c"], 1, 1.0, True, "1", None, [], {}, [None],
        np.zeros(2), np.zeros((2, 1)), np.zeros(2, np.float32), np.zeros(2, np.int64), -np.zeros(2),
        pose, pose.xyt, SlamConfig(), SlamConfig(usable_range_m=29.0), {"a": 1, "b": 2}, {"a": 2, "b": 1},
    ]  # fmt: skip
    assert len({fingerprint(value) for value in values}) == len(values)
    view = np.arange(12.0).reshape(3, 4).T
    assert fingerprint(view) == fingerprint(view.copy())
    with pytest.raises(TypeError, match="no fingerprint"):
        fingerprint(object())


def test_new_code_or_packages_are_another_key(tmp_path, monkeypatch):
    cache = StageCache(tmp_path)
    cache.step("a", [1], lambda: 1)
    monkeypatch.setattr(caching, "surroundings", lambda: "of tomorrow")
    assert cache.step("a", [1], lambda: 2)[0] == 2


def test_the_sources_in_a_key_are_all_that_a_stage_is_made_of():
    folders = tuple(folder.replace("/", ".") for folder in caching.SOURCES)
    for path in sorted(path for folder in caching.SOURCES for path in (caching.ROOT / folder).rglob("*.py")):
        named = re.findall(
            r"^\s*(?:from|import) ((?:datasets|sim|planners|reports|pipeline)\b[\w.]*)",
            path.read_text(),
            re.M,
        )
        others = {name for name in named if not name.startswith(folders)}
        assert others <= {"turtlebag.datasets.stage_cache"}, path


def test_where_the_cache_is(tmp_path, monkeypatch):
    monkeypatch.setenv("TURTLEBAG_STAGE_CACHE", "off")
    assert not default_cache().on
    monkeypatch.setenv("TURTLEBAG_STAGE_CACHE", str(tmp_path / "own"))
    assert default_cache().step("a", [1], lambda: 1)[1] == next((tmp_path / "own").iterdir()).name
    monkeypatch.delenv("TURTLEBAG_STAGE_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))
    monkeypatch.chdir(tmp_path)
    default_cache().step("a", [1], lambda: 1)
    assert len(list((tmp_path / "user/turtlebag/stages").iterdir())) == 1
    monkeypatch.setattr(caching, "ROOT", tmp_path)
    (tmp_path / "Makefile").write_text("")
    (tmp_path / "sub").mkdir()
    monkeypatch.chdir(tmp_path / "sub")
    default_cache().step("a", [1], lambda: 1)
    assert len(list((tmp_path / "data/cache").iterdir())) == 1
    monkeypatch.setenv("TURTLEBAG_STAGE_CACHE_MB", "much")
    with pytest.raises(InputError, match="whole number of megabytes"):
        default_cache()


@pytest.fixture(scope="module")
def bag(log, tmp_path_factory):
    folder = tmp_path_factory.mktemp("bag") / "bag"
    with BagWriter(folder, custom={}) as bag:
        for k in range(len(log)):
            stamp = int(log.stamps_ns[k])
            odometry = Odometry(stamp, log.T_odom_base[k], Twist())
            bag.observation(Observation(stamp, odometry, Joints(stamp, (0.0, 0.0), (0.0, 0.0)), log.scan(k)))
    return folder


@pytest.mark.slow
def test_the_command_says_what_it_reused_and_compare_shows_the_effect(bag, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("TURTLEBAG_STAGE_CACHE", str(tmp_path / "cache"))

    def mapped(name, *more):
        assert main(["map", str(bag), "--out", str(tmp_path / name), *more]) == 0
        manifest = json.loads((tmp_path / name / "manifest.json").read_text())
        said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("cached: ")]
        return manifest.get("from_cache", []), said

    assert mapped("plain", "--explain", "--no-cache") == ([], [])
    assert not (tmp_path / "cache").exists()
    assert mapped("first", "--explain") == ([], [])
    found, said = mapped("again", "--explain")
    assert found == ["reading", *STEPS]
    assert said == ["cached: reading, " + ", ".join(STEPS) + "; computed: nothing"]
    assert (
        sha256_tree(tmp_path / "plain") == sha256_tree(tmp_path / "first") == sha256_tree(tmp_path / "again")
    )
    found, said = mapped("fine", "--set", "grid.resolution_m=0.025")
    assert said == ["cached: reading, " + ", ".join(STEPS[:-2]) + "; computed: grid, self-check"]
    assert mapped("moved", "--laser", "0.1,0,0")[0] == []
    words = ["compare", str(tmp_path / "first"), str(tmp_path / "fine"), "--out", str(tmp_path / "to-fine")]
    assert main(words) == 0
    page = (tmp_path / "to-fine/index.html").read_text()
    assert "grid.resolution_m" in page


@pytest.mark.slow
def test_a_changed_bag_is_read_anew(bag, tmp_path, monkeypatch):
    monkeypatch.setenv("TURTLEBAG_STAGE_CACHE", str(tmp_path / "cache"))
    shutil.copytree(bag, tmp_path / "bag")
    assert main(["map", str(tmp_path / "bag"), "--out", str(tmp_path / "one"), "-q"]) == 0
    (content,) = (tmp_path / "bag").glob("*.mcap")
    content.write_bytes(content.read_bytes()[: content.stat().st_size // 2])
    for name, words in (("two", []), ("three", ["--no-cache"])):
        assert main(["map", str(tmp_path / "bag"), "--out", str(tmp_path / name), "-q", *words]) == 0
    assert sha256_tree(tmp_path / "two") == sha256_tree(tmp_path / "three")
    assert sha256_tree(tmp_path / "two") != sha256_tree(tmp_path / "one")
