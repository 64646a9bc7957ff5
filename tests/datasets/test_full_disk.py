"""A full disk, a read-only folder: exit 2, one line, nothing left behind."""

import ctypes
import os
import struct
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.helpers.fuzz_inputs import files_below, outcome

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
        "ros1.bag": ("bag", "convert", chain / "record"),
        "recover": ("bag", "recover", chain / "record"),
        "world.png": ("world", "show", chain / "room.yaml"),
        "sweep": ("sweep", chain / "sweep.yaml", "--workers", "1"),
    }


def largest(out):
    """Size of the largest file of an output; of its manifest none knows the size beforehand."""
    files = [out] if out.is_file() else [path for path in out.rglob("*") if path.is_file()]
    return max(path.stat().st_size for path in files if path.name != "manifest.json")


@pytest.mark.parametrize("name", commands(Path()))
def test_a_disk_full_before_the_last_byte_is_one_line_and_leaves_nothing(chain, no_workers, tmp_path, name):
    verb, *words = commands(chain)[name]
    whole, full = tmp_path / "whole", tmp_path / "full"
    for place in (whole, full):
        place.mkdir()
    code, said = outcome((verb, "-q", *words, "--out", whole / name), 60)
    assert code in (0, 1), said
    with files_below(largest(whole / name)):
        code, said = outcome((verb, "-q", *words, "--out", full / name), 60)
    assert (code, said.count("\n")) == (2, 1), said
    assert str(full / name) in said
    left = ["sweep.partial"] if verb == "sweep" else []  # a campaign goes on where it stopped
    assert [path.name for path in full.iterdir()] == left


@contextmanager
def mounted(place, options):
    """A small file system at a folder."""
    mount = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(place)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("no tmpfs can be mounted here")
    try:
        yield
    finally:
        subprocess.run(["umount", str(place)], check=True)


@contextmanager
def shut(place):
    """A folder that this thread may not write to, root's privilege or not (Linux's capget and capset)."""
    libc, header = ctypes.CDLL(None, use_errno=True), struct.pack("=Ii", 0x20080522, 0)
    usual = ctypes.create_string_buffer(24)  # twice what is effective, permitted, inheritable
    libc.capget(header, usual)
    place.chmod(0o555)
    assert libc.capset(header, bytes(4) + usual.raw[4:12] + bytes(4) + usual.raw[16:]) == 0
    try:
        yield
    finally:
        assert libc.capset(header, usual.raw) == 0


HINDRANCES = {
    "full": lambda place: mounted(place, "size=4k"),
    "read-only": lambda place: mounted(place, "ro"),
    "somebody else's": shut,
}


@pytest.mark.parametrize("name", ["record", "map", "avoid", "report", "convert", "world.png", "sweep"])
@pytest.mark.parametrize("hindrance", HINDRANCES)
def test_where_nothing_can_be_written_is_one_line_and_leaves_nothing(
    chain, no_workers, tmp_path, name, hindrance
):
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
