"""Tests know the house by its doors: what they replace for a while lies outside of it.

That they import no private name and touch no private attribute is ruff's (PLC2701 and SLF001).
"""

import ast
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
BORDERS = {
    *("builtins", "io", "os", "pathlib", "pooch", "shutil", "sys", "tempfile"),  # files, streams, processes
    *("signal", "subprocess", "time"),
    *("fsspec", "socket", "tornado", "urllib", "webbrowser"),  # network
    *("logging", "matplotlib", "pybullet"),
}
"""Packages whose functions a test may replace: clock, files, network, and others' libraries."""
REPLACE = {"setattr", "delattr", "setitem", "delitem"}


def origins(tree: ast.AST) -> dict[str, str]:
    """What each imported name of a file stands for, in full."""
    names: dict[str, str] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {a.asname or a.name.partition(".")[0]: a.name for a in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {a.asname or a.name: f"{node.module}.{a.name}" for a in node.names}
    return names


def first_name(target: ast.expr) -> str:
    """`os` of `os.path`, `logging` of `logging.getLogger("x")`; a string is its own name."""
    while isinstance(target, ast.Attribute | ast.Call | ast.Subscript):
        target = target.func if isinstance(target, ast.Call) else target.value
    if isinstance(target, ast.Name):
        return target.id
    return str(target.value) if isinstance(target, ast.Constant) else ""


def replaced_inside(source: str) -> list[int]:
    """Lines where a test replaces what belongs to no border.

    That a function is handed on, as `monkeypatch.setattr` without its brackets, counts too.
    """
    tree = ast.parse(source)
    names = origins(tree)
    borders = []
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in REPLACE:
            name = first_name(node.args[0])
            if names.get(name, name).partition(".")[0] in BORDERS:
                borders.append(node.func)
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr in REPLACE and node not in borders:
            found.append(node.lineno)
    return sorted(found)


@pytest.mark.parametrize(
    ("source", "lines"),
    [
        ("import time\nmonkeypatch.setattr(time, 'sleep', print)", []),
        ("monkeypatch.setattr('sys.stdin', None)", []),
        ("from pathlib import Path as P\nmonkeypatch.setattr(P, 'rename', print)", []),
        ("import logging\npatch.setattr(logging.getLogger('x'), 'propagate', True)", []),
        ("from turtlebag.datasets import files\n\nmonkeypatch.setattr(files, 'SIZE', 3)", [3]),
        ("from turtlebag import time\nmonkeypatch.setattr(time, 'sleep', print)", [2]),
        ("monkeypatch.setattr('turtlebag.sim.routes.SIZE', 3)", [1]),
        ("def f(thing):\n    monkeypatch.delattr(thing.part, 'name')", [2]),
        ("twice(monkeypatch.setattr)", [1]),
    ],
)
def test_what_a_test_may_replace(source, lines):
    assert replaced_inside(source) == lines


def test_tests_replace_nothing_inside():
    inside = {
        str(path.relative_to(TESTS)): replaced_inside(path.read_text())
        for path in sorted(TESTS.rglob("*.py"))
        if "setattr" in path.read_text() or "item(" in path.read_text()
    }
    assert {path: lines for path, lines in inside.items() if lines} == {}
