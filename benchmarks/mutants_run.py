"""Tests of a copy of the tree, in forked processes that find the heavy libraries loaded already.

The copy keeps its compiled kernels in a folder of its own, by all that they were made of: a mistake in a
kernel compiles that one and those that inline it.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from benchmarks.mutants_draw import Mutant

OURS = ("benchmarks", "tests", "turtlebag")
# What is imported as `turtlebag.planners` is the copy's folder `planners`, and not what is installed.
PACKAGE = """\
from pathlib import Path

__path__ = [str(Path(__file__).parents[1])]
"""
HEAVY = (
    "gtsam", "hypothesis", "numba", "ompl.base", "pydantic", "rosbags.typesys", "scipy.ndimage",
    "scipy.sparse.csgraph", "scipy.spatial", "scipy.stats", "yaml",
)  # fmt: skip
MEMORY = 8 << 30
# Seconds of processor a run may take besides four times what its tests took when measured, and what
# compiling a mutated kernel and all that inlines it may take.
GRACE_S, COMPILE_S = 20.0, 150.0
# Of a process that waits instead; the processor may be shared with many others.
WAITING = 20.0
# pytest's exit codes: all passed, a test failed, tests could not be imported (4 where they were named)
ENDED = {0: "survived", 1: "failed", 2: "failed", 4: "failed"}


@dataclass(frozen=True)
class Outcome:
    """How a run of tests ended: survived, failed, crashed or timeout; the first test that told; seconds."""

    verdict: str
    by: str
    seconds: float


class Tree:
    """A copy of the sources and tests that mistakes are made in, with a kernel cache of its own."""

    def __init__(self, root: Path, home: Path, ref: str = "") -> None:
        self.path, self.cache = home / "tree", home / "kernels"
        shutil.rmtree(self.path, ignore_errors=True)
        self.path.mkdir(parents=True)
        _copy(root, self.path, ref)
        (self.path / "turtlebag").mkdir()
        (self.path / "turtlebag/__init__.py").write_text(PACKAGE)
        for name in HEAVY:
            importlib.import_module(name)

    def run(
        self,
        tests: list[str],
        *,
        cpu_s: float,
        plugin: Any = None,
        after: Any = None,
    ) -> Outcome:
        """Run tests by name up to the first that fails; with a plugin, all of them, and then `after()`."""
        start = time.monotonic()
        with tempfile.TemporaryDirectory() as scratch:
            log = Path(scratch) / "log"
            child = os.fork()
            if child == 0:
                _child(self.path, tests, log, self.cache, cpu_s, plugin, after)
            status = _wait(child, WAITING * cpu_s)
            text = log.read_text(errors="replace") if log.exists() else ""
        seconds = time.monotonic() - start
        if os.WIFSIGNALED(status):
            late = os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGKILL)
            return Outcome("timeout" if late else "crashed", "", seconds)
        code = os.WEXITSTATUS(status)
        if code not in ENDED:
            raise RuntimeError(f"pytest ended with {code}:\n{text[-2000:]}")
        told = re.search(r"^(?:FAILED|ERROR) (\S+)", text, re.MULTILINE)
        return Outcome(ENDED[code], told[1] if told else "", seconds)

    def judge(self, mutant: Mutant, tests: list[str], usual_s: float) -> Outcome:
        """Whether the tests notice the mutant; the tree is whole again afterwards."""
        path = self.path / mutant.path
        source = path.read_text()
        path.write_text(mutant.applied(source))
        try:
            return self.run(tests, cpu_s=GRACE_S + COMPILE_S * mutant.kernel + 4.0 * usual_s)
        finally:
            path.write_text(source)


def _copy(root: Path, to: Path, ref: str) -> None:
    """What git has at a commit; without one, what it has or would add now."""
    if ref:
        archive = subprocess.run(["git", "archive", ref], cwd=root, capture_output=True, check=True).stdout
        subprocess.run(["tar", "x"], cwd=to, input=archive, check=True)
        return
    command = ["git", "ls-files", "-co", "--exclude-standard"]
    listed = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True)
    for name in listed.stdout.splitlines():
        if (root / name).is_file():
            (to / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(root / name, to / name)


def _child(
    tree: Path, tests: list[str], log: Path, cache: Path, cpu_s: float, plugin: Any, after: Any
) -> None:
    """Run pytest in this forked process and leave it with pytest's exit code."""
    code = 3
    try:
        os.setsid()
        resource.setrlimit(resource.RLIMIT_CPU, (int(cpu_s), int(cpu_s) + 5))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        out = os.open(log, os.O_WRONLY | os.O_CREAT)
        os.dup2(out, 1)
        os.dup2(out, 2)
        sys.stdout = sys.stderr = os.fdopen(out, "w")
        os.environ.update(NUMBA_CACHE_DIR=str(cache), PYTHONPATH=str(tree), PYTHONDONTWRITEBYTECODE="1")
        os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # the tests need none, and they load slowly
        sys.dont_write_bytecode = True
        for name in [name for name in sys.modules if name.split(".")[0] in OURS]:
            del sys.modules[name]
        os.chdir(tree)
        sys.path[:] = [str(tree), *(entry for entry in sys.path if entry)]
        options = ["-rfE", "--tb=no", "--rootdir", str(tree), "--basetemp", str(log.parent / "tmp")]
        options += ["--assert=plain"] + ([] if plugin else ["-x"])
        code = int(pytest.main(options + tests, plugins=[plugin] if plugin else []))
        if after is not None:
            after()
    finally:
        sys.stdout.flush()
        os._exit(code)


def _wait(child: int, wall_s: float) -> int:
    """Status of a child; killed with all it started when it takes longer."""
    deadline = time.monotonic() + wall_s
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done or time.monotonic() > deadline:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(child, signal.SIGKILL)
            return status if done else os.waitpid(child, 0)[1]
        time.sleep(0.02)
