"""Small mistakes made in the code one at a time: how many do the tests of its subject notice?

python -m tests.mutants [--seed 1] [--count 100] [--survivors] [--out DIR]

Every mutant is tried in a copy of the tree: first on the test files that import its module, then on the quick
tests of the others in the same folder of `tests`. A row is written as soon as it is known, and the same
command goes on from there; `--survivors` tries only those again that nothing noticed. Mutants that change
nothing that matters are listed in equivalent.yaml with the reason, and do not count.
"""

from __future__ import annotations

import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import yaml

from benchmarks.runner import ROOT, Rows, interval, options
from tests.mutants.draw import FOLDERS, Mutant, draw

EQUIVALENT = Path(__file__).with_name("equivalent.yaml")
CAUGHT = ("failed", "timeout")
GRACE_S, COMPILE_S = 20.0, 150.0
"""Processor time of a run besides four times that of its tests, and what compiling a mutated kernel takes."""
PATIENCE = 10.0
"""Seconds by the clock that a run may take for each of processor time, which it may share with others."""
MEMORY = 8 << 30
# What is imported as `turtlebag.planners` is the copy's folder `planners`, and not what is installed.
PACKAGE = "from pathlib import Path\n\n__path__ = [str(Path(__file__).parents[1])]\n"
Tests = tuple[list[str], str]
"""Test files, and pytest's expression of the marks that are run."""


