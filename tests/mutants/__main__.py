"""Of a sample of small mistakes that cosmic-ray makes in a copy of the tree, how many do the tests notice?"""

import os
import random
import re
import resource
import shutil
import sys
from pathlib import Path

from cosmic_ray.commands import init
from cosmic_ray.mutating import mutate_and_test
from cosmic_ray.testing import run_tests
from cosmic_ray.work_db import use_db
from cosmic_ray.work_item import TestOutcome

from benchmarks.runner import ROOT, interval

FOLDERS = ("pipeline/slam", "pipeline/localisation", "planners", "datasets")
# Code that deletes or fetches is not handed a mistake on anybody's machine.
DANGEROUS = re.compile(r"rmtree|unlink\(|\.rename\(|os\.replace|pooch|output_lock")
# These change nothing: a kernel without njit, `X | None` in an annotation.
NOTHING = re.compile("RemoveDecorator|BinaryOperator_BitOr")
TIMEOUT_S, MEMORY = 1200.0, 8 << 30
# What is imported as `turtlebag.planners` is the copy's folder `planners`, and not what is installed.
PACKAGE = "up = __file__[: -len('/turtlebag/__init__.py')]\n__path__ = [up, up + '/pipeline/turtlebag']\n"


def drawn(seed, count):
    """Mistakes within functions, more in longer files, each with the tests that import its module."""
    rng = random.Random(seed)
    paths = sorted(path for folder in FOLDERS for path in Path(folder).rglob("*.py"))
    paths = [path for path in paths if not DANGEROUS.search(path.read_text())]
    for path in rng.choices(paths, [path.stat().st_size for path in paths], k=count):
        with use_db(":memory:") as session:
            init([path], session, {})
            found = [item.mutations[0] for item in session.work_items]
        found = [one for one in found if one.definition_name and not NOTHING.search(one.operator_name)]
        module = "turtlebag." + ".".join(path.with_suffix("").parts)
        files = [str(file) for file in sorted(Path("tests").rglob("test_*.py")) if module in file.read_text()]
        if found and files:
            mutation = rng.choice(sorted(found, key=lambda one: (one.operator_name, one.occurrence)))
            yield mutation, " ".join([sys.executable, "-m pytest -x", *files])


def main(seed, count):
    tree = ROOT / "data/mutants/tree"
    shutil.rmtree(tree, ignore_errors=True)
    shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(".git", ".venv", "data", "dist", "__pycache__"))
    (tree / "turtlebag").mkdir()
    (tree / "turtlebag/__init__.py").write_text(PACKAGE)
    os.chdir(tree)
    os.environ |= {"PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(tree.parent), "OMP_NUM_THREADS": "1"}
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    killed = total = 0
    for mutation, tests in drawn(seed, count):
        if run_tests(tests, TIMEOUT_S)[0] != TestOutcome.SURVIVED:
            sys.exit(f"fails without any mistake: {tests}")
        result = mutate_and_test([mutation], tests, TIMEOUT_S)
        killed, total = killed + result.is_killed, total + 1
        print("killed" if result.is_killed else "survived", result.diff, sep="\n", flush=True)
    low, high = interval(killed, total)
    print(f"{killed} of {total} killed (95 % interval {low:.0%} to {high:.0%})")


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
