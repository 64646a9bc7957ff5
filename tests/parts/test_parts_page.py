"""The page about parts: its code runs, and its table names existing things."""

import importlib
import inspect
import re
import sys
from pathlib import Path

import pytest

from turtlebag import testing

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "parts.md").read_text()


@pytest.fixture
def examples(monkeypatch):
    """The examples in the path of modules, and out of it again."""
    monkeypatch.setattr(sys, "path", [str(DOCS / "examples"), *sys.path])


@pytest.mark.slow
def test_the_code_of_the_page_runs(examples):
    (block,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
    exec(compile(block, "parts.md", "exec"), {})


def contracts():
    """The Protocols that the checks name."""
    for check in (name for name in testing.__all__ if name.startswith("check")):
        doc = " ".join(getattr(testing, check).__doc__.split())
        module, name = re.search(r"`(turtlebag\.[\w.]+)\.(\w+)`", doc).groups()
        yield getattr(importlib.import_module(module), name)


def test_all_that_the_methods_of_a_contract_take_has_a_type():
    open_to_anything = [
        f"{contract.__name__}.{method}: {argument.name}"
        for contract in contracts()
        for method, function in vars(contract).items()
        if inspect.isfunction(function) and function.__module__ == contract.__module__
        for argument in [*inspect.signature(function).parameters.values()][1:]
        if argument.annotation in ("Any", inspect.Parameter.empty)
    ]
    assert not open_to_anything


def test_the_table_names_each_check_and_where_its_contract_is():
    rows = re.findall(r"^\| [a-z ]+ \| .*\| `([\w/]+\.py)` \| `(\w+)` \|", PAGE, re.M)
    assert {check for _, check in rows} == {name for name in testing.__all__ if name.startswith("check")}
    for file, check in rows:
        contract = re.search(
            r"`turtlebag\.([\w.]+)\.(\w+)`", " ".join(getattr(testing, check).__doc__.split())
        )
        assert contract[1].replace(".", "/") + ".py" == file
        assert f"class {contract[2]}(Protocol)" in (DOCS.parent / file).read_text()
