"""Tests of a copy of the tree, in forked processes that find the heavy libraries loaded already.

A mutant keeps its file's length and time, so numba takes the other kernels of the file from its cache.
Of a mistake in a kernel the cached code that may hold it is left out: that of its module and of the
modules that import it, directly or through others.
"""

from __future__ import annotations

import contextlib
import hashlib
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
from functools import cached_property
from pathlib import Path
from typing import Any

import pytest

from benchmarks.mutants_draw import Mutant, mutable_files
from benchmarks.mutants_tests import imported

OURS = ("benchmarks", "datasets", "pipeline", "planners", "reports", "sim", "tests", "turtlebag")
HEAVY = (
    "gtsam", "hypothesis", "numba", "ompl.base", "pydantic", "rosbags.typesys", "scipy.ndimage",
    "scipy.sparse.csgraph", "scipy.spatial", "scipy.stats", "yaml",
)  # fmt: skip
PADDING = 400
EPOCH = 1_600_000_000
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
        self._prepare()
        for name in HEAVY:
            importlib.import_module(name)

    def _prepare(self) -> None:
        """Pad the mutable files with a comment, and give every file a time that its content makes."""
        for name in mutable_files(self.path):
            self._write(name, (self.path / name).read_text())
        for path in self.path.rglob("*.py"):
            # numba asks for the time of a file: so its cache lasts from run to run
            stamp = EPOCH + int(hashlib.sha256(path.read_bytes()).hexdigest()[:6], 16)
            os.utime(path, (stamp, stamp))

    def _write(self, name: str, source: str, *, size: int | None = None) -> None:
        path = self.path / name
        extra = PADDING if size is None else max(0, size - len(source.encode()) - 3)
        path.write_text(f"{source}# {'-' * extra}\n")

    def run(
        self,
        tests: list[str],
        *,
        cpu_s: float,
        cache: Path | None = None,
        plugin: Any = None,
        after: Any = None,
    ) -> Outcome:
        """Run tests by name up to the first that fails; with a plugin, all of them, and then `after()`."""
        start = time.monotonic()
        with tempfile.TemporaryDirectory() as scratch:
            log = Path(scratch) / "log"
            child = os.fork()
            if child == 0:
                _child(self.path, tests, log, cache or self.cache, cpu_s, plugin, after)
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
        before, stat = path.read_text(), path.stat()
        source = before[: before.rindex("# -")]
        self._write(mutant.path, mutant.applied(source), size=stat.st_size)
        os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
        try:
            if not mutant.kernel:
                return self.run(tests, cpu_s=GRACE_S + 4.0 * usual_s)
            with self._cache_without(mutant.path) as cache:
                return self.run(tests, cpu_s=GRACE_S + COMPILE_S + 4.0 * usual_s, cache=cache)
        finally:
            path.write_text(before)
            os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))

    @contextlib.contextmanager
    def _cache_without(self, path: str) -> Any:
        """A cache of links to the kernels that cannot hold anything of a module."""
        stale = {Path(name).stem for name in self._users(path)}
        with tempfile.TemporaryDirectory(dir=self.cache.parent) as folder:
            for entry in self.cache.rglob("*.*"):
                if entry.is_file() and entry.name.split(".", 1)[0] not in stale:
                    target = Path(folder) / entry.relative_to(self.cache)
                    target.parent.mkdir(parents=True, exist_ok=True)
                    os.link(entry, target)
            yield Path(folder)

    def _users(self, path: str) -> set[str]:
        """A module and all that import it, directly or through others."""
        found, todo = {path}, [path]
        while todo:
            name = todo.pop()
            more = {user for user, used in self._imports.items() if name in used} - found
            found |= more
            todo += more
        return found

    @cached_property
    def _imports(self) -> dict[str, set[str]]:
        return {
            str(path.relative_to(self.path)): {f"{name.replace('.', '/')}.py" for name in imported(path)}
            for folder in OURS
            for path in (self.path / folder).rglob("*.py")
        }


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
        import numba

        numba.config.CACHE_DIR = str(cache)
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
