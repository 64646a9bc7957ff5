"""What Python's functions make, the commands make too, byte by byte; nothing stays that nobody asked for."""

import ast
import gc
import importlib
import inspect
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import turtlebag as tb
from tests.helpers.report_fakes import unrendered
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import sha256_tree
from turtlebag.pipeline.cli.main import build_parser, main
from turtlebag.pipeline.stages.parser import joined

ROOT = Path(__file__).parents[2]
HEAVY = {
    "numpy",
    "scipy",
    "numba",
    "gtsam",
    "matplotlib",
    "pydantic",
    "yaml",
    "pybullet",
    "ompl",
    "open3d",
    "rosbags",
}


@pytest.fixture(scope="module")
def made(chain):
    """The chain's steps once more, from Python."""
    bag = tb.record(chain / "room.yaml", teleop=chain / "short.yaml", seed=3)
    m = tb.map(bag, truth=bag)
    run = tb.navigate(m, task=tb.Patrol(chain / "points.yaml"), seed=3)
    return bag, m, run


def test_importing_loads_nothing_heavy_and_every_name_is_there():
    code = "import sys, turtlebag as tb; dir(tb); print(*{name.partition('.')[0] for name in sys.modules})"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not HEAVY & set(shown.stdout.split())
    assert len(shown.stdout.split()) < 120
    assert all(getattr(tb, name) is not None for name in tb.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = tb.nothing


def test_options_are_shown_with_their_types():
    steps = (tb.record, tb.map, tb.localise, tb.plan, tb.navigate, tb.report)
    shown = {step.__name__: inspect.signature(step).parameters for step in steps}
    assert all(one.annotation is not one.empty for options in shown.values() for one in options.values())
    types = {name: str(shown["map"][name].annotation) for name in ("topic", "also", "truth", "settings")}
    assert types == {
        "topic": "tuple[str, ...]",
        "also": "tuple[PathLike, ...]",
        "truth": "PathLike | None",
        "settings": "dict[str, Any]",
    }
    assert shown["localise"]["initial_pose"].annotation == "Pose | Literal['global'] | None"
    assert shown["record"]["start"].default is None


def test_the_names_for_type_checkers_are_those_that_are_loaded():
    tree = ast.parse(Path(tb.__file__).read_text())
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    typed = {alias.name: node.module for node in block.body for alias in node.names}
    for name, module in typed.items():
        assert getattr(tb, name) is getattr(importlib.import_module(module), name)
    assert sorted(typed) == sorted(tb.__all__)


@pytest.mark.slow
def test_the_functions_make_the_bytes_of_the_commands(chain, made, tmp_path, capfd):
    bag, m, run = made
    plan = tb.plan(m, (0, 0, 0), (0.5, 0, 0), robot="burger")
    found = tb.localise(
        bag, m, initial_pose=(0, 0, 0), truth=bag, seed=2, settings={"amcl.max_particles": 900}
    )
    assert capfd.readouterr() == ("", "")
    for output, name in ((bag, "record"), (m, "map"), (run, "run"), (plan, "plan")):
        assert sha256_tree(output.path) == sha256_tree(chain / name)
    for output in (bag, m, run, plan, found):
        words = output.stage.command
        args = build_parser(words[1]).parse_args(joined(words[1:]))
        assert args.out == output.path
    assert main([*joined(found.stage.command[1:]), "--force", "--out", str(tmp_path / "again")]) == 0
    assert sha256_tree(found.path) == sha256_tree(tmp_path / "again")


@pytest.mark.slow
def test_results_are_arrays(chain, made):
    bag, m, run = made
    assert m.grid.dtype == np.int8
    assert (m.grid == 100).sum() > 100
    assert m.extent[1] - m.extent[0] == pytest.approx(m.grid.shape[1] * m.resolution)
    assert m.world == bag.world == str(chain / "room.yaml")
    assert np.asarray(m.trajectory).shape == (len(bag.ranges), 3) == m.trajectory[:].shape
    assert np.abs(m.trajectory[:, :2] - bag.truth[:, :2]).max() < 0.05
    assert bag.ranges.shape[1] == 360
    assert len(bag.odometry) > len(bag.truth)
    assert run.success
    assert run.goals["status"].tolist() == ["reached", "reached"]
    assert np.nanmax(np.hypot(run.log["true_x"] - run.log["estimate_x"], 0.0)) < 0.1
    assert "/scan" in bag.topics["topic"]
    assert tb.Map(m.path).verdict == m.verdict
    assert "scans" in repr(bag)


@pytest.mark.slow
def test_what_is_shown_is_well_formed_with_a_picture(made, tmp_path):
    bag, m, run = made
    m.notes = ("a <note> & more",)
    with unrendered():
        report = tb.report(bag, m, run, animate=False, out=tmp_path / "report")
    assert report.page.is_file()
    assert str(report.path) in repr(report)
    for shown in (bag, m, run, m.trajectory):
        page = ElementTree.fromstring(shown._repr_html_())
        assert page.findall(".//{http://www.w3.org/2000/svg}path")
    words = "".join(ElementTree.fromstring(m._repr_html_()).itertext())
    assert "a <note> & more" in words
    assert m.verdict in words
    words = "".join(ElementTree.fromstring(report._repr_html_()).itertext())
    assert run.verdict in words
    assert str(report.page) in words
    assert "reached" in run.goals._repr_html_()


@pytest.mark.slow
def test_files_live_as_long_as_what_needs_them_and_stay_where_asked(chain, tmp_path):
    bag = tb.record(chain / "room.yaml", teleop=chain / "short.yaml", seed=4)
    kept = tb.map(bag, out=tmp_path / "kept", settings={"loops.enabled": False})
    with unrendered():
        compared = tb.compare(bag, chain / "record")
    with pytest.raises(tb.InputError, match="already exists"):
        tb.map(bag, out=kept.path)
    place = bag.path
    del bag
    gc.collect()
    assert place.is_dir()
    assert kept.robot == "burger"
    del kept
    gc.collect()
    assert place.is_dir()
    assert compared.path.is_dir()
    del compared
    gc.collect()
    assert not place.exists()
    assert tb.Map(tmp_path / "kept").metrics["loops"]["proposed"] == 0


WRONG = {
    "no such world": (lambda c: tb.record("nowhere"), "unknown world 'nowhere'"),
    "no such setting": (lambda c: tb.record("empty", settings={"sim.x": 1}), "sim.x: unknown key"),
    "no seed": (lambda c: tb.record("empty", seed=-1), "^seed: must be greater than or equal to 0"),
    "half a pose": (lambda c: tb.record("empty", start=(1, 2)), "^start: expected three numbers"),
    "a pose nowhere": (lambda c: tb.record("empty", start=(np.nan, 2, 0)), "^start: x is not a finite"),
    "no recording": (lambda c: tb.map(c / "none"), "none: no such file"),
    "another output": (lambda c: tb.Run(c / "map"), "is an output of map, not of navigate"),
    "no map": (lambda c: tb.Map(c / "record"), "no map"),
    "no trajectory": (lambda c: tb.Map(c / "map" / "map.yaml").trajectory, "has no trajectory"),
    "an unknown front end": (
        lambda c: tb.map(c / "record", front_end="x"),
        "front_end: expected lines, kiss_icp, .* not 'x'",
    ),
    "upside down alone": (lambda c: tb.map(c / "record", upside_down=True), "upside_down: give laser"),
    "patrol without a map": (lambda c: tb.navigate(task=tb.Patrol(), world="empty"), "patrol: needs --map"),
    "avoid on a map": (lambda c: tb.navigate(c / "map", task=tb.Avoid()), "map: not for --task avoid"),
    "no task": (lambda c: tb.navigate(c / "map", task="x"), "^task: expected goal, patrol, .* not 'x'"),
    "no time": (lambda c: tb.navigate(world="empty", task=tb.Goal(1, 0, timeout=0)), "^timeout: must be"),
    "no laps": (lambda c: tb.navigate(c / "map", task=tb.Patrol(laps=0)), "^laps: must be greater"),
    "no world": (lambda c: tb.navigate(c / "map/map.yaml", task=tb.Goal(0, 0)), "world: give the world"),
    "a goal in the wall": (
        lambda c: tb.navigate(c / "map", task=tb.Goal(1.5, 0, 0), world=c / "room.yaml"),
        "goal 1.5,0,0: the robot would stand in an obstacle",
    ),
    "no word": (
        lambda c: tb.navigate(c / "map", task=tb.Goal(0, 0), world="empty", initial_pose="x"),
        "^initial_pose: expected X,Y,YAW .*; or start or global",
    ),
    "start in the wall": (lambda c: tb.plan(c / "map", (1.5, 0, 0), (0, 0, 0)), "start 1.5,0,0: the robot"),
    "nothing to report": (lambda c: tb.report(), "report: give one or more outputs"),
    "no output": (lambda c: tb.report(c / "bag.x"), "no such folder"),
    "a path of no kind": (lambda c: tb.map(5), "^source: "),
    "no waypoints": (lambda c: tb.navigate(c / "map", task=tb.Patrol([])), "^waypoints: is empty"),
    "no planner": (
        lambda c: tb.plan(c / "map", (0, 0, 0), (0.5, 0, 0), planner="A*"),
        r"^planner: expected RRTConnect, .* not 'A\*'$",
    ),
    "no mode": (lambda c: tb.navigate(world="empty", task=tb.Avoid(mode="x")), "^mode: must be 'guarded'"),
    "nothing to wiggle on": (
        lambda c: tb.navigate(world="empty", task=tb.Goal(1, 0), wiggle=True),
        "wiggle: needs a map; give --map or remove it$",
    ),
    "an area without corners": (
        lambda c: tb.navigate(c / "map", task=tb.Patrol(), keepout=[[(1, 2)]]),
        "^keepout: ",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_said_in_a_line(name, chain):
    call, said = WRONG[name]
    with pytest.raises(tb.InputError, match=said) as error:
        call(chain)
    assert "\n" not in str(error.value)


def test_an_override_is_a_file_whatever_it_is_called():
    with pytest.raises(InputError, match="keyboard: no such file"):
        tb.navigate(world="empty", task=tb.Avoid(duration=1.0), teleop_override="keyboard")


def test_numbers_and_poses_may_be_numpys():
    tb.Mapper(laser=np.zeros(3), settings={"loops.reach_m": np.float32(3.0), "loops.every": np.int64(9)})


def test_a_table_goes_to_pandas_and_arrow_where_they_are(monkeypatch):
    table = tb.Table({"a": [1, None], "word": ["x", "y"]})
    assert np.isnan(table["a"][1])
    with pytest.raises(tb.InputError, match="no column b; the columns are a, word"):
        table["b"]
    for package, call in (("pandas", table.to_pandas), ("pyarrow", table.to_arrow)):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, package, None)
            with pytest.raises(tb.InputError, match=rf"needs {package}.*pip install 'turtlebag\[tables\]'"):
                call()
    pytest.importorskip("pandas", reason="no pandas here")
    assert table.to_pandas()["word"].tolist() == ["x", "y"]
    pytest.importorskip("pyarrow", reason="no pyarrow here")
    assert table.to_arrow().column_names == ["a", "word"]


@pytest.mark.slow
def test_verbose_shows_what_the_commands_say(chain, capfd):
    tb.verbose()
    try:
        made = tb.plan(chain / "map", (0, 0, 0), (0.5, 0, 0))
    finally:
        tb.verbose(False)
    assert f"-> {made.path}" in capfd.readouterr().err
    tb.plan(chain / "map", (0, 0, 0), (0.5, 0, 0))
    assert capfd.readouterr().err == ""
