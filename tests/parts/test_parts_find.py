"""User-defined parts by `module:Class`: found, checked against their contract, and named in the manifest."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from turtlebag.datasets import parts
from turtlebag.datasets.errors import InputError
from turtlebag.pipeline.campaign.campaign_file import Campaign
from turtlebag.pipeline.campaign.cases import cases
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.slam.graph.pose_graph import Gtsam
from turtlebag.pipeline.slam.mapper import SlamConfig
from turtlebag.pipeline.slam.odometry.front_end import FrontEnd
from turtlebag.pipeline.stages.settings import load_config
from turtlebag.sim.worlds import load_world, own_files

MODULE = """
import numpy as np
from turtlebag.pipeline.slam.odometry.front_end import Placed

class Good:
    def __init__(self, tracker): self.tracker = tracker
    def step(self, points, odometry_step, wait_s):
        return Placed(self.tracker.pose, np.zeros((3, 3)), 1.0)

class Outer:
    class Inner(Good):
        pass

class Nothing(Good):
    def step(self, points, odometry_step, wait_s):
        return None

class Leaves(Good):
    def step(self, points, odometry_step, wait_s):
        raise SystemExit(0)

class Breaks(Good):
    def step(self, points, odometry_step, wait_s):
        return {}["pose"]

class Reads(Good):
    def step(self, points, odometry_step, wait_s):
        open("nowhere.txt")

class Imports(Good):
    def step(self, points, odometry_step, wait_s):
        import nowhere_at_all

class NoStep:
    def __init__(self, tracker): pass

class Short:
    def __init__(self, tracker): pass
    def step(self, points): pass

class Unmade:
    def step(self, points, odometry_step, wait_s): pass

class Static:
    def __init__(self, tracker): pass
    @staticmethod
    def step(points, odometry_step, wait_s): pass

number = 3
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with a module of its own name, so that no test finds what another has left."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    name = "own_" + "".join(c for c in tmp_path.name if c.isalnum())
    (tmp_path / f"{name}.py").write_text(MODULE)
    return name


@pytest.fixture
def log(here):
    """Scans of a room, as CARMEN writes them."""
    angles = np.linspace(-np.pi / 2, np.pi / 2, 180)
    lines = []
    for k in range(12):
        walls = np.minimum(3.0 - 0.1 * k, 2.0 / np.maximum(np.abs(np.sin(angles)), 1e-3))
        walls = np.minimum(walls / np.maximum(np.cos(angles), 0.3), 6.0)
        ranges = " ".join(f"{r:.3f}" for r in walls)
        pose = f"{0.1 * k:.3f} 0.0 0.0"
        lines.append(f"FLASER 180 {ranges} {pose} {pose} {k * 0.2:.2f} host {k * 0.2:.2f}")
    Path("room.clf").write_text("\n".join(lines) + "\n")
    return Path("room.clf")


def test_a_class_of_the_current_folder_is_found_by_its_name_and_the_name_by_it(here):
    for name in (f"{here}:Good", f"{here}:Outer.Inner", f"{here}:Static"):
        found = parts.find(name, FrontEnd)
        assert parts.name_of(found) == name
    assert parts.source_files({"front_end": f"{here}:Good", "back_end": "gtsam", "loops.match": None}) == {
        "front_end": Path(f"{here}.py")
    }
    assert parts.find("turtlebag.pipeline.slam.odometry.kiss:KissIcp", FrontEnd).__name__ == "KissIcp"


