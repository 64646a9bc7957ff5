"""Compiled kernels: never outdated, and nothing about where they are kept ends a command."""

import importlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
from numba.core.dispatcher import Dispatcher

ROOT = Path(__file__).parents[2]
PACKAGES = ("datasets", "sim", "planners", "reports", "pipeline")
MODULES = sorted(
    "turtlebag." + path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".")
    for package in PACKAGES
    for path in (ROOT / package).rglob("*.py")
    if "\n@njit" in path.read_text()
)
# The kernel of the first file has the second's inlined, and that reads a number of the third.
OUTER = """\
from turtlebag.datasets.kernels import njit
from turtlebag.sim.inner import lower

@njit(cache=True)
def twice(x):
    return 2 * lower(x)
"""
INNER = """\
from turtlebag.datasets.kernels import njit
from turtlebag.sim.numbers import STEP

@njit(cache=True)
def lower(x):
    return x - STEP
"""
CALL = """\
import errno, json, logging, os, sys
if "told" in sys.argv:
    logging.basicConfig(level=logging.INFO)
if "full" in sys.argv:
    def full(*_): raise OSError(errno.ENOSPC, "No space left on device")
    os.replace = full
from turtlebag.sim.outer import twice
given = [3 if word == "int" else 3.0 for word in sys.argv[1:] if word in ("int", "float")] or [3.0]
found = [twice(x) for x in given]
hits = sum(twice.stats.cache_hits.values()) if hasattr(twice, "stats") else 0
print(json.dumps([found, hits, numba.config.CACHE_DIR]))
"""
# Most of what a process does that calls its first kernel: done once, and all that call ours are forks of it.
PARENT = f"""\
import json, os, sys, traceback
from contextlib import suppress
import numba
numba.njit(lambda x: 2 * x)(1.0)
for line in sys.stdin:
    words, environment, folder = json.loads(line)
    if os.fork() == 0:
        code = 1
        for number, name in ((1, "out"), (2, "told")):
            os.dup2(os.open(os.path.join(folder, name), os.O_WRONLY | os.O_CREAT), number)
        try:
            os.environ |= environment
            numba.config.reload_config()
            sys.argv[1:], sys.path[:0] = words, [environment["PYTHONPATH"]]
            exec({CALL!r})
            sys.stdout.flush()
            code = 0
        except BaseException:
            traceback.print_exc()
        os.rename(os.path.join(folder, "out"), os.path.join(folder, f"ended-{{code}}"))
        os._exit(code)
with suppress(ChildProcessError):
    while True:
        os.wait()
"""


@pytest.fixture
def tree(tmp_path):
    """A copy of the room that keeps kernels, and the three files."""
    copy = tmp_path / "tree/turtlebag"
    shutil.copytree(ROOT / "datasets", copy / "datasets", ignore=shutil.ignore_patterns("__pycache__"))
    (copy / "sim").mkdir()
    (copy / "__init__.py").write_text("")
    texts = {"__init__": "", "outer": OUTER, "inner": INNER, "numbers": "STEP = 1\n", "other": "STEP = 5\n"}
    for name, text in texts.items():
        (copy / f"sim/{name}.py").write_text(text)
    return tmp_path / "tree"


@pytest.fixture(scope="module", autouse=True)
def parent():
    # Python takes its bytecode for that of a source of the same size written within the same second.
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    with subprocess.Popen(
        [sys.executable, "-c", PARENT], env=environment, stdin=subprocess.PIPE, text=True
    ) as process:
        begun.parent = process
        yield
        process.stdin.close()


