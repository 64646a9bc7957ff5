"""`make setup` stopped half-way, and with a package mirror that does not answer: the same make repairs it.

A stand-in for Python and pip, so that nothing is fetched: what it does next stands in a file.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.maps import save_map
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.cli import doctor
from turtlebag.pipeline.setup.install import put_on_path

ROOT = Path(__file__).parents[2]
# What pip 23 said of a mirror where nobody listens, and of one that breaks off.
REFUSED = """\
WARNING: Retrying (Retry(total=0)) after connection broken by 'NewConnectionError('refused')': /six/
ERROR: Could not find a version that satisfies the requirement six==1.17.0 (from versions: none)
ERROR: No matching distribution found for six==1.17.0
"""
NO_RETRIES = REFUSED.partition("\n")[2]
BROKEN_OFF = """\
ERROR: Exception:
Traceback (most recent call last):
  File "pip/_internal/cli/base_command.py", line 180, in exc_logging_wrapper
pip._vendor.urllib3.exceptions.ReadTimeoutError: HTTPSConnectionPool(host='x', port=443): Read timed out.
"""
NO_WHEEL = """\
ERROR: Ignored the following versions that require a different python version: 1.0 Requires-Python >=3.99
ERROR: Could not find a version that satisfies the requirement six==1.17.0 (from versions: 1.16.0)
ERROR: No matching distribution found for six==1.17.0
"""
# Python and, as .venv/bin/python, the one of the environment; `-I` runs the installer or looks for damage.
STAND_IN = """\
#!/bin/bash
here=$(dirname "$0")/..
case "$*" in
  "-c import sys, venv"*) exit 0;;
  "-I pipeline/setup/install.py "*) exec {python} -I -c "import runpy, sys
sys.executable, sys.argv = '$0', sys.argv[1:]
runpy.run_path(sys.argv[0], run_name='__main__')" "${{@:2}}";;
  "-m pip config get"*) echo https://who:secret@mirror.example/simple;;
  "-m venv "*) mkdir -p "$3/bin"; cp "$0" "$3/bin/python"; touch "$3/pyvenv.cfg"
    printf '#!/bin/bash\necho "$*" >> {calls}\n[ ! -e {sick} ]' > "$3/bin/turtlebag"
    chmod +x "$3/bin/turtlebag";;
  "-I -c "*) ls "$here" | grep -x damaged;;
  *"pip install"*) echo "pip install" >> {calls}
    [ -e "$here/half" ] && echo "ERROR: half a package is in the way" && exit 1
    case "$(cat {todo} 2>/dev/null)" in
      "") ;;
      hang) touch "$here/half"; echo started >> {calls}; sleep 30;;
      slow) rm {todo}; touch "$here/half"; echo started >> {calls}; sleep 1.5; rm "$here/half";;
      *) cat {todo}; exit 1;;
    esac;;
