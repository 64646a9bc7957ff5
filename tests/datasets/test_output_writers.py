"""One process at a time writes an output; what one that was killed left, and inputs that change meanwhile."""

import signal
import subprocess
import sys

import pytest

from tests.helpers.output_folders import folder_with, ours, state, write
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.output_lock import lock_output
from turtlebag.datasets.output_rules import MARKER
from turtlebag.datasets.outputs import staged_output
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.terminal.messages import set_verbosity, verbosity_kept

GROW = """
import pathlib, sys
from turtlebag.datasets.outputs import staged_output
with staged_output(pathlib.Path(sys.argv[1]), force="force" in sys.argv) as folder:
    (folder / "a").write_text("whole")
    print("growing", flush=True)
    sys.stdin.readline()
"""


@pytest.fixture
def growing(tmp_path):
    """Another process that writes `out` and waits for a line."""
    with subprocess.Popen(
        [sys.executable, "-c", GROW, str(tmp_path / "out")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "growing\n"
        yield process
        process.kill()


@pytest.mark.parametrize("force", [False, True])
def test_the_second_writer_is_refused_and_the_first_is_whole(tmp_path, growing, force):
    with (
        pytest.raises(InputError, match="another process is writing it"),
        lock_output(tmp_path / "." / "out", force=force),
    ):
        pass
    growing.communicate("\n")
    assert growing.returncode == 0
    assert state(tmp_path).keys() == {"out", "out/a"}


def test_an_unfinished_recording_is_not_recovered_under_its_writer(tmp_path, growing, capsys):
    words = ["bag", "recover", str(tmp_path / "out.partial"), "--out", str(tmp_path / "out")]
    assert main(words) == 2
    assert "another process is writing it" in capsys.readouterr().err


def test_a_killed_writer_leaves_the_place_to_the_next(tmp_path, growing):
    growing.send_signal(signal.SIGKILL)
    growing.wait()
    assert (tmp_path / "out.partial" / "a").exists()
    with staged_output(tmp_path / "out") as partial:
        assert not (partial / "a").exists()
        (partial / "b").write_text("b")
    assert state(tmp_path).keys() == {"out", "out/b"}


def test_a_command_that_is_refused_leaves_what_a_killed_one_left(tmp_path, growing):
    growing.kill()
    growing.wait()
    assert main(["map", str(tmp_path / "none"), "--out", str(tmp_path / "out")]) == 2
    assert (tmp_path / "out.partial" / "a").exists()


def test_where_a_killed_session_went_is_said_to_q_too(tmp_path, growing, capsys):
    growing.kill()
    growing.wait()
    (tmp_path / "out.partial" / "session.yaml").write_text("version: 1\n")
    with verbosity_kept():
        set_verbosity(-1)
        with staged_output(tmp_path / "out"):
            pass
    assert f"is now in {tmp_path / 'out.unfinished'} " in capsys.readouterr().err
    assert (tmp_path / "out.unfinished" / "session.yaml").exists()


def test_what_a_killed_process_had_replaced_is_removed_by_the_next_and_no_earlier(tmp_path):
    left = ours(tmp_path / "out.old-0123abcd")
    (left / MARKER).write_text("turtlebag\n")
    folder_with("thesis.tex", "years")(tmp_path / "out.old-mine")
    with staged_output(tmp_path / "out"):
        assert left.exists()
    assert not left.exists()
    assert (tmp_path / "out.old-mine" / "thesis.tex").exists()


def test_an_input_that_changes_ends_the_command_and_leaves_nothing(tmp_path):
    read = tmp_path / "in"
    read.mkdir()
    for change in (
        lambda: (read / "a").write_text("longer"),
        lambda: (read / "a").unlink(),
        lambda: (read / "b").write_text("new"),
        lambda: (tmp_path / "other").replace(read / "a"),
    ):
        (read / "a").write_text("a")
        (tmp_path / "other").write_text("a")
        with pytest.raises(InputError, match="changed while it was read"):
            write(tmp_path / "out", [read], change)
        assert not (tmp_path / "out").exists()
        assert not (tmp_path / "out.partial").exists()
        (read / "b").unlink(missing_ok=True)
