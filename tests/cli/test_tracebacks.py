"""What once ended in a traceback, or left a file open: one line, exit 2, and all files closed."""

import gc
import os
import shutil
import subprocess
import sys
import warnings

import pytest

from tests.helpers.bag_samples import write_drive
from tests.helpers.report_fakes import fake_record
from tests.helpers.ros1_bags import to_ros1_bag
from turtlebag.pipeline.cli.main import main


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    return fake_record(tmp_path_factory.mktemp("stages") / "record")


@pytest.mark.parametrize("content", [b"a: [", b"7", b"", b"\xff\xfe", b"\0", b"- 1", b"a: &a [*a]"])
@pytest.mark.parametrize("name", ["config.yaml", "bag/metadata.yaml"])
def test_a_report_names_the_file_of_an_input_that_is_damaged(record, tmp_path, capsys, name, content):
    shutil.copytree(record, tmp_path / "record")
    (tmp_path / "record" / name).write_bytes(content)
    assert main(["report", str(tmp_path / "record"), "--out", str(tmp_path / "out"), "-q"]) == 2
    said = capsys.readouterr().err
    assert f"record/{name}" in said
    assert said.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("speed", ["v: 1.0e+300", "w: -1.0e+9", "v: .nan", "v: .inf"])
def test_a_session_is_driven_at_speeds_that_the_page_can_ask_for(tmp_path, capsys, speed):
    path = tmp_path / "session.yaml"
    path.write_text(
        f"version: 1\nworld: empty\nrobot: burger\nseed: 1\ninputs:\n- {{begin: 0, end: 1, {speed}}}\n"
    )
    assert main(["studio", "--replay", str(path), "--out", str(tmp_path / "out")]) == 2
    assert f"session.yaml: input 1: {speed[0]}: must be" in capsys.readouterr().err


def test_a_world_may_be_called_anything(tmp_path):
    path = tmp_path / "a.yaml"
    ball = "kind: cylinder, center: [2, 0], radius: 0.1, z: [0, 1]"
    path.write_text(f'name: "$\\\\frac{{$ <b> \\e[2J"\nspawn: [0, 0, 0]\nshapes: [{{{ball}}}]\n')
    assert main(["world", "show", str(path), "--out", str(tmp_path / "a.png")]) == 0


@pytest.mark.slow
@pytest.mark.parametrize("setting", ["NUMBA_NUM_THREADS=x", "NUMBA_OPT=9"])
def test_a_variable_that_numba_cannot_use_is_one_line(tmp_path, setting):
    name, _, value = setting.partition("=")
    words = ["world", "show", "empty", "--out", str(tmp_path / "a.png")]
    done = subprocess.run(
        [sys.executable, "-m", "turtlebag", *words], env={**os.environ, name: value}, capture_output=True
    )
    said = done.stderr.decode()
    assert (done.returncode, said.count("\n")) == (2, 1)
    assert said.startswith("turtlebag: numba: ")
    assert "NUMBA_" in said


def test_every_file_of_a_bag_is_closed(tmp_path, capsys):
    write_drive(tmp_path / "bag", seconds=1.0)
    to_ros1_bag(tmp_path / "bag", tmp_path / "a.bag")
    subprocess.run(["gzip", "-k", str(tmp_path / "a.bag")], check=True)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", ResourceWarning)
        for path in ("bag", "a.bag", "a.bag.gz"):
            for verb in ("info", "doctor"):
                assert main(["bag", verb, str(tmp_path / path)]) in (0, 1)
        gc.collect()
    assert [str(one.message) for one in told] == []
