"""A run of the tests ends with what it skipped and why."""

import runpy
from pathlib import Path
from types import SimpleNamespace


def test_skipped_tests_are_counted_by_reason():
    reasons = ["Skipped: no Chromium here", "Skipped: no logs here", "Skipped: no Chromium here"]
    reports = [SimpleNamespace(longrepr=("tests/test_x.py", 3, reason)) for reason in reasons]
    expected_to_fail = SimpleNamespace(longrepr="a text")
    lines: list[str] = []
    conftest = runpy.run_path(str(Path(__file__).with_name("conftest.py")))
    conftest["pytest_terminal_summary"](
        SimpleNamespace(getreports=lambda _: [*reports, expected_to_fail], write_line=lines.append)
    )
    assert lines == ["skipped 2: no Chromium here", "skipped 1: no logs here"]
