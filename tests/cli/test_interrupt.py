"""Ctrl-C at any moment: exit code 130, one line, and no half output. Recordings survive a hang-up."""

import os
import pty
import signal
import subprocess
import sys
import time
from contextlib import suppress

import pytest

from turtlebag.datasets.bags.doctor import examine
from turtlebag.pipeline.cli.main import main

GROW = (
    "import time, pathlib, sys\n"
    "from turtlebag.datasets.outputs import staged_output\n"
    "from turtlebag.pipeline.cli import doctor\n"
    "def grow():\n"
    "    with staged_output(pathlib.Path(sys.argv[1])) as folder:\n"
    "        (folder / 'half').write_text('x')\n"
    "        print('growing', flush=True)\n"
    "        time.sleep(60)\n"
    "doctor.CHECKS = {'grow': grow}\n"
    "from turtlebag.pipeline.cli.main import main\n"
    "sys.exit(main(['doctor']))\n"
)


@pytest.mark.slow
@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupted_stage_leaves_nothing(tmp_path, stop):
    process = subprocess.Popen(
        [sys.executable, "-c", GROW, str(tmp_path / "out")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "growing\n"
    process.send_signal(stop)
    _, complaint = process.communicate(timeout=20)
    assert process.returncode == 128 + stop
    assert complaint == "turtlebag: interrupted\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_mapping_is_interrupted_inside_compiled_code_without_a_crash(tmp_path):
    script = tmp_path / "kernel.py"
    script.write_text(
        "import sys, numpy as np\nfrom numba import njit\nfrom turtlebag.pipeline.cli import doctor\n"
        "@njit\ndef kernel(x):\n    return x + 1.0\n"
        "def spin():\n"
        "    x = kernel(np.zeros(3))\n    print('ready', flush=True)\n"
        "    while True:\n        x = kernel(x)\n"
        "doctor.CHECKS = {'spin': spin}\n"
        "from turtlebag.pipeline.cli.main import main\nsys.exit(main(['doctor']))\n"
    )
    process = subprocess.Popen(
        [sys.executable, str(script)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert process.stdout is not None
    process.stdout.readline()
    time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, complaint = process.communicate(timeout=30)
    assert (process.returncode, complaint) == (130, "turtlebag: interrupted\n")


def test_an_interrupt_while_the_program_still_loads_shows_no_traceback():
    code = (
        "import os, signal, sys\n"
        "class Finder:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'turtlebag.pipeline.cli.main':\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "sys.meta_path.insert(0, Finder())\n"
        "from turtlebag.pipeline.__main__ import run\n"
        "run()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30)
    assert (done.returncode, done.stderr) == (130, "")


RECORDERS = {
    "record": "--world turtlebot3_world --teleop tour",
    "navigate": "--world turtlebot3_world --task avoid --duration 3600",
    "teleop": "--world turtlebot3_world",
    "studio": "--world turtlebot3_world --no-browser",
}


def wait_for_a_recording(partial, size=60_000):
    """Until some simulated seconds are on the disk."""
    end = time.monotonic() + 60.0
    while time.monotonic() < end:
        with suppress(OSError):
            if sum(path.stat().st_size for path in partial.rglob("*") if path.is_file()) > size:
                return
        time.sleep(0.05)
    raise AssertionError("the recording does not get on")


@pytest.mark.slow
@pytest.mark.parametrize("verb", RECORDERS)
def test_a_recording_whose_terminal_is_closed_is_kept(tmp_path, verb):
    out, aside = tmp_path / "out", tmp_path / "out.unfinished"
    words = [sys.executable, "-m", "turtlebag", verb, *RECORDERS[verb].split(), "--out", str(out)]
    process, terminal = pty.fork()
    if process == 0:
        with open(tmp_path / "said", "w") as said:
            os.dup2(said.fileno(), 2)
        os.execv(sys.executable, words)
    wait_for_a_recording(tmp_path / "out.partial", 3_000 if verb == "studio" else 60_000)
    os.close(terminal)
    assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == 129
    assert {path.name for path in tmp_path.iterdir()} == {"out.unfinished", "said"}
    said = (tmp_path / "said").read_text().splitlines()[-1]
    assert said.startswith(
        f"turtlebag: hung up: the terminal was closed; what was recorded is kept in {aside}"
    )
    if verb == "studio":
        assert main(["studio", "--replay", str(aside / "session.yaml"), "--out", str(out)]) == 0
    else:
        assert [finding for finding in examine(aside) if finding.severity == "error"] == []


@pytest.mark.slow
def test_a_recording_begun_with_nohup_outlives_its_terminal(tmp_path):
    words = ["record", "--world", "turtlebot3_world", "--teleop", "tour", "--out", str(tmp_path / "out")]
    process = subprocess.Popen(
        [sys.executable, "-m", "turtlebag", *words],
        stderr=subprocess.DEVNULL,
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN),
    )
    wait_for_a_recording(tmp_path / "out.partial")
    process.send_signal(signal.SIGHUP)
    time.sleep(0.3)
    process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=30) == 143
    assert (tmp_path / "out/manifest.json").exists()
