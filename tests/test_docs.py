"""Every command in the docs does what they say, in the order they say it."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = sorted((Path(__file__).parents[1] / "docs").glob("*.md"))


def commands(text: str) -> list[tuple[str, int]]:
    """Lines of the ```sh blocks, with the exit code that a trailing `# exit N` promises."""
    lines = [line for block in re.findall(r"```sh\n(.*?)```", text, re.S) for line in block.splitlines()]
    return [(line, int((re.findall(r"# exit (\d)$", line) or ["0"])[0])) for line in lines if line.strip()]


@pytest.mark.parametrize(
    "page", [page for page in DOCS if commands(page.read_text())], ids=lambda page: page.stem
)
def test_the_commands_of_a_page_run_as_written(page, tmp_path):
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    for line, expected in commands(page.read_text()):
        done = subprocess.run(
            line, shell=True, cwd=tmp_path, env={**os.environ, "PATH": path}, capture_output=True, text=True
        )
        assert done.returncode == expected, f"{line}\n{done.stderr[-2000:]}"
        assert "Traceback" not in done.stderr


def test_the_pages_of_the_documentation_exist():
    assert {page.stem for page in DOCS} >= {"tutorial", "architecture", "files"}