def begun(tree, *words, **environment):
    """The folder in which a process leaves what it says."""
    given = {"PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(tree / "kept"), **environment}
    folder = tempfile.mkdtemp(dir=tree)
    print(json.dumps([words, given, folder]), file=begun.parent.stdin, flush=True)
    return Path(folder)


def call(tree, *words, said="", **environment):
    """(what the kernel gives, how often it needed no compiling), in a process of its own."""
    return ended(begun(tree, *words, **environment), said)[:2]


def ended(folder, said=""):
    end = time.monotonic() + 60.0
    while not (out := list(folder.glob("ended-*"))):
        assert time.monotonic() < end
        time.sleep(0.002)
    told = (folder / "told").read_text()
    assert out[0].name == "ended-0", told
    assert said in told
    assert bool(said) == bool(told)
    found, hits, numbas = json.loads(out[0].read_text())
    return found[0] if len(found) == 1 else found, hits, numbas


def kernel_files(tree, ending):
    return sorted((tree / "kept/kernels").rglob(f"outer.twice*.{ending}"))


@pytest.mark.slow
def test_a_kernel_follows_all_sources_that_it_is_made_of(tree):
    assert ended(begun(tree)) == (4.0, 0, str(tree / "kept"))  # Numba's own setting stays what it was
    assert call(tree) == (4.0, 1)
    for file, before, now, result in (
        ("inner", "x - STEP", "x - 2 * STEP", 2.0),
        ("numbers", "STEP = 1", "STEP = 0", 6.0),
        ("outer", "2 * lower", "4 * lower", 12.0),
    ):
        source = tree / f"turtlebag/sim/{file}.py"
        source.write_text(source.read_text().replace(before, now))
        assert call(tree) == (result, 0)
    assert call(tree, NUMBA_DISABLE_JIT="1") == (12.0, 0)
    # What no kernel reads may change.
    (tree / "turtlebag/sim/other.py").write_text("STEP = 6\n")
    assert call(tree) == (12.0, 1)


@pytest.mark.slow
def test_a_kernel_is_compiled_again_when_the_type_of_an_argument_moves_to_another_module(tree):
    """As when a module is renamed: what was kept names the old one."""
    for module in ("box", "chest"):
        (tree / f"turtlebag/{module}.py").write_text(
            "from typing import NamedTuple\n\nclass Box(NamedTuple):\n    size: float\n"
        )
        (tree / "turtlebag/sim/outer.py").write_text(
            "from turtlebag.datasets.kernels import njit\n"
            f"from turtlebag.{module} import Box\n\n"
            "@njit(cache=True)\ndef size(box):\n    return box.size\n\n"
            "def twice(x):\n    return 2.0 * size(Box(x))\n"
        )
        assert call(tree) == (6.0, 0)
        (tree / f"turtlebag/{module}.py").unlink()


def test_every_kernel_of_ours_is_kept():
    kernels = {
        value
        for name in MODULES
        for value in vars(importlib.import_module(name)).values()
        if isinstance(value, Dispatcher)
    }
    assert len(kernels) > 90
    for kernel in kernels:
        assert kernel.stats.cache_path, kernel
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            assert path.name == "kernels.py" or "numba import" not in path.read_text(), path


@pytest.mark.slow
def test_damaged_code_is_compiled_again(tree):
    assert call(tree) == (4.0, 0)
    for ending, damage in (("nbi", lambda c: c[:-1]), ("nbc", lambda c: b"x" + c[1:])):
        (file,) = kernel_files(tree, ending)
        file.write_bytes(damage(file.read_bytes()))
        assert call(tree) == (4.0, 0)
    assert call(tree) == (4.0, 1)


@pytest.mark.slow
def test_an_index_that_names_the_code_of_other_types_is_seen(tree):
    """As when two processes write at once what they compiled for different types."""
    assert call(tree, "float") == (4.0, 0)
    (file,) = kernel_files(tree, "nbc")
    floats = file.read_bytes()
    shutil.rmtree(tree / "kept")
    assert call(tree, "int") == (4, 0)
    file.write_bytes(floats)
    assert call(tree, "int") == (4, 0)
    assert call(tree, "int", "float") == ([4, 4.0], 1)


@pytest.mark.slow
def test_processes_that_compile_at_once_do_not_get_in_each_others_way(tree):
    together = [begun(tree, *words) for words in (["float"], ["int"], ["float", "int"])]
    assert [ended(one)[0] for one in together] == [4.0, 4, [4.0, 4]]
    assert call(tree, "float", "int")[0] == [4.0, 4]
    assert call(tree, "float", "int") == ([4.0, 4], 2)


@pytest.mark.slow
def test_where_nothing_can_be_written_it_is_said_once_and_the_kernels_run(tree):
    (tree / "kept").write_text("")
    said = "kernels are not kept; set NUMBA_CACHE_DIR to a folder that can be written"
    assert call(tree, "int", "float", said=said) == ([4, 4.0], 0)
    assert not list(tree.rglob("*.nb?"))


@pytest.mark.slow
def test_that_they_are_compiled_is_said_once(tree):
    assert call(tree, "told", said="note: compiling kernels") == (4.0, 0)
    assert call(tree, "told") == (4.0, 1)


@pytest.mark.slow
def test_on_a_full_disk_the_kernels_run(tree):
    assert call(tree, "full") == (4.0, 0)
    assert not kernel_files(tree, "nb?")
    assert call(tree) == (4.0, 0)


@pytest.mark.slow
def test_without_numbas_own_setting_they_lie_in_the_users_cache_and_old_folders_go(tree):
    old = [tree / f"home/.cache/turtlebag/kernels/old-{k}" for k in range(20)]
    for k, folder in enumerate(old):
        folder.mkdir(parents=True)
        os.utime(folder, (time.time() - 1000.0 + k,) * 2)
    environment = {"NUMBA_CACHE_DIR": "", "XDG_CACHE_HOME": "", "HOME": str(tree / "home")}
    assert ended(begun(tree, **environment)) == (4.0, 0, "")
    assert call(tree, **environment) == (4.0, 1)
    assert [folder.name for folder in old if folder.exists()] == [f"old-{k}" for k in range(5, 20)]
