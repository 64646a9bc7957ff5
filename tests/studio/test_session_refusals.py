"""What a session refuses: in one line, with nothing changed and nothing written down."""

import errno
import math
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from tests.studio.walk import Person
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.maps import save_map
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.studio.inputs import KNOWN, parse_input
from turtlebag.pipeline.studio.session import Session
from turtlebag.pipeline.studio.setup import StudioSetup

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def room_map(tmp_path_factory):
    """A room of 4 m x 4 m about the spawn of the empty world, as a map."""
    cells = np.zeros((80, 80), dtype=np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    folder = tmp_path_factory.mktemp("map")
    return save_map(OccupancyGrid(cells, 0.05, SE2.from_xyt(-2.0, -2.0, 0.0)), folder, "room")


class Refused(Person):
    """Someone whose session writes into a folder of its own."""

    def __init__(self, session, folder):
        super().__init__(session)
        self.folder = folder


@contextmanager
def session_of(setup, folder):
    with Session(setup, folder, lambda line: None) as session:
        yield Refused(session, folder)


@pytest.fixture(scope="module")
def without_map(tmp_path_factory):
    with session_of(StudioSetup("empty"), tmp_path_factory.mktemp("session")) as person:
        yield person


@pytest.fixture(scope="module")
def with_map(tmp_path_factory, room_map):
    with session_of(StudioSetup("empty", map_path=room_map), tmp_path_factory.mktemp("session")) as person:
        yield person


def refused(person, do, **fields):
    """The line; the session's file and its log are as before."""
    file = person.folder / "session.yaml"
    before, view = file.read_text(), person.view
    with pytest.raises(InputError) as error:
        person.do(do, **fields)
    assert file.read_text() == before
    after = person.view
    for same in ("events", "map", "task", "maps", "recording", "boxes", "keepout", "mapping"):
        assert getattr(after, same) is getattr(view, same) or getattr(after, same) == getattr(view, same)
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize(
    ("do", "fields", "said"),
    [
        ("pose_estimate", {"pose": [0, 0, 0]}, "load one first"),
        ("localise_global", {}, "load one first"),
        ("wiggle", {}, "load one first"),
        ("patrol", {"waypoints": [{"pose": [0, 0, 0]}]}, "load one first"),
        ("map_load", {"name": "nowhere"}, "no such map"),
        ("map_load", {}, "no map was given at the start"),
        ("map_save", {"name": "a"}, "there is no map"),
        ("map_save", {"name": "a-keepout"}, "choose another name"),
        ("map_stop", {}, "mapping is not running"),
        ("waypoints_load", {"name": "nowhere"}, "no such file"),
        ("record_stop", {}, "nothing is being recorded"),
        ("cancel", {}, "there is no task to cancel"),
        ("box", {"xy": [0.1, 0.0], "size": 0.2}, "would touch the robot"),
        ("box", {"xy": [0.0, 0.0], "size": 2.0}, "would touch the robot"),
        ("kidnap", {"pose": [500, 0, 0]}, "outside of world"),
    ],
)
def test_without_a_map(without_map, do, fields, said):
    assert said in refused(without_map, do, **fields)


def test_with_a_map_but_no_pose(with_map):
    for do in ("goal", "wiggle"):
        fields = {"pose": [1, 0, 0]} if do == "goal" else {}
        assert "set a pose estimate first" in refused(with_map, do, **fields)
    assert "off the map" in refused(with_map, "pose_estimate", pose=[30, 0, 0])


def test_a_goal_in_a_wall_and_what_lies_off_the_map(with_map):
    with_map.do("pose_estimate", pose=[0, 0, 0])
    assert "in an obstacle" in refused(with_map, "goal", pose=[1.98, 0, 0])
    assert "off the map" in refused(with_map, "goal", pose=[5, 0, 0])
    off = [[5, 5], [6, 5], [6, 6]]
    assert "keepout 2: outside the map" in refused(
        with_map, "keepout", outlines=[[[0.5, 0.5], [1, 0.5], [1, 1]], off]
    )
    assert with_map.view.map_name == ""


def test_a_bag_at_a_time_and_a_name_only_once(without_map):
    without_map.do("record", name="one")
    without_map.wait(0.1)
    assert "one is being recorded" in refused(without_map, "record", name="two")
    without_map.do("record_stop")
    said = "record: a bag one already exists; choose another name"
    assert refused(without_map, "record", name="one") == said
    assert without_map.view.recording is None


def test_too_little_mapped(without_map):
    without_map.do("map_start")
    assert "mapping is already running" in refused(without_map, "map_start")
    assert "drive on a little" in refused(without_map, "map_save", name="early")
    without_map.do("map_stop")


def test_a_full_disk_is_named_by_the_folder(without_map, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    said = refused(without_map, "waypoints_save", name="a", waypoints=[{"pose": [0, 0, 0]}])
    assert said == f"waypoints_save: {without_map.folder}: No space left on device"


def test_nothing_after_the_end(tmp_path):
    with session_of(StudioSetup("empty"), tmp_path) as person:
        person.do("end")
        stamp = person.session.stamp_ns
        person.wait(0.2)
        assert person.session.stamp_ns == stamp
        assert "the session is over" in refused(person, "avoid")
        assert "the session is over" in refused(person, "drive", v=0.1)


BAD = [
    3,
    {},
    {"do": "fly"},
    {"do": ["goal"]},
    {"do": "goal"},
    {"do": "goal", "pose": [0, 0]},
    {"do": "goal", "pose": [0, math.nan, 0]},
    {"do": "goal", "pose": [1e9, 0, 0]},
    {"do": "goal", "pose": [True, 0, 0]},
    {"do": "goal", "pose": ["1", 0, 0]},
    {"do": "drive", "v": False},
    {"do": "patrol", "waypoints": [{"pose": [0, 0, 0]}], "laps": True},
    {"do": "stop", "now": True},
    {"do": "record", "name": "../up"},
    {"do": "record", "name": ""},
    {"do": "record", "name": "line\n"},
    {"do": "patrol", "waypoints": []},
    {"do": "patrol", "waypoints": [{"pose": [0, 0, 0], "wait": -1}]},
    {"do": "keepout", "outlines": [[[0, 0], [1, 1]]]},
    {"do": "box", "xy": [0, 0], "size": 0},
    {"do": "x\ny" * 50},
    {"do": "stop", "x\ny" * 50: 1},
]


@pytest.mark.parametrize("data", BAD, ids=range(len(BAD)))
def test_an_input_that_is_none_is_refused_in_one_short_line(data):
    with pytest.raises(InputError) as error:
        parse_input(data)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 500


def test_every_input_of_the_design_is_known():
    driving = {"drive", "stop", "release"}
    maps = {"map_start", "map_stop", "map_save", "map_load", "pose_estimate", "localise_global", "keepout"}
    tasks = {"goal", "patrol", "waypoints_save", "waypoints_load", "avoid", "explore", "wiggle", "cancel"}
    rest = {"record", "record_stop", "kidnap", "box", "reset", "end"}
    bags = {"seek", "map_build", "loop_show", "loop_reject", "loop_add", "edits_clear"}
    assert set(KNOWN) == driving | maps | tasks | rest | bags
