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

import pytest

from turtlebag.pipeline.cli import doctor
from turtlebag.pipeline.setup.install import install, put_on_path

ROOT = Path(__file__).parents[2]
# What pip said of a mirror where nobody listens, and uv of one, and of a package that there is not.
NO_UV = """\
WARNING: Retrying (Retry(total=0)) after connection broken by 'NewConnectionError('refused')': /simple/uv/
ERROR: Could not find a version that satisfies the requirement uv (from versions: none)
ERROR: No matching distribution found for uv
"""
REFUSED = """\
Using Python 3.11.7 environment at: .venv
error: Request failed after 3 retries
  cause: Failed to fetch: https://mirror.example/simple/six/
"""
NO_WHEEL = """\
error: No solution found when resolving dependencies
  cause: Because there is no version of six==1.17.0 and you require six==1.17.0, ...
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
  "-m pip config list"*) echo "global.index-url='https://who:secret@mirror.example/simple'";;
  "-m venv "*) mkdir -p "$3/bin"; cp "$0" "$3/bin/python"; touch "$3/pyvenv.cfg"
    mkdir -p "$3"/lib/python3.0/site-packages/{{gtsam,open3d}}/{{Data,used,tests}}
    touch "$3"/lib/python3.0/site-packages/open3d/open3d_{{tf,torch}}_ops.so
    printf '#!/bin/bash\necho "$*$PYTHONDONTWRITEBYTECODE" >> {calls}\n[ ! -e {sick} ]' > "$3/bin/turtlebag"
    chmod +x "$3/bin/turtlebag";;
  "-m pip install"*" uv>="*) cp "$0" "$here/bin/uv"
    [ -e {nouv} ] && cat {nouv} && exit 1;;
  "pip install "*" -r "*) echo "uv from $UV_DEFAULT_INDEX" >> {calls}
    [ -e "$here/half" ] && echo "error: half a package is in the way" && exit 1
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
        self.nouv = folder / "nouv"
        for name in SOURCES:
            (self.folder / name).mkdir(parents=True)
        for name in ("Makefile", "requirements.lock", "pyproject.toml", "pipeline/setup/install.py"):
            (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, self.folder / name)
        text = STAND_IN.format(
            todo=self.todo, calls=self.calls, sick=self.sick, nouv=self.nouv, python=sys.executable
        )
        self.python.write_text(text)
        self.python.chmod(0o755)
        self.calls.touch()

    def start(self):
        # Neither the make that runs the tests nor this machine's mirror may show through.
        hidden = ("MAKE", "MFLAGS", "PIP_", "UV_")
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


def test_a_set_up_that_was_killed_while_it_cleared_is_not_taken_for_done(monkeypatch, tmp_path):
    (tmp_path / "lib").mkdir()
    (tmp_path / ".ready").touch()

    def killed(path):
        raise KeyboardInterrupt

    monkeypatch.setattr(shutil, "rmtree", killed)
    with pytest.raises(KeyboardInterrupt):
        install(tmp_path, ROOT, handle=-1)
    assert not (tmp_path / ".ready").exists()


@pytest.mark.slow
def test_uv_that_outlives_a_killed_make_is_waited_for(machine):
    machine.todo.write_text("slow")
    process = machine.start()
    machine.wait_for("started")
    os.kill(process.pid, signal.SIGKILL)
    code, complaints, said = machine.setup()
    process.communicate()
    assert (code, complaints) == (0, [])
    assert "another set-up is running in .venv; waiting for it" in said
    assert machine.ready


def test_what_packages_bring_and_nothing_reads_is_left_out(machine):
    assert machine.setup()[0] == 0
    packages = machine.folder / ".venv/lib/python3.0/site-packages"
    kept = {path.relative_to(packages).as_posix() for path in packages.glob("*/*")}
    assert kept == {"gtsam/used", "open3d/Data", "open3d/used"}


def test_the_packages_come_from_the_mirror_that_pip_is_set_to(machine):
    assert machine.setup()[0] == 0
    assert "uv from https://who:secret@mirror.example/simple\n" in machine.calls.read_text()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("what", "words", "why"),
    [
        ("nouv", NO_UV, "Could not find a version that satisfies the requirement uv"),
        ("todo", REFUSED, "Request failed after 3 retries"),
        ("todo", NO_WHEEL, "No solution found when resolving dependencies"),
    ],
)
def test_what_cannot_be_fetched_is_one_line_that_says_what_to_do(machine, what, words, why):
    getattr(machine, what).write_text(words)
    code, complaints, said = machine.setup()
    assert code == 2
    (line,) = complaints
    what = "uv" if what == "nouv" else "the packages"
    assert line.startswith(f"set-up: {what} could not be fetched from https://mirror.example/simple: check")
    assert why in line
    assert "PIP_INDEX_URL=https://..." in line
    assert "run the same make command again" in line
    assert "secret" not in line + said
    assert (machine.folder / ".venv/install.log").read_text() == words
    assert not machine.ready
    machine.todo.unlink(missing_ok=True)
    machine.nouv.unlink(missing_ok=True)
    assert machine.setup()[:2] == (0, [])
    assert machine.ready


def test_a_whole_environment_is_kept_and_one_whose_trial_failed_is_made_anew(machine):
    assert machine.setup()[0] == 0
    kept = machine.folder / ".venv/kept"
    kept.touch()
    (machine.folder / ".venv/.ready").unlink()
    assert machine.setup()[0] == 0
    assert kept.exists()
    machine.sick.touch()
    (machine.folder / ".venv/.ready").unlink()
    code, (line,), _ = machine.setup()
    assert code == 2
    assert "the lines above show what does not work" in line
    machine.sick.unlink()
    assert machine.setup()[0] == 0
    assert not kept.exists()


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
