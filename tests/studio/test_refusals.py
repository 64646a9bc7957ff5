"""What the studio refuses: in one line, with nothing changed and nothing written, as tables of what was asked
and what is said.
"""

import errno
import json
import math
import re
import socket
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.refusals import require_refused
from tests.studio.room_bag import LAST, write_bag
from tests.studio.walk import Person, silent
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.maps import save_map
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.stages.studio import studio_output
from turtlebag.pipeline.studio.inputs import KNOWN, parse_message
from turtlebag.pipeline.studio.setup import BagSetup, StudioSetup

pytestmark = pytest.mark.slow

AGAIN = "--replay session.yaml --out x"
COMMANDS = {
    "--port {port}": "--port {port}: in use; choose another, or leave it out for a free one",
    "--port 70000": "...must be a port from 1 to 65535...",
    "--host 192.0.2.1": "--host 192.0.2.1: ...; give an address of this machine",
    "--host 'no such host'": "--host no such host: ...; give an address of this machine",
    "--world nowhere": "...nowhere...",
    "--map no.yaml": "...no.yaml...",
    "--set sim.wheels=9": "...sim.wheels...",
    "--replay session.yaml": "--replay: needs --out DIR...",
    f"{AGAIN} --seed 0": "--seed: cannot be used with --replay...",
    f"{AGAIN} --set sim.a=1": "--set: cannot be used with --replay...",
    "--replay none.yaml --out x": "none.yaml: ...",
}
"""Words of `turtlebag studio --no-browser`, and how its line goes on; an ellipsis stands for anything."""


