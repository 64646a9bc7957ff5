"""Compiled kernels: never outdated, and cached wherever there is a place."""

import importlib
import os
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

from turtlebag.datasets import kernels
from turtlebag.datasets.kernels import KernelCache, njit

ROOT = Path(__file__).parents[2]
PACKAGES = ("datasets", "sim", "planners", "reports", "pipeline")
MODULES = sorted(
    "turtlebag." + path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".")
    for package in PACKAGES
    for path in (ROOT / package).rglob("*.py")
    if "\n@njit" in path.read_text()
)
# Two files: the kernel of the first has the second's inlined.
OUTER = """\
from turtlebag.datasets.kernels import njit
from turtlebag.inner import lower

@njit(cache=True)
def twice(x: float) -> float:
    return 2.0 * lower(x)
"""
INNER = """\
from turtlebag.datasets.kernels import njit

@njit(cache=True)
def lower(x: float) -> float:
    # Less than it was.
    return x - 1.0
"""
CALL = """\
from turtlebag.outer import twice
print(twice(3.0), sum(twice.stats.cache_hits.values()) if hasattr(twice, "stats") else 0)
"""


@pytest.fixture
def tree(tmp_path):
    """A copy of the package that keeps kernels, and the two files."""
    copy = tmp_path / "tree/turtlebag"
    shutil.copytree(ROOT / "datasets", copy / "datasets", ignore=shutil.ignore_patterns("__pycache__"))
    for name, text in {"__init__": "", "outer": OUTER, "inner": INNER}.items():
        (copy / f"{name}.py").write_text(text)
    return tmp_path / "tree"


