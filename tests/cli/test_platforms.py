"""Where packages have no wheel: what needs none of them works, what does ends in one line."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.helpers.slam_rooms import around_the_room
from tests.studio.room_bag import write_bag
from turtlebag.pipeline.cli import doctor
from turtlebag.pipeline.setup.missing_package import WITHOUT
from turtlebag.pipeline.studio.setup import BagSetup

ROOT = Path(__file__).parents[2]
START = ",".join(f"{value:.4f}" for value in around_the_room(150)[0])
WORKS = {
    "bag info one": 0,
    "bag doctor one": 0,
    "map one --out map": 0,
    f"localise one --map map/map.yaml --initial-pose={START} --out localised": 0,
    "plan --map map/map.yaml --robot burger --start 5,3,0 --goal 1.5,3,0 --planner lattice --out path": 0,
    "plan --map map/map.yaml --start 5,3,0 --goal 1.5,3,0 --planner lattice --compare --out paths": 0,
    "report map localised path --no-animation --out report": 0,
    "studio --replay session.yaml --out studio": 0,
    "identify one --out robot": 0,
    "doctor": 1,
}
NEEDS = {
    "plan --map map/map.yaml --start 5,3,0 --goal 1.5,3,0 --out none": ("ompl", "--set plan.planner=lattice"),
    "map one --set front_end=kiss_icp --out none": (
        "kiss_icp",
        "3D maps and the odometry of KISS-ICP are off",
    ),
    **{
        f"{command} --out none": ("pybullet", "record, navigate and studio --world are off")
        for command in (
            "record --world empty --teleop tour --seed 1",
            "navigate --world empty --task avoid",
            "studio --world empty --no-browser",
        )
    },
}
IN_TURN = """
import json, sys
commands, hidden = map(json.loads, sys.argv[1:])
sys.modules |= dict.fromkeys(hidden)
from turtlebag.pipeline.__main__ import run
for words in commands:
    print("$", words, flush=True)
    print("$", words, file=sys.stderr, flush=True)
    sys.argv = ["turtlebag", *words.split()]
    print("exit", run(), flush=True)
"""


def told(stream):
    """What each command said, by the command."""
    parts = stream.split("$ ")[1:]
    return {words: said.splitlines() for words, _, said in (part.partition("\n") for part in parts)}


@pytest.fixture(scope="module")
def without(tmp_path_factory):
    """All commands where no package of `WITHOUT` can be imported: their folder, output and errors."""
    folder = tmp_path_factory.mktemp("without")
    header = BagSetup(write_bag(folder / "one")).header().model_dump()
    inputs = [{"at": 0.5, "do": "map_build"}, {"at": 1.0, "do": "end"}]
    (folder / "session.yaml").write_text(yaml.safe_dump({**header, "inputs": inputs}))
    done = subprocess.run(
        [sys.executable, "-c", IN_TURN, json.dumps([*WORKS, *NEEDS]), json.dumps(list(WITHOUT))],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return folder, told(done.stdout), told(done.stderr)


@pytest.mark.slow
@pytest.mark.parametrize("command", WORKS)
def test_what_needs_no_package_without_a_wheel_works_without_it(without, command):
    _, output, errors = without
    assert output[command][-1] == f"exit {WORKS[command]}", errors[command]


@pytest.mark.slow
@pytest.mark.parametrize("command", NEEDS)
def test_what_needs_one_ends_in_a_line_that_says_what_there_is_instead(without, command):
    folder, output, errors = without
    package, remedy = NEEDS[command]
    assert output[command] == ["exit 2"]
    line = errors[command][-1]
    assert "Traceback" not in "".join(errors[command])
    assert line.startswith(f"turtlebag: the package {package} is missing")
    assert remedy in line
    assert not (folder / "none").exists()


@pytest.mark.slow
def test_the_outputs_without_these_packages_are_whole(without):
    folder, output, errors = without
    assert json.loads((folder / "map/metrics.json").read_text())["self_check"]["verdict"] == "good"
    for name in ("path", "paths"):
        assert len(np.loadtxt(folder / name / "path.csv", delimiter=",", skiprows=1)) > 10
    assert (folder / "paths/path-lattice.csv").read_text() == (folder / "paths/path.csv").read_text()
    compared = next(command for command in errors if "--compare" in command)
    assert "the planners of OMPL are left out" in "\n".join(errors[compared])
    assert (folder / "report/index.html").exists()
    missing = [line.split()[1] for line in output["doctor"] if line.startswith(("MISSING", "off"))]
    assert {name.replace("-", "_") for name in missing} == set(WITHOUT)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("package", "command", "said"),
    [
        ("pydantic", "record --world empty --teleop tour --seed 1 --out path", "installs them"),
        ("libusb_package", "doctor", "-> make -B setup"),
    ],
)
def test_a_package_that_is_not_there_is_named_with_what_installs_it(tmp_path, package, command, said):
    done = subprocess.run(
        [sys.executable, "-c", IN_TURN, json.dumps([command]), json.dumps([package])],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert any(package in line and said in line for line in (done.stdout + done.stderr).splitlines())
    assert list(tmp_path.iterdir()) == []


def test_doctor_says_what_is_off_where_a_platform_has_no_wheel(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pybullet", None)
    assert doctor.report({name: doctor.CHECKS[name] for name in ("python", "pybullet")}, whole=False) == 0
    line = capsys.readouterr().out.splitlines()[1]
    assert line.split()[:2] == ["off", "pybullet"]
    assert "record, navigate and studio --world are off" in line
