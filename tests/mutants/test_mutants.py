"""The mutation run: what it draws, and that it tells the ends of a run apart."""

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from tests.mutants.__main__ import Tree, report
from tests.mutants.draw import FOLDERS, draw, mutants_by_line

ROOT = Path(__file__).parents[2]
SOURCE = '''
def area(a: float, b: float = 2.0) -> float:
    """a * b"""
    if len("x") < 2 and not a > b:
        raise ValueError(f"{a} - {b}")
    return a * b - area.least(b, a)

LIMIT = 3.0
'''


def edits(source):
    return {
        mutant.key.partition(" => ")[2]
        for line in mutants_by_line(source, "planners/a.py")
        for mutant in line
    }


def test_mistakes_are_made_in_what_functions_do_and_not_in_words_types_or_settings():
    found = edits(SOURCE)
    assert found >= {
        "return a / b - area.least(b, a)",
        "return a * b + area.least(b, a)",
        "return a * b - area.least(a, b)",
        "return a - area.least(b, a)",
        "if len('x') <= 2 and not a > b:",
        "if len('x') >= 2 and not a > b:",
        "if len('x') < 2 or not a > b:",
        'if len("x") < 2 and a > b:',
        'if len("x") < 2 and not a <= b:',
        'if len("x") < 3 and not a > b:',
    }
    assert not any(word in edit for edit in found for word in ("raise", "LIMIT", '"""', "float"))


def test_the_same_seed_draws_the_same_mutants_and_kernels_get_their_share(tmp_path):
    deleting = [f"datasets/{name}.py" for name in ("outputs", "output_lock", "output_rules")]
    for name in ("planners/footprint.py", "planners/costmap.py", "datasets/se2.py", *deleting):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    drawn = draw(tmp_path, 5, 20)
    assert draw(tmp_path, 5, 10) == drawn[:10]
    assert {mutant.key for mutant in drawn} != {mutant.key for mutant in draw(tmp_path, 6, 20)}
    assert sum(mutant.kernel for mutant in drawn) == 6
    # what deletes folders, or says which, is left alone
    assert not any(mutant.path in deleting for mutant in drawn)
    for mutant in drawn:
        source = (ROOT / mutant.path).read_text()
        pairs = zip(source.splitlines(), mutant.applied(source).splitlines(), strict=True)
        assert sum(before != after for before, after in pairs) == 1


@pytest.fixture
def tree(tmp_path):
    """A tree of one function and its test, below git."""
    root = tmp_path / "root"
    for folder in (*FOLDERS, "tests"):
        (root / folder).mkdir(parents=True)
    (root / "planners/__init__.py").touch()
    (root / "planners/a.py").write_text(
        "from time import sleep\n\n\ndef double(x: int) -> int:\n    n = 0\n    while x > 0:\n"
        "        sleep(0.01)  # what never ends takes no time of those beside it\n"
        "        n, x = n + 2, x - 1\n    return n\n"
    )
    (root / "tests/planners").mkdir()
    (root / "tests/planners/test_a.py").write_text(
        "from turtlebag.planners.a import double\n\ndef test_double():\n    assert double(3) == 6\n"
    )
    (root / "tests/planners/test_b.py").write_text("def test_beside():\n    assert 2 + 2 == 4\n")
    (root / "pyproject.toml").write_text('[tool.pytest.ini_options]\nmarkers = ["slow"]\n')
    subprocess.run(["git", "init", "-q"], cwd=root, check=True)
    return Tree(root, tmp_path / "home")


def test_the_tests_that_import_the_module_are_asked_first_and_then_the_quick_ones_beside(tree):
    near, beside = tree.tests_of("planners/a.py")
    assert near == (["tests/planners/test_a.py"], "")
    assert beside == (["tests/planners/test_b.py"], "not slow")


def test_where_no_test_of_the_subject_imports_the_module_those_elsewhere_are_asked(tree):
    (tree.path / "tests/slam").mkdir()
    (tree.path / "tests/planners/test_a.py").rename(tree.path / "tests/slam/test_a.py")
    assert tree.tests_of("planners/a.py")[0] == (["tests/slam/test_a.py"], "")


@pytest.mark.slow
def test_what_fails_what_hangs_and_what_passes_are_told_apart(tree, monkeypatch):
    monkeypatch.setattr("tests.mutants.__main__.GRACE_S", 1.0)
    monkeypatch.setattr("tests.mutants.__main__.PATIENCE", 3.0)
    source = (tree.path / "planners/a.py").read_text()
    lines = mutants_by_line(source, "planners/a.py")
    by_edit = {mutant.key.partition(" => ")[2]: mutant for line in lines for mutant in line}
    wrong, endless = by_edit["n, x = n + 3, x - 1"], by_edit["n, x = n + 2, x + 1"]
    caught = tree.judge(wrong)
    assert caught["verdict"] == "failed"
    assert caught["by"] == "tests/planners/test_a.py::test_double"
    assert tree.judge(endless)["verdict"] == "timeout"
    assert tree.judge(replace(wrong, text="2"))["verdict"] == "survived"
    assert (tree.path / "planners/a.py").read_text() == source


@pytest.mark.slow
def test_kernels_compiled_of_a_mutant_do_not_take_the_place_of_the_whole_ones(tree):
    """Or the next run would have to compile again within its time."""
    keeping = (
        "import os\nfrom pathlib import Path\n\n\ndef test_keeping():\n    source = Path('planners/a.py')\n"
        "    place = Path(os.environ['NUMBA_CACHE_DIR'])\n    place.mkdir(exist_ok=True)\n"
        "    (place / 'a.nbc').write_text(source.read_text())\n"
    )
    (tree.path / "tests/planners/test_a.py").write_text(f"import turtlebag.planners.a\n{keeping}")
    source = (tree.path / "planners/a.py").read_text()
    mutant = mutants_by_line(source, "planners/a.py")[0][0]
    assert tree.judge(mutant)["verdict"] == "survived"
    assert (tree.kernels / "a.nbc").read_text() == source


def test_the_score_leaves_out_what_changes_nothing():
    def row(key, verdict):
        return {
            "case": f"planners/a.py:f: {key}",
            "kind": "name",
            "kernel": False,
            "verdict": verdict,
        }

    rows = [row("a", "failed"), row("b", "timeout"), row("c", "survived"), row("d", "survived")]
    text = report(rows, {"planners/a.py:f: d": "the same number"})
    assert text.startswith("2 of 3 caught: 67% (95 % interval 21% to 94%)")
    assert "1 of 4 drawn change nothing" in text
    assert "survived: planners/a.py:f: c" in text
