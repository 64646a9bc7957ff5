"""What make does with the outputs of a task that failed."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCES = ("sim", "datasets", "planners", "pipeline/slam", "pipeline/slam3d", "reports/metrics")
FAILING = """#!/bin/sh
echo run >> calls
mkdir -p mine && echo '{}' > mine/manifest.json
exit 1
"""


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        (
            ("navigate", "TASK=avoid"),
            "navigate --force --world turtlebot3_world --robot burger --task avoid --seed 1 --out mine",
        ),
        (("map", "BAG=sim"), "map sim --force --out mine"),
    ],
)
def test_a_failed_task_keeps_its_outputs_and_is_done_again_when_asked_again(tmp_path, asked, told):
    for name in (*SOURCES, "pipeline/stages", ".venv"):
        (tmp_path / name).mkdir(parents=True)
    for name in ("Makefile", "requirements.lock", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path / name)
    (tmp_path / ".venv/.ready").touch()
    (tmp_path / "sim/source.py").touch()
    (tmp_path / "pipeline/stages/settings.py").touch()
    (tmp_path / "failing").write_text(FAILING)
    (tmp_path / "failing").chmod(0o755)
    hidden = ("MAKE", "MFLAGS")
    environment = {name: value for name, value in os.environ.items() if not name.startswith(hidden)}
    for runs in (1, 2):
        done = subprocess.run(
            ["make", *asked, "OUT=mine", "TURTLEBAG=./failing"],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=20,
        )
        assert done.returncode == 2, done.stderr
        assert done.stdout.split("\n")[0] == f"./failing {told}"
        assert "||" not in done.stdout
        assert (tmp_path / "calls").read_text() == "run\n" * runs
        # Without a manifest --force would not replace it.
        assert (tmp_path / "mine/manifest.json").exists()