def test_a_class_of_the_main_module_has_a_name_and_one_inside_a_function_has_none(monkeypatch):
    class Local:
        pass

    with pytest.raises(InputError, match="cannot be imported by this name: define it at the top"):
        parts.name_of(Local)
    typed = type("Typed", (), {"__module__": "__main__", "optimise": Gtsam.optimise})
    monkeypatch.setattr(sys.modules["__main__"], "Typed", typed, raising=False)
    assert parts.name_of(typed) == "__main__:Typed"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("nowhere_at_all:Good", "no module nowhere_at_all in this folder"),
        ("{here}:Godo", "has no class Godo; it has Good, Outer, "),
        ("{here}:number", "has no class number"),
        ("{here}:NoStep", "has no method step; the contract is FrontEnd.step(points, odometry_step, wait_s)"),
        ("{here}:Short", "step (self, points); the contract is FrontEnd.step(points, odometry_step, wait_s)"),
        ("{here}:Unmade", "is made with (); the contract is FrontEnd(tracker)"),
        ("broken_one:Good", "cannot be imported: SyntaxError"),
        ("wants_more:Good", "cannot be imported: ModuleNotFoundError: No module named 'nowhere_at_all'"),
        ("leaves:Good", "cannot be imported: SystemExit: 3"),
    ],
)
def test_what_is_wrong_with_a_name_is_said_in_one_line(here, name, said):
    Path("broken_one.py").write_text("def x(:\n")
    Path("wants_more.py").write_text("import nowhere_at_all\n")
    Path("leaves.py").write_text("raise SystemExit(3)\n")
    with pytest.raises(InputError) as error:
        parts.find(name.format(here=here), FrontEnd)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_a_setting_takes_our_names_and_classes_and_nothing_else():
    assert load_config(SlamConfig, None, ["front_end=my.module:Mine"]).front_end == "my.module:Mine"
    with pytest.raises(
        InputError, match=r"expected lines, kiss_icp, wheels or your own class .*, not 'linse'"
    ):
        load_config(SlamConfig, None, ["front_end=linse"])
    with pytest.raises(InputError, match="or your own class"):
        load_config(SlamConfig, None, ["loops.match=a:b:c"])


def test_a_setting_that_stands_for_ours_is_not_written():
    assert "back_end" not in SlamConfig().model_dump(mode="json")
    assert SlamConfig(back_end="a:B").model_dump(mode="json")["back_end"] == "a:B"


@pytest.mark.parametrize(
    ("part", "place"),
    [
        ("Breaks", ", in step: KeyError: 'pose'"),
        ("Leaves", ", in step: SystemExit: 0"),
        ("Reads", ", in step: FileNotFoundError: "),
        ("Imports", ", in step: ModuleNotFoundError: "),
    ],
)
def test_what_a_part_raises_is_an_exception_of_its_own_whatever_it_is(here, log, part, place):
    with pytest.raises(RuntimeError) as caught:
        main(["map", str(log), "--set", f"front_end={here}:{part}", "--out", "map", "-q"])
    assert str(caught.value).startswith(f"{here}.py, line ")
    assert place in str(caught.value)
    assert not list(Path().glob("map*"))


