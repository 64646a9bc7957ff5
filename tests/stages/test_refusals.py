"""Stages whose inputs cannot be used: one line that says why, exit 2, and nothing is written.

Words of a command, and how its line goes on after `turtlebag: `; an ellipsis stands for anything.
"""

import numpy as np
import pytest

from tests.helpers.foreign_bags import SCAN, S, laser_scan, write_foreign
from tests.helpers.fuzz_cases import carmen_log
from tests.helpers.refusals import require_refused
from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from turtlebag.datasets.maps import save_map
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Cloud
from turtlebag.sim.robots import load_robot
from turtlebag.sim.worlds import load_world

BLOCKED = """\
name: blocked
spawn: [0, 0, 0]
shapes: [{kind: box, name: b, center: [0, 0], size: [1, 1], z: [0, 1]}]
"""
RECORD = {
    "--world mars": "unknown world 'mars'...",
    "--world turtlebot3_wold": "...turtlebot3_world...",
    "--world empty --robot burgr": "...burger...",
    "--world empty --teleop tuor": "...tour...",
    "--world turtlebot3_world --seed -1": "...--seed: ...",
    "--world turtlebot3_world --set sim.physics.frction=1": "...frction: unknown key...",
    "--world blocked.yaml": "start pose 0, 0: the robot would stand in an obstacle of blocked...",
    "--world blocked.yaml --teleop wall_follow": "start pose 0, 0: the robot would stand in ...",
    "--world empty --teleop folder": "folder: ...",
}
MAP = {
    "nothing": "nothing: no such file...",
    "blocked.yaml": "blocked.yaml: ...",
    "drive.clf --set voxle=1": "--set: voxle: unknown key...",
    "clouds --topic /nothing": "clouds: --topic /nothing is not in this bag; its topics: /points...",
    "clouds --also clouds": "--also: for 2D scans only...",
    "clouds --set grid.resolution_m=0.1": "--set: grid: ...",
    "clouds --set slice.low_m=0.5 --set slice.high_m=0.2": "...low_m must be below high_m",
    "flat --set slice.high_m=0.5": "--set: slice: ...",
}
LOCALISE = {
    "--map arena.yaml --initial-pose=2,2": "...expected three numbers...",
    "--map arena.yaml --initial-pose=start": "...expected X,Y,YAW (metres and radians); or global...",
    "--map arena.yaml --initial-pose=2,2,nan": "...not a finite number...",
    "--map arena.yaml --initial-pose=40,3,0": "--initial-pose 40,3,0: is off the map ...",
    "--map arena.yaml --initial-pose=2,2,0 --set amcl.min_particles=0": "--set: amcl.min_particles: ...",
    "--map arena.yaml --initial-pose=2,2,0 --set amcl.no_such=1": "--set: amcl.no_such: unknown key...",
    "--map arena.yaml --initial-pose=2,2,0 --truth nowhere": "...nowhere: no truth found...",
    "--map free.yaml --initial-pose=2,2,0": "cannot localise: the map has no occupied cell...",
}
AT_START = "--initial-pose start"
NAVIGATE = {
    f"--task goal --map arena.yaml {AT_START} --goal=1.1,1.1,0": "...obstacle...",
    f"--task goal --map arena.yaml {AT_START} --goal=0,2.58,0": "...obstacle...",
    f"--task goal --map arena.yaml {AT_START} --goal=100,0,0": "...off the map...",
    f"--task goal --map arena.yaml {AT_START} --goal=1,nan,0": "...y is not a finite...",
    f"--task goal --map arena.yaml {AT_START} --goal=0,2,nan": "...yaw is not a finite...",
    f"--task goal --map arena.yaml {AT_START} --goal=1,2": "...X,Y,YAW...",
    f"--task goal --map lonely.yaml {AT_START} --goal=0,2,0": "...gone.pgm...",
    f"--task goal --map arena.yaml {AT_START} --goal=-1.5,0,0 --timeout 1e9": "...must be 0.001 to ...",
    f"--task goal --map arena.yaml {AT_START} --goal=-1.5,0,0 --timeout 1e5": "--timeout 100000: at most ...",
    f"--task patrol {AT_START}": "...needs --map...",
    f"--task patrol --map m.yaml {AT_START}": "m.yaml: no such map...",
    "--task patrol --map full.yaml --initial-pose global": "full.yaml: has no free cell...",
    **{
        f"--task {task} --map {name}.yaml{initial}": f"{name}.yaml: has no occupied cell..."
        for task in ("goal --goal=-2,0,0", "patrol")
        for name in ("free", "unknown")
        for initial in (f" {AT_START}", " --initial-pose global", "")
    },
}
REFUSED = {
    **{f"record {words} --out x": said for words, said in RECORD.items()},
    **{f"map {words} --out x": said for words, said in MAP.items()},
    **{f"localise drive.clf {words} --out x": said for words, said in LOCALISE.items()},
    **{f"navigate --world turtlebot3_world {words} --out x": said for words, said in NAVIGATE.items()},
}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder of inputs, by the names that the table has for them."""
    folder = tmp_path_factory.mktemp("refused")
    (folder / "folder").mkdir()
    (folder / "blocked.yaml").write_text(BLOCKED)
    (folder / "drive.clf").write_text(carmen_log())
    arena = load_world("turtlebot3_world").rasterize(load_robot("burger").lidar_height)
    path = save_map(arena, folder, "arena")
    (folder / "lonely.yaml").write_text(path.read_text().replace("arena.pgm", "gone.pgm"))
    for name, cell in (("free", FREE), ("unknown", UNKNOWN), ("full", OCCUPIED)):
        cells = np.full((100, 100), cell, dtype=np.int8)
        save_map(OccupancyGrid(cells, 0.05, SE2.from_xyt(-2.5, -2.5, 0.0)), folder, name)
    with BagWriter(folder / "clouds", custom={}) as bag:
        for k in range(3):
            points = np.random.default_rng(k).normal(size=(50, 3))
            bag.cloud(k * S, k * S, Cloud(points, np.zeros(50)), "base_scan")
    write_foreign(folder / "flat", [("/scan", SCAN, 0, laser_scan(0, [2.0] * 360))])
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("words", REFUSED)
def test_inputs_that_cannot_be_used_are_one_line_that_says_why(place, monkeypatch, capsys, words):
    monkeypatch.chdir(place)
    require_refused(words, REFUSED[words], place, capsys)
