"""The page about parts: its code runs, and its table names existing things."""

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


def test_the_table_names_each_check_and_where_its_contract_is():
    rows = re.findall(r"^\| [a-z ]+ \| .*\| `([\w/]+\.py)` \| `(\w+)` \|", PAGE, re.M)
    assert {check for _, check in rows} == {name for name in testing.__all__ if name.startswith("check")}
    for file, check in rows:
        contract = re.search(
            r"`turtlebag\.([\w.]+)\.(\w+)`", " ".join(getattr(testing, check).__doc__.split())
        )
        assert contract[1].replace(".", "/") + ".py" == file
        assert f"class {contract[2]}(Protocol)" in (DOCS.parent / file).read_text()