@pytest.mark.parametrize("words", COMMANDS)
def test_a_studio_that_cannot_be_opened_is_one_line(tmp_path, monkeypatch, capsys, words):
    monkeypatch.chdir(tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        said = COMMANDS[words].format(port=port)
        require_refused(f"studio --no-browser {words.format(port=port)}", said, tmp_path, capsys)


HEAD = "version: 1\nworld: empty\nrobot: burger\nseed: 1\n"
FILES = [
    ("- 3\n", "expected keys and values"),
    (HEAD.replace("version: 1", "version: 2"), "version"),
    (HEAD.replace("empty", "nowhere"), "unknown world 'nowhere'"),
    (HEAD.replace("burger", "bulldozer"), "bulldozer"),
    (f"{HEAD}colour: red\n", "colour: unknown key"),
    (f"{HEAD}map: nowhere.yaml\n", "nowhere.yaml: no such map file"),
    (f"{HEAD}sha256: {{map: abc}}\n", "has changed since the session"),
    (f"{HEAD}inputs: 3\n", "inputs: expected a list"),
]
ENTRIES = [
    ("3", "input 1: expected keys and values"),
    ("{at: -1, do: avoid}", "input 1: at: must be 0 to"),
    ("{at: .nan, do: avoid}", "input 1: at: must be 0 to"),
    ("{at: 1, do: dance}", "input 1: 'dance' is not an input"),
    (f'{{at: 1, do: "{"x y" * 50}"}}', "input 1: that is not an input"),
    ("{at: 1, do: [goal]}", "input 1: that is not an input"),
    ("{at: 1, do: drive, v: 1}", "input 1: drive: write it as an interval"),
    ("{at: 1, do: goal, pose: [0, 0]}", "input 1: goal: pose.2"),
    ("{at: 2, do: avoid}\n- {at: 1, do: cancel}", "input 2: at 1 s, before the previous"),
    ("{at: 2, do: end}\n- {at: 3, do: avoid}", "input 2: comes after"),
    ("{begin: 2, end: 1}", "input 1"),
    ("{begin: 2, end: 1.0e+8}", "input 1: end: must be less than"),
    ("{begin: 0, end: 2}\n- {begin: 1, end: 3}", "overlap"),
    ("{begin: 0, end: 1, u: 3}", "u: unknown key"),
    ("{at: 0.2, do: patrol, waypoints: [{pose: [0, 0, 0]}]}", "at 0.2 s: patrol: needs a map"),
]
SESSIONS = [*FILES, *((f"{HEAD}inputs:\n- {entries}\n", said) for entries, said in ENTRIES)]
"""A session file, and what is said of it."""


@pytest.mark.parametrize(("text", "said"), SESSIONS, ids=range(len(SESSIONS)))
def test_a_session_that_cannot_be_driven_is_one_line(tmp_path, monkeypatch, capsys, text, said):
    (tmp_path / "session.yaml").write_text(text)
    monkeypatch.chdir(tmp_path)
    require_refused(f"studio {AGAIN}", f"...{said}...", tmp_path, capsys)


NAME = "name: must match pattern"
MESSAGES = [
    ({"do": "goal"}, "goal: pose: is missing"),
    ({"do": "goal", "pose": [0, 0]}, "goal: pose.2: is missing"),
    ({"do": "goal", "pose": [0, math.nan, 0]}, "goal: pose.1: must be a finite number"),
    ({"do": "goal", "pose": [1e9, 0, 0]}, "goal: pose.0: must be less than or equal to 10000"),
    ({"do": "goal", "pose": [True, 0, 0]}, "goal: pose.0: must be a valid number"),
    ({"do": "goal", "pose": ["1", 0, 0]}, "goal: pose.0: must be a valid number"),
    ({"do": "drive", "v": False}, "drive: v: must be a valid number"),
    ({"do": "drive", "v": math.inf, "w": 0}, "drive: v: must be a finite number"),
    ({"do": "drive", "x": 1}, "drive: x: unknown key"),
    ({"do": "stop", "now": True}, "stop: now: unknown key"),
    ({"do": "stop", "x\ny" * 50: 1}, "stop: x y"),
    ({"do": "patrol", "waypoints": [{"pose": [0, 0, 0]}], "laps": True}, "patrol: laps: must be a valid int"),
    ({"do": "patrol", "waypoints": []}, "patrol: waypoints: must have at least 1 item"),
    ({"do": "patrol", "waypoints": [{"pose": [0, 0, 0], "wait": -1}]}, "patrol: waypoints.0.wait: must be"),
    ({"do": "keepout", "outlines": [[[0, 0], [1, 1]]]}, "keepout: outlines.0: must have at least 3 items"),
    ({"do": "box", "xy": [0, 0], "size": 0}, "box: size: must be greater than or equal to 0.05"),
    ({"do": "map_save", "name": "../../etc/passwd"}, f"map_save: {NAME}"),
    *(({"do": "record", "name": name}, f"record: {NAME}") for name in ("../up", "a/b", "", "line\n")),
    ({"do": "loop_reject", "scan": 5, "place": 5}, "loop_reject: scan and place are the same scan"),
    ({"do": "loop_add", "scan": 5, "place": 5, "pose": [0, 0, 0]}, "loop_add: scan and place are the same"),
    ({"do": "speed", "factor": -1}, "speed: "),
    ({"do": "layers", "layers": ["x"] * 100}, "layers: "),
]
"""A message of a page, and what is said of it."""


@pytest.mark.parametrize(("message", "said"), MESSAGES, ids=range(len(MESSAGES)))
def test_a_message_without_sense_is_one_short_line(message, said):
    with pytest.raises(InputError, match=f"^(page: )?{re.escape(said)}") as error:
        parse_message(json.dumps(message))
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 300


@pytest.fixture(scope="module")
def room_map(tmp_path_factory):
    """A room of 4 m x 4 m about the spawn of the empty world, as a map."""
    cells = np.zeros((80, 80), dtype=np.int8)
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    folder = tmp_path_factory.mktemp("map")
    return save_map(OccupancyGrid(cells, 0.05, SE2.from_xyt(-2.0, -2.0, 0.0)), folder, "room")


@contextmanager
def at_a_studio(setup, folder):
    """Somebody there, and the folder that the session writes into."""
    with studio_output(setup, Output(folder / "out"), say=silent) as session:
        person = Person(session)
        person.folder = folder / "out.partial"
        yield person


@pytest.fixture(scope="module")
def without_map(tmp_path_factory):
    with at_a_studio(StudioSetup("empty"), tmp_path_factory.mktemp("session")) as person:
        yield person


@pytest.fixture(scope="module")
def with_map(tmp_path_factory, room_map):
    setup = StudioSetup("empty", map_path=room_map)
    with at_a_studio(setup, tmp_path_factory.mktemp("session")) as person:
        yield person


@pytest.fixture(scope="module")
def located(tmp_path_factory, room_map):
    setup = StudioSetup("empty", map_path=room_map)
    with at_a_studio(setup, tmp_path_factory.mktemp("session")) as person:
        person.do("pose_estimate", pose=[0, 0, 0])
        yield person


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    folder = tmp_path_factory.mktemp("session")
    with at_a_studio(BagSetup(write_bag(folder / "bag")), folder) as person:
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


HERE = {"pose": [0, 0, 0]}
INSIDE, OUTSIDE = [[0.5, 0.5], [1, 0.5], [1, 1]], [[5, 5], [6, 5], [6, 6]]
NO_ROBOT = "while a bag is played"
ASKED = {
    "without_map": [
        ("pose_estimate", HERE, "load one first"),
        ("localise_global", {}, "load one first"),
        ("wiggle", {}, "load one first"),
        ("patrol", {"waypoints": [HERE]}, "load one first"),
        ("map_load", {"name": "nowhere"}, "no such map"),
        ("map_load", {}, "no map was given at the start"),
        ("map_save", {"name": "a"}, "there is no map"),
        ("map_save", {"name": "a-keepout"}, "choose another name"),
        ("map_stop", {}, "mapping is not running"),
        ("waypoints_load", {"name": "nowhere"}, "no such file"),
        ("record_stop", {}, "nothing is being recorded"),
        ("cancel", {}, "there is no task to cancel"),
        ("seek", {"t": 1.0}, "seek: no bag is being played"),
        ("box", {"xy": [0.1, 0.0], "size": 0.2}, "would touch the robot"),
        ("box", {"xy": [0.0, 0.0], "size": 2.0}, "would touch the robot"),
        ("kidnap", {"pose": [500, 0, 0]}, "outside of world"),
    ],
    "with_map": [
        ("goal", {"pose": [1, 0, 0]}, "set a pose estimate first"),
        ("wiggle", {}, "set a pose estimate first"),
        ("pose_estimate", {"pose": [30, 0, 0]}, "off the map"),
        ("keepout", {"outlines": [INSIDE, OUTSIDE]}, "keepout 2: outside the map"),
    ],
    "located": [
        ("goal", {"pose": [1.98, 0, 0]}, "in an obstacle"),
        ("goal", {"pose": [5, 0, 0]}, "off the map"),
    ],
    "played": [
        ("goal", HERE, NO_ROBOT),
        ("record", {"name": "a"}, NO_ROBOT),
        ("drive", {"v": 0.1}, NO_ROBOT),
        ("seek", {"t": 31.0}, "seek: the bag ends after 29.8 s"),
        ("map_stop", {}, "mapping is not running"),
        ("loop_show", {"scan": LAST, "place": 0}, "map the bag first"),
        ("loop_reject", {"scan": 999, "place": 0}, "has no scan 999"),
    ],
}
"""What is asked of a session that is so far, and what is said of it."""


@pytest.mark.parametrize(
    ("state", "do", "fields", "said"),
    [pytest.param(state, *row, id=f"{state}-{row[0]}") for state, rows in ASKED.items() for row in rows],
)
def test_what_a_session_cannot_do_is_one_line_and_changes_nothing(request, state, do, fields, said):
    assert said in refused(request.getfixturevalue(state), do, **fields)


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
    with at_a_studio(StudioSetup("empty"), tmp_path) as person:
        person.do("end")
        stamp = person.session.stamp_ns
        person.wait(0.2)
        assert person.session.stamp_ns == stamp
        assert "the session is over" in refused(person, "avoid")
        assert "the session is over" in refused(person, "drive", v=0.1)


def test_every_input_of_the_design_is_known():
    driving = {"drive", "stop", "release"}
    maps = {"map_start", "map_stop", "map_save", "map_load", "pose_estimate", "localise_global", "keepout"}
    tasks = {
        "goal",
        "patrol",
        "waypoints",
        "waypoints_save",
        "waypoints_load",
        "avoid",
        "explore",
        "wiggle",
        "cancel",
    }
    rest = {"record", "record_stop", "kidnap", "box", "reset", "end"}
    bags = {
        "seek",
        "map_build",
        "loop_show",
        "loop_reject",
        "loop_add",
        "edits_clear",
        "wall_draw",
        "wall_erase",
        "wall_undo",
    }
    assert set(KNOWN) == driving | maps | tasks | rest | bags