def call(tree, **environment):
    """(what the kernel gives, kernels that needed no compiling), in a process of its own."""
    given = {**os.environ, "PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(tree / "kernels"), **environment}
    # Python takes its bytecode for that of a source of the same size written within the same second.
    given["PYTHONDONTWRITEBYTECODE"] = "1"
    done = subprocess.run(
        [sys.executable, "-c", CALL], env=given, cwd=tree, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    value, hits = done.stdout.split()
    return float(value), int(hits)


@pytest.mark.slow
def test_a_kernel_follows_the_sources_it_has_inlined(tree):
    """What the file of the inner kernel says changes; the compiled outer one of the other must see it."""
    source = tree / "turtlebag/inner.py"
    assert call(tree) == (4.0, 0)
    source.write_text(INNER.replace("x - 1.0", "x - 2.0"))
    assert call(tree, NUMBA_DISABLE_JIT="1") == (2.0, 0)
    assert call(tree) == (2.0, 0)
    # Other words and another place in the file need no compiling.
    source.write_text("# A line more.\n" + INNER.replace("Less", "Lower").replace("x - 1.0", "x - 2.0"))
    assert call(tree) == (2.0, 1)
    # Of each kernel and tuple of types there is one file, whatever the kernel was before.
    kept = [file.name for file in sorted((tree / "kernels").glob("*.nbc"))]
    assert kept == ["turtlebag.inner.lower.1.nbc", "turtlebag.outer.twice.1.nbc"]


@pytest.mark.slow
def test_a_kernel_is_compiled_again_when_the_type_of_an_argument_moves_to_another_module(tree):
    """As when a module is renamed: what was kept names the old one."""
    for module in ("box", "chest"):
        (tree / f"turtlebag/{module}.py").write_text(
            "from typing import NamedTuple\n\nclass Box(NamedTuple):\n    size: float\n"
        )
        (tree / "turtlebag/outer.py").write_text(
            "from turtlebag.datasets.kernels import njit\n"
            f"from turtlebag.{module} import Box\n\n"
            "@njit(cache=True)\ndef size(box):\n    return box.size\n\n"
            "def twice(x):\n    return 2.0 * size(Box(x))\n"
        )
        assert call(tree) == (6.0, 0)
        (tree / f"turtlebag/{module}.py").unlink()


def test_every_kernel_is_kept_by_a_key_of_its_own():
    found = {}
    for name in MODULES:
        for value in vars(importlib.import_module(name)).values():
            if isinstance(value, Dispatcher):
                assert isinstance(value._cache, KernelCache), f"{name}.{value.__name__} is not kept"
                found[value] = value._cache
    begin = time.process_time()
    assert len({cache.key for cache in found.values()}) == len(found) > 90
    assert time.process_time() - begin < 0.5


@njit(cache=True)
def steps_down(n: int) -> int:
    """Names itself."""
    return 0 if n <= 0 else 1 + steps_down(n - 1)


def test_a_kernel_that_calls_itself_has_a_key_too():
    told = kernels.content(steps_down, frozenset(), set())
    assert told[-1]["steps_down"] == ["again", "steps_down"]


def test_nobody_goes_past_the_cache():
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            assert path.name == "kernels.py" or "numba import" not in path.read_text(), path


def test_the_key_holds_constants_options_and_what_is_called_at_any_depth(monkeypatch):
    def key():
        return KernelCache(outer).key

    keys = [key(), key()]
    monkeypatch.setitem(globals(), "LIMIT", 3.0)
    keys.append(key())
    monkeypatch.setitem(globals(), "inner", njit(cache=True, nogil=True)(inner.py_func))
    keys.append(key())
    monkeypatch.setattr(SETTINGS, "offset", 2.0)
    keys.append(key())
    monkeypatch.setitem(globals(), "TABLE", np.array([1.0, 2.0, 4.0]))
    keys.append(key())
    monkeypatch.setattr(inner.py_func, "__defaults__", (2.0,))
    keys.append(key())
    assert keys[0] == keys[1]
    assert len(set(keys)) == len(keys) - 1
    monkeypatch.setitem(globals(), "LIMIT", {})
    with pytest.raises(TypeError, match="reads a dict"):
        key()


LIMIT, TABLE, SETTINGS = 2.0, np.array([1.0, 2.0, 3.0]), ModuleType("settings")
SETTINGS.offset = 1.0


@njit(cache=True)
def inner(x, scale=1.0):
    return min(x * scale, LIMIT) + SETTINGS.offset + TABLE[0]


@njit(cache=True)
def outer(x):
    return inner(x) + 1.0


@pytest.fixture
def places(tmp_path, monkeypatch):
    """The three places of compiled code: beside the bytecode, the user's, the temporary one."""
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(kernels, "cache_from_source", lambda path: str(tmp_path / "own" / "kernels.pyc"))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    ours = tmp_path / "temporary" / f"turtlebag-{os.getuid()}"
    return [tmp_path / "own" / "kernels", tmp_path / "home/.cache/turtlebag/kernels", ours / "kernels"]


def hits():
    """A new process' first call of the kernel: how often the code was there."""
    kernel = njit(cache=True)(inner.py_func)
    assert kernel(1.0) == 3.0
    return sum(kernel.stats.cache_hits.values())


def in_the_way(folder):
    """No folder can be made of this name, whoever asks."""
    folder.parent.mkdir(parents=True)
    folder.write_text("")


def test_compiled_code_lies_beside_the_bytecode(places):
    assert [hits(), hits()] == [0, 1]
    assert [place.exists() for place in places] == [True, False, False]


def test_where_the_clone_cannot_be_written_it_lies_with_the_user(places):
    in_the_way(places[0])
    assert [hits(), hits()] == [0, 1]
    assert [place.is_dir() for place in places] == [False, True, False]


def test_without_a_home_it_lies_in_the_temporary_folder(places, monkeypatch):
    in_the_way(places[0])
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    assert [hits(), hits()] == [0, 1]
    assert places[2].is_dir()
    assert places[2].parent.stat().st_mode & 0o077 == 0


@pytest.mark.slow
@pytest.mark.parametrize("what", ["link", "open to all", "file"])
def test_a_temporary_folder_that_is_not_ours_alone_is_never_read(places, tmp_path, what):
    for place in places[:2]:
        in_the_way(place)
    assert [hits(), hits()] == [0, 1]
    ours = places[2].parent
    if what == "open to all":
        ours.chmod(0o777)
    else:
        ours.rename(tmp_path / "elsewhere")
        ours.symlink_to(tmp_path / "elsewhere") if what == "link" else ours.write_text("")
    assert [hits(), hits()] == [0, 0]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["nbi", "nbc"])
@pytest.mark.parametrize("damage", [lambda c: b"", lambda c: c[:-1], lambda c: b"x" + c[1:]])
def test_damaged_code_is_compiled_again(places, kind, damage):
    assert hits() == 0
    (file,) = places[0].glob(f"*.{kind}")
    whole = file.read_bytes()
    file.write_bytes(damage(whole))
    assert [hits(), hits()] == [0, 1]


@pytest.mark.slow
def test_an_index_that_names_the_code_of_other_types_is_seen(places):
    """As when two processes write at once what they compiled for different types."""
    assert hits() == 0
    (file,) = places[0].glob("*.nbc")
    floats = file.read_bytes()
    shutil.rmtree(places[0])
    whole = njit(cache=True)(inner.py_func)
    assert whole(1) == 3.0
    file.write_bytes(floats)
    again = njit(cache=True)(inner.py_func)
    assert again(1) == 3.0
    assert not again.stats.cache_hits


def hits_of_a_worker(place):
    """In a process of its own, as a campaign's workers are."""
    os.environ["NUMBA_CACHE_DIR"] = place
    return hits()


@pytest.mark.slow
def test_workers_share_what_is_compiled(tmp_path):
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        assert pool.submit(hits_of_a_worker, str(tmp_path)).result() == 0
    with ProcessPoolExecutor(2, mp_context=get_context("fork")) as pool:
        assert list(pool.map(hits_of_a_worker, [str(tmp_path)] * 2)) == [1, 1]