def test_a_part_that_returns_something_else_is_python_s_to_say(here, log):
    with pytest.raises(AttributeError, match="'NoneType' object has no attribute 'T_track_base'"):
        main(["map", str(log), "--set", f"front_end={here}:Nothing", "--out", "map", "-q"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("raises", "said"),
    [
        ("raise ValueError('tired')", "ValueError: tired"),
        ("open('nowhere')", "FileNotFoundError: [Errno 2] No such file or directory: 'nowhere'"),
    ],
)
def test_a_part_that_breaks_ends_the_program_with_its_traceback_and_exit_code_1(here, capfd, raises, said):
    Path("task.py").write_text(
        "from turtlebag.datasets.types import Twist\n"
        "from turtlebag.pipeline.navigation.driver import Driver\n"
        "class Stops(Driver):\n"
        "    def __init__(self, kit, mission): super().__init__(kit.sensing)\n"
        "    def step(self, observation):\n"
        "        self.sensing.observe(observation)\n"
        f"        if observation.stamp_ns > 2e9: {raises}\n"
        "        return Twist()\n"
    )
    words = ["navigate", "--world", "turtlebot3_world", "--task", "task:Stops", "--out", "run"]
    done = subprocess.run([sys.executable, "-m", "turtlebag", *words], capture_output=True, text=True)
    assert done.returncode == 1
    assert f"\n{said}\n" in done.stderr
    assert done.stderr.endswith(f"RuntimeError: task.py, line 7, in step: {said}\n")
    assert not Path("run").exists()
    assert main(["bag", "info", "run.unfinished"]) == 0  # what was driven until then is kept, closed
    assert "/odom" in capfd.readouterr().out


def test_a_map_says_what_made_it_and_a_changed_part_is_not_used_unseen(here, log):
    assert main(["map", str(log), "--set", f"front_end={here}:Good", "--out", "map", "-q"]) == 0
    manifest = json.loads(Path("map/manifest.json").read_text())
    assert manifest["parts"]["front_end"] == f"{here}:Good"
    assert list(manifest["inputs"]["front_end"]["sha256"]) == [f"{here}.py"]
    assert f"front_end: {here}:Good" in Path("map/config.yaml").read_text()
    Path(f"{here}.py").write_text(MODULE + "# edited\n")
    with pytest.raises(InputError, match="has changed since it was imported"):
        parts.source_files({"front_end": f"{here}:Good"})


def test_a_world_is_a_class_with_options(here):
    Path("halls.py").write_text(
        "from turtlebag.sim.world import World\n"
        "from turtlebag.sim.shapes import box\n"
        "from turtlebag.datasets.se2 import SE2\n"
        "class Hall:\n"
        "    def __init__(self, options): self.options = options\n"
        "    def world(self):\n"
        "        wall = box('wall', (3, 0), (0.2, 4), 0.0, (0, 1))\n"
        "        bounds, name = (-3, 4, -3, 3), f'hall {self.options}'\n"
        "        return World(name, 'burger', SE2.identity(), (wall,), bounds, (), {})\n"
    )
    assert load_world("halls:Hall:wide=2").name == "hall wide=2"
    assert len(load_world("halls:Hall+clutter:1,boxes=1").shapes) == 2
    assert own_files("halls:Hall:wide=2", None) == {"world": Path("halls.py")}
    with pytest.raises(InputError, match="or your own class"):
        load_world("hals")


def test_a_localiser_and_a_back_end_of_ones_own_do_the_work(here, log, monkeypatch):
    Path(f"{here}_more.py").write_text(
        "from turtlebag.pipeline.localisation.amcl import Amcl\n"
        "from turtlebag.pipeline.slam.graph.pose_graph import Gtsam\n"
        "asked = []\n"
        "class Mine(Amcl):\n"
        "    def update(self, *given): asked.append('scan'); return super().update(*given)\n"
        "class Solver(Gtsam):\n"
        "    def optimise(self, *given): asked.append('graph'); return super().optimise(*given)\n"
    )
    back_end = ["--set", f"back_end={here}_more:Solver"]
    assert main(["map", str(log), *back_end, "--out", "map", "-q"]) == 0
    assert main(["map", str(log), "--out", "ours", "-q"]) == 0
    for name in ("map.pgm", "trajectory.tum", "graph.g2o"):
        assert Path("map", name).read_bytes() == Path("ours", name).read_bytes()
    words = ["localise", str(log), "--map", "map/map.yaml", "--initial-pose", "0,0,0", "-q", "--out"]
    assert main([*words, "found", "--set", f"localiser={here}_more:Mine"]) in (0, 1)
    manifest = json.loads(Path("found/manifest.json").read_text())
    assert manifest["parts"] == {"localiser": f"{here}_more:Mine"}
    assert "localiser" in manifest["inputs"]
    assert set(sys.modules[f"{here}_more"].asked) == {"scan", "graph"}


def test_a_campaign_takes_classes_as_levels():
    campaign = Campaign.model_validate(
        {
            "name": "own",
            "factors": {"part": ["lines", "my_icp:MyFrontEnd"]},
            "stages": {"map": "map log.clf --set front_end={part}"},
            "results": {"scans": "map:scans"},
        }
    )
    words = [case.commands["map"] for case in cases(campaign)]
    assert [command[-1] for command in words] == ["front_end=lines", "front_end=my_icp:MyFrontEnd"]
