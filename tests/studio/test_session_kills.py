"""A session that is interrupted or killed: what is left can be read, recovered and driven again."""

import shutil
import signal
import subprocess
import sys
import time

import pytest
import yaml

from tests.helpers.full_disks import files_below
from tests.studio.walk import differences, silent
from turtlebag.datasets.bags.reader import read_commands
from turtlebag.datasets.errors import Unfinished
from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.stages.studio import replay, studio_output
from turtlebag.pipeline.studio.inputs import Save
from turtlebag.pipeline.studio.journal import Journal, load_session
from turtlebag.pipeline.studio.setup import StudioSetup

pytestmark = pytest.mark.slow

LIVE = """
import sys, time
from pathlib import Path
from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.stages.studio import studio_output
from turtlebag.pipeline.studio.inputs import Drive, Plain, Save
from turtlebag.pipeline.studio.setup import StudioSetup

with studio_output(StudioSetup("turtlebot3_world", seed=1), Output(Path(sys.argv[1])), say=print) as session:
    session.apply(Save(do="record", name="drive"))
    session.apply(Plain(do="avoid"))
    while True:
        if session.stamp_ns > 1e9:
            session.apply(Drive(v=0.1) if session.stamp_ns < 2e9 else Plain(do="release"))
        session.tick()
        time.sleep(0.003)
"""
AGAIN = """
import sys
from pathlib import Path
from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.stages.studio import replay

sys.exit(replay(Path(sys.argv[1]), Output(Path(sys.argv[2])), say=print))
"""


def started(script, *arguments):
    command = [sys.executable, "-c", script, *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def wait_until(session_file, seconds):
    """Until the session says that it has come so far."""
    end = time.monotonic() + 120.0
    while time.monotonic() < end:
        if session_file.exists() and load_session(session_file).until_ns >= seconds * 1e9:
            return
        time.sleep(0.05)
    raise AssertionError("the session does not get on")


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """What a kill -9 has left of a live session."""
    out = tmp_path_factory.mktemp("killed") / "live"
    process = started(LIVE, out)
    wait_until(out.with_name("live.partial") / "session.yaml", 4.0)
    process.kill()
    process.wait()
    return out.with_name("live.partial")


def test_of_a_killed_session_at_most_a_second_is_lost(killed, tmp_path):
    assert not killed.with_name("live").exists()
    assert main(["bag", "recover", str(killed / "bags/drive"), "--out", str(tmp_path / "saved")]) == 0
    recovered = read_commands(tmp_path / "saved/bag")
    assert replay(killed / "session.yaml", Output(tmp_path / "again"), say=silent) == 0
    again = read_commands(tmp_path / "again/bags/drive")
    assert abs(recovered[0][-1] - again[0][-1]) <= 1.1e9
    count = min(len(recovered[0]), len(again[0]))
    for one, other in zip(recovered, again, strict=True):
        assert one[:count].tolist() == other[:count].tolist()
    assert replay(tmp_path / "again/session.yaml", Output(tmp_path / "third"), say=silent) == 0
    assert differences(tmp_path / "again", tmp_path / "third") == []


def test_what_is_left_of_a_session_is_set_aside_by_the_next(killed, tmp_path, caplog):
    shutil.copytree(killed, tmp_path / "live.partial")
    with studio_output(StudioSetup("empty"), Output(tmp_path / "live"), say=silent):
        pass
    aside = tmp_path / "live.unfinished"
    assert load_session(aside / "session.yaml").actions[0][1].do == "record"
    assert f"what an unfinished command left is now in {aside} (`turtlebag studio" in caplog.text
    assert (tmp_path / "live/manifest.json").exists()


def test_a_killed_replay_leaves_nothing_that_looks_finished_and_can_be_begun_again(killed, tmp_path):
    out = tmp_path / "out"
    process = started(AGAIN, killed / "session.yaml", out)
    wait_until(tmp_path / "out.partial/session.yaml", 2.0)
    process.kill()
    process.wait()
    assert not out.exists()
    assert replay(killed / "session.yaml", Output(out), say=silent) == 0
    assert {path.name for path in tmp_path.iterdir()} == {"out", "out.unfinished"}


def test_an_interrupted_replay_is_finished_where_it_is(killed, tmp_path):
    """Ctrl-C comes when the session tells that its task was cancelled, after two seconds of four."""
    told = yaml.safe_load((killed / "session.yaml").read_text())
    before = [entry for entry in told["inputs"] if entry.get("at", entry.get("end")) < 2.0]
    told["inputs"] = [*before, {"at": 2.0, "do": "cancel"}, {"at": 4.0}]
    (tmp_path / "session.yaml").write_text(yaml.safe_dump(told))

    def interrupt(line):
        if "cancelled" in line:
            signal.raise_signal(signal.SIGINT)

    assert replay(tmp_path / "session.yaml", Output(tmp_path / "out"), say=interrupt) == 130
    assert read_commands(tmp_path / "out/bags/drive")[0][-1] > 1e9
    recorded = load_session(tmp_path / "out/session.yaml")
    assert recorded.actions[-1][1].do == "end"
    assert 2e9 <= recorded.until_ns < 2.1e9
    assert replay(tmp_path / "out/session.yaml", Output(tmp_path / "again"), say=silent) == 0
    assert differences(tmp_path / "out", tmp_path / "again") == []


def fail_within(out):
    with studio_output(StudioSetup("empty"), Output(out), say=silent) as session:
        session.tick()
        raise ZeroDivisionError


def test_what_was_driven_before_an_error_is_kept(tmp_path, caplog):
    with pytest.raises(ZeroDivisionError):
        fail_within(tmp_path / "out")
    aside = tmp_path / "out.unfinished"
    assert list(tmp_path.iterdir()) == [aside]
    assert f"what was recorded is kept in {aside} (`turtlebag studio --replay" in caplog.text
    with files_below(60_000), pytest.raises(Unfinished, match=r"File too large; .*out\.unfinished-2"):
        fill_within(tmp_path / "out")
    saved = tmp_path / "saved"
    assert main(["bag", "recover", str(tmp_path / "out.unfinished-2/bags/drive"), "--out", str(saved)]) == 0
    assert len(read_commands(saved)[0]) > 25


@pytest.mark.parametrize("room", [250, 257, 263])
def test_a_session_on_a_full_disk_ends_with_a_whole_line(tmp_path, room):
    with files_below(room), pytest.raises(OSError, match="too large"):
        press_on_and_on(tmp_path / "session.yaml")
    assert load_session(tmp_path / "session.yaml").until_ns > 4e9


def press_on_and_on(path):
    journal = Journal(path, StudioSetup("empty").header())
    for second in range(1, 100):
        journal.tick(second * 10**9, None)


def fill_within(out):
    with studio_output(StudioSetup("empty"), Output(out), say=silent) as session:
        session.apply(Save(do="record", name="drive"))
        for _ in range(300):
            session.tick()