esac
exit 0
"""
SOURCES = ("sim", "datasets", "planners", "pipeline/slam", "pipeline/slam3d", "reports/metrics")


class Machine:
    """A copy of what `make setup` reads, and a Python that does as it is told."""

    def __init__(self, folder):
        self.folder, self.todo, self.calls = folder / "project", folder / "todo", folder / "calls"
        self.sick, self.python = folder / "sick", folder / "python3"
        for name in SOURCES:
            (self.folder / name).mkdir(parents=True)
        for name in ("Makefile", "requirements.lock", "pyproject.toml", "pipeline/setup/install.py"):
            (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, self.folder / name)
        text = STAND_IN.format(todo=self.todo, calls=self.calls, sick=self.sick, python=sys.executable)
        self.python.write_text(text)
        self.python.chmod(0o755)
        self.calls.touch()

    def start(self):
        # Neither the make that runs the tests nor this machine's mirror may show through.
        hidden = ("MAKE", "MFLAGS", "PIP_")
        environment = {name: value for name, value in os.environ.items() if not name.startswith(hidden)}
        return subprocess.Popen(
            ["make", "setup", f"PYTHON={self.python}"],
            cwd=self.folder,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def setup(self):
        """(exit code, lines of ours on stderr, stdout)."""
        process = self.start()
        out, err = process.communicate(timeout=20)
        return (
            process.returncode,
            [line for line in err.splitlines() if not line.startswith("make: ***")],
            out,
        )

    def wait_for(self, word):
        give_up = time.monotonic() + 20.0
        while word not in self.calls.read_text():
            assert time.monotonic() < give_up, f"{word} never came"
            time.sleep(0.02)

    @property
    def ready(self):
        return (self.folder / ".venv/.ready").exists()


@pytest.fixture
def machine(tmp_path):
    return Machine(tmp_path)


def test_a_set_up_ends_with_a_trial_and_is_not_repeated(machine):
    assert machine.setup()[0] == 0
    assert machine.ready
    assert machine.calls.read_text().split("\n")[-2:] == ["doctor --trial", ""]
    before = machine.calls.read_text()
    assert machine.setup()[0] == 0
    assert machine.calls.read_text() == before


def test_a_set_up_that_was_killed_is_made_anew_by_the_same_make(machine):
    machine.todo.write_text("hang")
    process = machine.start()
    machine.wait_for("started")
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    assert not machine.ready
    assert (machine.folder / ".venv/half").exists()
    machine.todo.unlink()
    assert machine.setup()[:2] == (0, [])
    assert machine.ready
    assert not (machine.folder / ".venv/half").exists()


@pytest.mark.slow
def test_pip_that_outlives_a_killed_make_is_waited_for(machine):
    machine.todo.write_text("slow")
    process = machine.start()
    machine.wait_for("started")
    os.kill(process.pid, signal.SIGKILL)
    code, complaints, said = machine.setup()
    process.communicate()
    assert (code, complaints) == (0, [])
    assert "another set-up is running in .venv; waiting for it to finish" in said
    assert machine.ready


def test_a_package_that_lost_its_files_is_noticed(machine):
    assert machine.setup()[0] == 0
    (machine.folder / ".venv/damaged").touch()
    (machine.folder / ".venv/.ready").unlink()
    code, _, said = machine.setup()
    assert code == 0
    assert "what is in .venv is damaged (damaged); recreating .venv" in said
    assert not (machine.folder / ".venv/damaged").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    "words", [REFUSED, NO_RETRIES, BROKEN_OFF], ids=["refused", "no retries", "broken off"]
)
def test_a_mirror_that_does_not_answer_is_one_line_that_says_what_to_do(machine, words):
    machine.todo.write_text(words)
    code, complaints, said = machine.setup()
    assert code == 2
    (line,) = complaints
    assert line.startswith("set-up: https://mirror.example/simple does not answer")
    assert ("six==1.17.0" in line) == ("six" in words)
    assert "PIP_INDEX_URL=https://..." in line
    assert "run the same make command again" in line
    assert "secret" not in line + said
    assert "Traceback" not in line + said
    assert (machine.folder / ".venv/install.log").read_text() == words
    assert not machine.ready
    machine.todo.unlink()
    assert machine.setup()[:2] == (0, [])
    assert machine.ready


def test_a_package_that_cannot_be_had_is_not_blamed_on_the_network(machine):
    machine.todo.write_text(NO_WHEEL)
    code, (line,), _ = machine.setup()
    assert code == 2
    assert "the packages could not be installed: No matching distribution found for six==1.17.0" in line
    assert "does not answer" not in line


def test_a_trial_that_fails_is_tried_again_without_a_new_environment(machine):
    machine.sick.touch()
    code, (line,), _ = machine.setup()
    assert code == 2
    assert "the lines above show what does not work" in line
    (machine.folder / ".venv/kept").touch()
    machine.sick.unlink()
    assert machine.setup()[0] == 0
    assert (machine.folder / ".venv/kept").exists()


def test_a_folder_named_turtlebag_is_not_taken_for_the_package(tmp_path):
    """That of a clone, say, seen from the folder that holds it; asked twice, as by two set-ups."""
    packages = tmp_path / "env/lib/python3.0/site-packages"
    packages.mkdir(parents=True)
    (tmp_path / "turtlebag/datasets").mkdir(parents=True)
    for _ in range(2):
        put_on_path(tmp_path / "env", ROOT)
    code = f"import site; site.addsitedir({str(packages)!r}); import turtlebag; print(turtlebag.__file__)"
    # Without this environment's own packages, whose finder would find it.
    words = [sys.executable, "-S", "-c", code]
    found = subprocess.check_output(words, cwd=tmp_path, text=True, timeout=20)
    assert Path(found.strip()).resolve() == ROOT / "pipeline/turtlebag/__init__.py"


def test_damage_is_files_of_a_package_that_are_not_there(tmp_path):
    sys.path.insert(0, str(ROOT / "pipeline/setup"))
    from install import WHOLE

    sys.path.remove(str(ROOT / "pipeline/setup"))
    here = tmp_path / "site-packages"
    for name, files in {"good": ["good.py"], "lost": ["lost.py", "lost/part.py"], "cut": None}.items():
        info = here / f"{name}-1.0.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (here / f"{name}.py").touch()
        if files is not None:
            (info / "RECORD").write_text("".join(f"{file},,\n" for file in [*files, "../../bin/script"]))
    code = f"import sys\nsys.prefix, sys.path[:0] = {str(tmp_path)!r}, [{str(here)!r}]\n{WHOLE}"
    done = subprocess.run([sys.executable, "-I", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "cut, lost\n"


MISSING = {
    "ompl": "plan --map m.yaml --robot burger --start 0.5,0.5,0 --goal 1.5,1.5,0 --out path",
    "pydantic": "record --world empty --teleop tour --seed 1 --out path",
}
WITHOUT = "import sys; sys.modules['{}'] = None; from turtlebag.pipeline.__main__ import run; sys.exit(run())"


@pytest.mark.slow
@pytest.mark.parametrize("package", MISSING)
def test_a_package_that_is_not_there_is_one_line(tmp_path, package):
    floor = np.zeros((40, 40), dtype=np.int8)
    save_map(OccupancyGrid(floor, 0.05, SE2.from_xyt(0.0, 0.0, 0.0)), tmp_path, "m")
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT.format(package), *MISSING[package].split()],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"turtlebag: the package {package} is missing")
    assert "make -B setup" in line
    assert not (tmp_path / "path").exists()


def test_doctor_names_each_package_that_is_not_there_and_what_to_do(monkeypatch, capsys):
    checks = {name: doctor.CHECKS[name] for name in ("python", "duckdb", "jinja2")}
    assert doctor.report(checks) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "everything works"
    monkeypatch.setitem(sys.modules, "jinja2", None)
    assert doctor.report(checks) == 1
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in lines[1:3]] == [["ok", "duckdb"], ["MISSING", "jinja2"]]
    assert lines[2].endswith(" -> make -B setup")
    assert lines[3] == "1 of 3 checks failed"


def test_doctor_looks_at_every_package_the_project_asks_for():
    asked = re.findall(
        r'^    "([a-z0-9-]+)[=>]', (ROOT / "pyproject.toml").read_text().partition("dev = [")[0], re.M
    )
    assert len(asked) > 15
    # The lock installs these two for others' sake; open3d is checked by loading it with the former.
    assert set(asked) - {"libusb-package", "open3d-cpu"} <= set(doctor.CHECKS)
