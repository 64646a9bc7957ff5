"""The graph file: saved, read back exactly, and extended."""

import json
import math
from dataclasses import fields, replace

import gtsam
import numpy as np
import pytest

from tests.helpers.carmen_lines import carmen_text
from tests.helpers.slam_rooms import ROOM, SICK, around_the_room, drifted, recording
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.trajectories import load_tum, save_tum
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.slam.graph.constraints import Loop
from turtlebag.pipeline.slam.graph.pose_graph import write_g2o
from turtlebag.pipeline.slam.mapper import SlamConfig, continue_slam, run_slam
from turtlebag.pipeline.slam.session_file import FILE, FORMAT, load_session, save_session

pytestmark = pytest.mark.slow

FIRST = around_the_room(60)
SECOND = around_the_room(50) + np.array([0.1, 0.1, 0.0])


@pytest.fixture(scope="module")
def first():
    return recording(ROOM, FIRST, SICK, odometry=drifted(FIRST))


@pytest.fixture(scope="module")
def result(first):
    return run_slam(first, SlamConfig())


def second():
    elsewhere = SE2.from_xyt(-4.0, 9.0, -2.2) @ SE2.from_array(SECOND)
    log = recording(ROOM, SECOND, SICK, odometry=drifted(elsewhere.xyt, seed=3), seed=7)
    return replace(log, stamps_ns=log.stamps_ns + 10**12)


def assert_same(a, b):
    assert type(a) is type(b)
    if isinstance(a, np.ndarray):
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)
    elif isinstance(a, SE2):
        np.testing.assert_array_equal(a.xyt, b.xyt)
    elif isinstance(a, list | tuple):
        assert len(a) == len(b)
        for one, other in zip(a, b, strict=True):
            assert_same(one, other)
    elif hasattr(a, "__dataclass_fields__"):
        for field in fields(a):
            if field.name != "key":
                assert_same(getattr(a, field.name), getattr(b, field.name))
    else:
        assert a == b or (isinstance(a, float) and np.isnan(a) and np.isnan(b))


def test_session_is_read_back_to_the_last_bit(tmp_path, result):
    loops = [
        Loop(3, 0, np.array([0.1, 0.2, 0.3]), 0.7, 0.8, 0.01, 1e4 * np.eye(3), "accepted", gate_m=0.9),
        Loop(2, 0, np.zeros(3), 0.4, 0.0, 0.0, np.eye(3), "low score", gate_m=math.inf),
    ]
    recognised = [Loop(3, 1, np.ones(3), 0.6, 0.7, 0.02, np.eye(3), "too few agree", violation=0.01)]
    graph = replace(result.session.graph, loops=loops, recognised=recognised)
    recording = replace(result.session.recording, odometry=None)
    session = replace(result.session, recording=recording, graph=graph)
    save_session(tmp_path / FILE, session, SlamConfig())
    again, config = load_session(tmp_path)
    assert config == SlamConfig()
    assert_same(again, session)
    before = (tmp_path / FILE).read_bytes()
    save_session(tmp_path / FILE, again, config)
    assert (tmp_path / FILE).read_bytes() == before


def test_going_on_from_a_file_is_the_same_as_mapping_both(tmp_path, first, result):
    both = run_slam(first, SlamConfig(), more=[second()])
    save_session(tmp_path / FILE, result.session, SlamConfig())
    continued = continue_slam(load_session(tmp_path)[0], [second()], SlamConfig())
    np.testing.assert_array_equal(continued.trajectory.poses.xyt, both.trajectory.poses.xyt)
    np.testing.assert_array_equal(continued.grid.cells, both.grid.cells)
    assert len(continued.trajectory) == 110


FRONT_END = [
    "usable_range_m=4.5",
    "sensors=lidar",
    "deskew=false",
    "gyro=false",
    "tracking.odometry.share=0.06",
]
LATER = ["loops.enabled=false", "grid.resolution_m=0.1", "refine.rounds=0"]


@pytest.fixture(scope="module")
def saved(tmp_path_factory, first):
    """Folder with logs first.clf and second.clf, and the map of the first."""
    folder = tmp_path_factory.mktemp("saved")
    for name, log in (("first", first), ("second", second())):
        (folder / f"{name}.clf").write_text(carmen_text(log))
    assert main(["map", str(folder / "first.clf"), "--out", str(folder / "map"), "-q"]) == 0
    return folder


def mapped(out, *words):
    assert main(["map", *map(str, words), "--out", str(out), "-q"]) == 0
    return out


def test_command_goes_on_with_an_earlier_map(saved, tmp_path):
    both = mapped(tmp_path / "both", saved / "first.clf", "--also", saved / "second.clf")
    on = mapped(tmp_path / "on", saved / "second.clf", "--continue", saved / "map")
    for name in ("map.pgm", "map.yaml", "trajectory.tum", "graph.g2o", "graph.json", "metrics.json", FILE):
        assert (on / name).read_bytes() == (both / name).read_bytes(), name
    assert json.loads((on / "metrics.json").read_text())["scans"] == 110
    assert "continued" in json.loads((on / "manifest.json").read_text())["inputs"]


def going_on(saved, folder):
    """The command that goes on with the saved map."""
    return f"map {saved / 'second.clf'} --continue {saved / 'map'} --out {folder / 'on'}".split()


@pytest.mark.parametrize("setting", FRONT_END)
def test_going_on_with_another_front_end_names_the_setting_and_both_values(saved, tmp_path, capsys, setting):
    assert main([*going_on(saved, tmp_path), "--set", setting]) == 2
    error = capsys.readouterr().err
    key, now = setting.split("=")
    was = SlamConfig().model_dump(mode="json")
    for part in key.split("."):
        was = was[part]
    assert error.count("\n") == 1
    assert f"{key}={json.dumps(was)}, not " in error
    assert now.strip('"') in error
    assert list(tmp_path.iterdir()) == []


