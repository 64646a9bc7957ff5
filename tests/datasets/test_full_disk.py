"""A full disk, a read-only folder: exit 2, one line, nothing left behind."""

import os
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.helpers.full_disks import files_below, mounted, ordinary_user
from tests.helpers.fuzz_inputs import outcome
from turtlebag.datasets.bags.doctor import examine
from turtlebag.datasets.outputs import sha256_tree
from turtlebag.pipeline.cli.main import main

pytestmark = pytest.mark.slow


def commands(chain):
    """Every command that writes, by a name and its words without --out."""
    world = ("--world", chain / "room.yaml", "--seed", "3")
    grid = ("--map", chain / "map" / "map.yaml")
    return {
        "record": ("record", *world, "--teleop", chain / "short.yaml"),
        "map": ("map", chain / "record", "--explain"),
        "localise": ("localise", chain / "record", *grid, "--initial-pose=0,0,0"),
        "plan": ("plan", *grid, "--start=0,0,0", "--goal=0.5,0,0"),
        "goal": ("navigate", *world, "--task", "goal", *grid, "--initial-pose=start", "--goal=0.4,0,0"),
        "avoid": ("navigate", *world, "--task", "avoid", "--duration=1"),
        "explore": ("navigate", *world, "--task", "explore", "--duration=1"),
        "report": ("report", "--no-animation", chain / "map"),
        "index": ("report", "--index", chain),
        "compare": ("compare", chain / "map", chain / "map"),
        "convert": ("bag", "convert", chain / "record"),
        "sqlite3": ("bag", "convert", chain / "record", "--storage", "sqlite3"),
        "recover": ("bag", "recover", chain / "record"),
        "world.png": ("world", "show", chain / "room.yaml"),
        "sweep": ("sweep", chain / "sweep.yaml", "--workers", "1", "--scheduler", "threads"),
    }


def largest(out):
    """Size of the largest file of an output; of its manifest none knows the size beforehand."""
    files = [out] if out.is_file() else [path for path in out.rglob("*") if path.is_file()]
    return max(path.stat().st_size for path in files if path.name != "manifest.json")


RECORDERS = ("record", "goal", "avoid", "explore")


@pytest.mark.parametrize("name", commands(Path()))
def test_a_disk_full_before_the_last_byte_is_one_line_and_leaves_what_there_was(chain, tmp_path, name):
    verb, *words = commands(chain)[name]
    out = tmp_path / name
    code, said = outcome((verb, "-q", *words, "--out", out), 60)
    assert code in (0, 1), said
    before, limit = sha256_tree(out), largest(out)
    with files_below(limit):
        code, said = outcome((verb, "-q", *words, "--out", out, "--force"), 60)
    assert (code, said.count("\n")) == (1 if name in RECORDERS else 2, 1), said
    assert str(out) in said
    assert "--force" not in said
    left = {path.name for path in tmp_path.iterdir()} - {name}
    if name in RECORDERS:
        assert left == {f"{name}.unfinished"}
        kept, saved = tmp_path / f"{name}.unfinished", tmp_path / "saved"
        assert main(["bag", "recover", str(kept), "--out", str(saved)]) == 0
        assert [finding for finding in examine(saved) if finding.severity == "error"] == []
    else:  # a campaign goes on where it stopped
        assert left == ({"sweep.partial"} if verb == "sweep" else set())
    assert sha256_tree(out) == before


def test_recordings_on_a_full_disk_are_kept_each_under_its_own_name(chain, tmp_path):
    verb, *words = commands(chain)["avoid"]
    for name in ("avoid.unfinished", "avoid.unfinished-2"):
        with files_below(30_000):
            code, said = outcome((verb, "-q", *words, "--out", tmp_path / "avoid"), 60)
        assert code == 1
        assert said == (
            f"turtlebag: {tmp_path / 'avoid'}: File too large; "
            f"what was recorded is kept in {tmp_path / name} "
            f"(`turtlebag bag recover {tmp_path / name} --out DIR` makes a finished output of it)\n"
        )
    assert {path.name for path in tmp_path.iterdir()} == {"avoid.unfinished", "avoid.unfinished-2"}


@contextmanager
def shut(place):
    """A folder that this thread may not write to."""
    place.chmod(0o555)
    with ordinary_user():
        yield


HINDRANCES = {
    "full": lambda place: mounted(place, "size=4k"),
    "read-only": lambda place: mounted(place, "ro"),
    "somebody else's": shut,
}


@pytest.mark.parametrize("name", ["record", "map", "avoid", "report", "convert", "world.png", "sweep"])
@pytest.mark.parametrize("hindrance", HINDRANCES)
def test_where_nothing_can_be_written_is_one_line_and_leaves_nothing(chain, tmp_path, name, hindrance):
    verb, *words = commands(chain)[name]
    place = tmp_path / "place"
    place.mkdir()
    with HINDRANCES[hindrance](place):
        code, said = outcome((verb, "-q", *words, "--out", place / name), 60)
        left = [path.name for path in place.iterdir()]
    assert (code, said.count("\n")) == (2, 1), said
    assert said.startswith("turtlebag: ")
    # A campaign goes on where it stopped, when there is room again.
    assert left in ([], ["sweep.partial"] if verb == "sweep" else [])


def test_figures_need_no_home_and_say_nothing_of_it(tmp_path):
    code = (
        "from turtlebag.pipeline.terminal.messages import set_verbosity\nset_verbosity(0)\n"
        "import matplotlib\nmatplotlib.get_configdir()"
    )
    homeless = {**os.environ, "HOME": "/proc/none", "TMPDIR": str(tmp_path)}
    for name in ("XDG_CONFIG_HOME", "XDG_CACHE_HOME", "MPLCONFIGDIR"):
        homeless.pop(name, None)
    done = subprocess.run(
        [sys.executable, "-c", code], env=homeless, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