class Tree:
    """A copy of the sources and tests that mistakes are made in, with a kernel cache of its own."""

    def __init__(self, root: Path, home: Path) -> None:
        self.path, self.kernels, self._log = home / "tree", home / "kernels", home / "pytest.log"
        self.kernels.mkdir(parents=True, exist_ok=True)
        self._environment = {
            **os.environ, "NUMBA_CACHE_DIR": str(self.kernels), "PYTHONPATH": str(self.path),
            "PYTHONDONTWRITEBYTECODE": "1", "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
        }  # fmt: skip
        self._usual: dict[str, float] = {}
        for left in (self.path, self.kernels.with_name("whole")):
            shutil.rmtree(left, ignore_errors=True)
        listing = ["git", "ls-files", "-co", "--exclude-standard"]
        for name in subprocess.check_output(listing, cwd=root, text=True).splitlines():
            if (root / name).is_file():
                (self.path / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(root / name, self.path / name)
        (self.path / "turtlebag").mkdir(parents=True)
        (self.path / "turtlebag/__init__.py").write_text(PACKAGE)

    def tests_of(self, path: str) -> list[Tests]:
        """The test files that import a module, and the quick tests of the others of its subject.

        Where no test of the subject imports it, those elsewhere that do.
        """
        folder = next(folder for folder in FOLDERS if path.startswith(f"{folder}/"))
        files = sorted((self.path / "tests" / Path(folder).name).rglob("test_*.py"))
        package, name = path.removesuffix(".py").replace("/", ".").rpartition(".")[::2]
        module = re.compile(rf"turtlebag\.{package}(\.{name}\b| import .*\b{name}\b)")
        near = [file for file in files if module.search(file.read_text())]
        if not near:
            everywhere = sorted((self.path / "tests").rglob("test_*.py"))
            near = [file for file in everywhere if module.search(file.read_text())]
        parts = ((near, ""), ([file for file in files if file not in near], "not slow"))
        return [([str(file.relative_to(self.path)) for file in part], mark) for part, mark in parts if part]

    def run(self, tests: Tests, cpu_s: float) -> tuple[str, str]:
        """How a run of tests ended (survived, failed, timeout), and the first test that failed."""
        files, mark = tests
        options = ("-x", "-rfE", "--tb=no", "--assert=plain", "-m", mark)
        command = [sys.executable, "-m", "pytest", *options, *files]
        with self._log.open("w") as log:
            child = subprocess.Popen(
                command, cwd=self.path, env=self._environment, stdout=log, stderr=log,
                start_new_session=True, preexec_fn=lambda: _limited(cpu_s),
            )  # fmt: skip
            try:
                code = child.wait(PATIENCE * cpu_s)
            except subprocess.TimeoutExpired:
                os.killpg(child.pid, signal.SIGKILL)
                code = child.wait()
        if code < 0:  # too slow, or it crashed the interpreter
            return "timeout", ""
        told = re.search(r"^(?:FAILED|ERROR) (\S+)", self._log.read_text(errors="replace"), re.MULTILINE)
        return ("survived" if code in (0, 5) else "failed"), told[1] if told else ""

    def judge(self, mutant: Mutant) -> dict[str, Any]:
        """Whether the tests notice the mutant; the tree is whole again afterwards."""
        path, begun = self.path / mutant.path, time.monotonic()
        source, found = path.read_text(), ("survived", "")
        for tests in self.tests_of(mutant.path):
            usual = self._seconds(tests)
            whole = shutil.copytree(self.kernels, self.kernels.with_name("whole"))
            path.write_text(mutant.applied(source))
            try:
                found = self.run(tests, GRACE_S + COMPILE_S * mutant.kernel + 4.0 * usual)
            finally:
                path.write_text(source)
                shutil.rmtree(self.kernels)  # the mutant's took the place of the others
                whole.rename(self.kernels)
            if found[0] in CAUGHT:
                break
        about = {"kind": mutant.kind, "kernel": mutant.kernel, "seconds": round(time.monotonic() - begun, 1)}
        return {"verdict": found[0], "by": found[1], **about}

    def _seconds(self, tests: Tests) -> float:
        """Seconds that tests take without any mutant; RuntimeError when they fail then."""
        if str(tests) not in self._usual:
            for _ in range(2):  # the first run compiles
                begun = time.monotonic()
                if (found := self.run(tests, 3600.0))[0] != "survived":
                    raise RuntimeError(f"{found[1] or tests[0]} fails without any mutant")
            self._usual[str(tests)] = time.monotonic() - begun
        return self._usual[str(tests)]


def _limited(cpu_s: float) -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (int(cpu_s), int(cpu_s) + 5))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def report(rows: list[dict[str, Any]], equivalent: dict[str, str]) -> str:
    """The score with its interval, by folder and kind, and what survived."""
    counted = [row for row in rows if row["case"] not in equivalent or row["verdict"] in CAUGHT]
    caught = sum(row["verdict"] in CAUGHT for row in counted)
    low, high = interval(caught, len(counted))
    verdicts = Counter(row["verdict"] for row in counted)
    lines = [
        f"{caught} of {len(counted)} caught: {caught / max(1, len(counted)):.0%} "
        f"(95 % interval {low:.0%} to {high:.0%}); "
        f"{', '.join(f'{n} {name}' for name, n in sorted(verdicts.items()))}; "
        f"{len(rows) - len(counted)} of {len(rows)} drawn change nothing that matters",
        "",
    ]
    groups = {folder: [row for row in counted if row["case"].startswith(f"{folder}/")] for folder in FOLDERS}
    groups["numba kernels"] = [row for row in counted if row["kernel"]]
    groups |= {
        kind: [r for r in counted if r["kind"] == kind] for kind in sorted({r["kind"] for r in counted})
    }
    for name, group in groups.items():
        lines.append(f"{name:24}  {sum(row['verdict'] in CAUGHT for row in group)} of {len(group)}")
    return "\n".join([*lines, "", *(f"survived: {r['case']}" for r in counted if r["verdict"] not in CAUGHT)])


def main() -> None:
    parser = options(__doc__, "data/mutants", seed=1, count=100)
    parser.add_argument("--survivors", action="store_true", help="try those again that nothing noticed")
    args = parser.parse_args()
    equivalent = yaml.safe_load(EQUIVALENT.read_text()) or {}
    rows = Rows(args.out / f"seed-{args.seed}.jsonl")
    tree = Tree(ROOT, args.out.resolve())
    skipped = {"kind": "", "kernel": False, "verdict": "equivalent", "by": "", "seconds": 0.0}
    found = []
    for mutant in draw(tree.path, args.seed, args.count):
        row = rows.get(mutant.key)
        again = row is not None and args.survivors and row["verdict"] == "survived"
        if mutant.key in equivalent:
            row = row or {"case": mutant.key, **skipped}
        elif row is None or again:
            row = rows.add(mutant.key, tree.judge(mutant))
            print(f"{row['verdict']:9} {row['seconds']:6.1f} s  {mutant.key}", flush=True)
        found.append(row)
    text = report(found, equivalent)
    (args.out / f"seed-{args.seed}.txt").write_text(text + "\n")
    print(text)


if __name__ == "__main__":
    main()