def test_settings_of_all_that_comes_after_the_front_end_may_change_and_that_is_said(saved, tmp_path, capsys):
    settings = [word for setting in LATER for word in ("--set", setting)]
    assert main([*going_on(saved, tmp_path), *settings]) == 0
    said = capsys.readouterr().err
    assert [key for key in LATER if f"{key.split('=')[0]} was " not in said] == []
    assert load_session(tmp_path / "on")[1].refine.rounds == 0


def test_a_map_goes_on_with_the_settings_it_was_made_with(saved, tmp_path):
    near = ("--set", "usable_range_m=4.5")
    first = mapped(tmp_path / "first", saved / "first.clf", *near)
    both = mapped(tmp_path / "both", saved / "first.clf", *near, "--also", saved / "second.clf")
    on = mapped(tmp_path / "on", saved / "second.clf", *near, "--continue", first)
    for name in ("map.pgm", "trajectory.tum", FILE):
        assert (on / name).read_bytes() == (both / name).read_bytes(), name


def test_graph_of_another_version_is_to_be_mapped_again(tmp_path, result):
    save_session(tmp_path / FILE, result.session, SlamConfig())
    with np.load(tmp_path / FILE) as stored:
        arrays = {name: stored[name] for name in stored.files}
    this, other = (f'"format": {number}'.encode() for number in (FORMAT, FORMAT - 1))
    about = bytes(arrays["about"])
    assert about.count(this) == 1
    np.savez(tmp_path / FILE, **arrays | {"about": np.frombuffer(about.replace(this, other), np.uint8)})
    told = rf"graph\.npz: .*format {FORMAT - 1}, but this version reads {FORMAT}; map its recording again"
    with pytest.raises(InputError, match=told):
        load_session(tmp_path)


@pytest.mark.parametrize("damage", ["absent", "cut", "no zip", "changed"])
def test_graph_that_cannot_be_read_is_refused(tmp_path, result, damage):
    path = tmp_path / FILE
    if damage != "absent":
        save_session(path, result.session, SlamConfig())
        whole = path.read_bytes()
        if damage == "cut":
            path.write_bytes(whole[: len(whole) // 2])
        elif damage == "no zip":
            path.write_text("nothing")
        else:
            middle = len(whole) // 2
            path.write_bytes(whole[:middle] + bytes(64) + whole[middle + 64 :])
    with pytest.raises(InputError, match=r"graph\.npz"):
        load_session(tmp_path)


WRONG = {
    "a loop that points at no key": ("constraint_j", lambda a: a + 10**6),
    "keys out of order": ("track_keys", lambda a: a[::-1]),
    "keys before the log": ("track_keys", lambda a: a - 1),
    "poses that are no numbers": ("T_map_keys", lambda a: a * np.nan),
    "poses beyond the earth": ("track_T_track_base", lambda a: a * 0.0 + 1e300),
    "fractions of nanoseconds": ("stamps_ns", lambda a: a + 0.5),
    "words": ("noise", lambda a: np.array(["x"] * 3)),
    "one step too few": ("breaks_broken", lambda a: a[1:]),
    "no mounting": ("T_base_lidar", lambda a: a[:2]),
    "a scan too few": ("ranges", lambda a: a[:-1]),
    "settings that are none": (
        "about",
        lambda a: np.frombuffer(bytes(a).replace(b": 30.0", b": -3.0"), np.uint8),
    ),
    "a lidar of words": ("about", lambda a: np.frombuffer(bytes(a).replace(b"25", b'"x"'), np.uint8)),
}


@pytest.mark.parametrize("what", WRONG)
def test_graph_whose_arrays_compiled_code_would_trip_over_is_refused(tmp_path, result, what):
    path, (name, change) = tmp_path / FILE, WRONG[what]
    save_session(path, result.session, SlamConfig())
    with np.load(path) as stored:
        arrays = {name: stored[name] for name in stored.files}
    changed = change(arrays[name])
    assert changed.shape != arrays[name].shape or (changed != arrays[name]).any()
    np.savez(path, **{**arrays, name: changed})
    with pytest.raises(InputError, match=r"graph\.npz") as refusal:
        load_session(tmp_path)
    assert "\n" not in str(refusal.value)


def test_g2o_and_tum_are_read_back_as_they_are(tmp_path, result):
    write_g2o(tmp_path / "graph.g2o", result.T_map_keys, result.constraints)
    graph, values = gtsam.readG2o(str(tmp_path / "graph.g2o"), False)
    T_read = [values.atPose2(k) for k in range(len(result.keys))]
    read = np.array([[T.x(), T.y(), T.theta()] for T in T_read])
    np.testing.assert_allclose(read, result.T_map_keys.xyt, rtol=0.0, atol=1e-9)
    assert graph.size() == len(result.constraints)
    for k, constraint in enumerate(result.constraints):
        factor = graph.at(k)
        measured = factor.measured()
        found = [measured.x(), measured.y(), measured.theta()]
        np.testing.assert_allclose(found, constraint.T_i_j, rtol=1e-8, atol=1e-9)
        assert list(factor.keys()) == [constraint.i, constraint.j]
    save_tum(result.trajectory, tmp_path / "trajectory.tum")
    again = load_tum(tmp_path / "trajectory.tum")
    np.testing.assert_array_equal(again.stamps_ns, result.trajectory.stamps_ns)
    np.testing.assert_allclose(again.poses.xyt, result.trajectory.poses.xyt, rtol=0.0, atol=1e-8)
