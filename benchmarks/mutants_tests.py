"""Which tests run which function: measured once by running the tests of a subject, kept as JSON.

numba calls its kernels where no profiler looks. A Python function that names a kernel is taken to call
it, and so is a kernel that names another.
"""

from __future__ import annotations

import ast
import json
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest
from numba.core.event import Event, Listener, register, unregister

from benchmarks.mutants_draw import FOLDERS

# The tests of a subject. Whole runs of the command line, reports and simulator are not among them: a
# mistake has to be found near where it was made.
SUBJECTS = {
    "pipeline/slam": ["slam_*", "online_map"],
    "pipeline/localisation": ["amcl*", "localisation_*", "localise"],
    "planners": [
        "plan", "plan_narrow", "plan_footprint", "plan_motion", "plan_lattice", "plan_live", "plan_guard",
        "plan_tasks", "plan_search", "plan_poses", "costmap", "control", "control_kernels", "control_pursuit",
        "rolling", "frontier", "avoid", "navigate_live", "navigate_stages", "navigate_tasks", "navigate_lost",
        "unused_options",
    ],
    "datasets": [
        "bag_*", "carmen", "carmen_parts", "maps", "recordings", "runlog", "types", "se2", "se3",
        "trajectories", "outputs", "files", "small_files", "kernels", "own_body", "returns",
        "registry", "recordings_*", "area", "slam3d_parts",
    ],
}  # fmt: skip
# A test that takes longer is not asked [s], and of the others as many as fit into this [s] by default.
LONGEST_S, TOGETHER_S = 20.0, 30.0


def subject_files(root: Path, folder: str) -> list[str]:
    """Paths of the test files of a subject, sorted."""
    found = {path for name in SUBJECTS[folder] for path in (root / "tests").rglob(f"test_{name}.py")}
    return sorted(str(path.relative_to(root)) for path in found)


def folder_of(path: str) -> str:
    """The subject a source file belongs to."""
    return next(folder for folder in FOLDERS if path.startswith(f"{folder}/"))


class _Compiling(Listener):
    """Listens to numba: the processor time it takes to compile, during which nothing is profiled."""

    def __init__(self, profile: Any) -> None:
        self.seconds = 0.0
        self._profile, self._depth, self._since = profile, 0, 0.0

    def on_start(self, event: Event) -> None:
        if self._depth == 0:
            sys.setprofile(None)
            self._since = time.process_time()
        self._depth += 1

    def on_end(self, event: Event) -> None:
        self._depth -= 1
        if self._depth == 0:
            self.seconds += time.process_time() - self._since
            sys.setprofile(self._profile)


class Recorder:
    """Pytest plugin: per test its seconds without compiling, whether it passed, the functions it ran."""

    def __init__(self, root: Path) -> None:
        self.prefix = f"{root}/"
        self.rows: dict[str, dict[str, Any]] = {}
        self._seen: set[CodeType] = set()
        self._module: set[CodeType] = set()
        self._file = ""
        self._kernels = _Kernels()

    def _profile(self, frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            self._seen.add(frame.f_code)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        self._seen = set()
        compiling = _Compiling(self._profile)
        start = time.process_time()
        threading.setprofile(self._profile)
        sys.setprofile(self._profile)
        register("numba:compile", compiling)
        try:
            return (yield)
        finally:
            unregister("numba:compile", compiling)
            sys.setprofile(None)
            threading.setprofile(None)
            row = self.rows.setdefault(item.nodeid, {"passed": False})
            row["seconds"] = round(max(time.process_time() - start - compiling.seconds, 0.0), 3)
            # what a fixture of the whole file ran, its other tests depend on, too
            if item.location[0] != self._file:
                self._file, self._module = item.location[0], set()
            row["functions"] = sorted(self._kernels.names(self._seen | self._module, self.prefix))

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Iterator[Any]:
        before = set(self._seen)
        try:
            return (yield)
        finally:
            if fixturedef.scope != "function":
                self._module |= self._seen - before

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call" and report.passed:
            self.rows.setdefault(report.nodeid, {})["passed"] = True


class _Kernels:
    """Follows the names in a function to the kernels behind them."""

    def __init__(self) -> None:
        self._called: dict[CodeType, set[CodeType]] = {}

    def names(self, codes: Iterable[CodeType], prefix: str) -> set[str]:
        """`path:qualified name` of each function of ours among `codes`, and of the kernels they name."""
        todo = [code for code in codes if code.co_filename.startswith(prefix)]
        done: set[CodeType] = set()
        while todo:
            code = todo.pop()
            if code not in done:
                done.add(code)
                todo.extend(self._of(code, prefix))
        return {f"{c.co_filename.removeprefix(prefix)}:{c.co_qualname}" for c in done}

    def _of(self, code: CodeType, prefix: str) -> set[CodeType]:
        if code not in self._called:
            module = next(
                (m for m in list(sys.modules.values()) if getattr(m, "__file__", "") == code.co_filename),
                None,
            )
            kernels = (getattr(getattr(module, name, None), "py_func", None) for name in code.co_names)
            found = {k.__code__ for k in kernels if k is not None}
            self._called[code] = {c for c in found if c.co_filename.startswith(prefix)}
        return self._called[code]


def chosen(
    table: dict[str, dict[str, Any]], path: str, function: str, together_s: float = TOGETHER_S
) -> list[str]:
    """Tests that run a function, as many as fit into the time: of files that import its module, the quickest
    first, then the others."""
    name, own = f"{path}:{function}", folder_of(path)
    module = "turtlebag." + path.removesuffix(".py").replace("/", ".")
    runs = [
        (module not in row["imports"], row["seconds"], test)
        for test, row in table.items()
        if own in row["subjects"]
        and row["passed"]
        and name in row["functions"]
        and row["seconds"] <= LONGEST_S
    ]
    tests, total = [], 0.0
    for _, seconds, test in sorted(runs):
        total += seconds
        if tests and total > together_s:
            break
        tests.append(test)
    return tests


def imported(path: Path) -> set[str]:
    """Modules that a file imports names from."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def load(path: Path) -> dict[str, dict[str, Any]]:
    """The table of tests measured before; empty when there is none."""
    return json.loads(path.read_text()) if path.exists() else {}
