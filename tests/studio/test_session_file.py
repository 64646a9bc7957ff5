"""`session.yaml`: what is written, what is read, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.studio.walk import at_the_studio, differences, silent
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.maps import save_map
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.runlog import RunLog
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.navigation.teleop_override import load_script
from turtlebag.pipeline.stages.studio import replay
from turtlebag.pipeline.studio.inputs import At, Plain
from turtlebag.pipeline.studio.journal import Header, Journal, load_session
from turtlebag.sim.robots import load_robot
from turtlebag.sim.simulator import SimConfig, stamp_of

HEAD = "version: 1\nworld: empty\nrobot: burger\nseed: 1\n"


def written(tmp_path, calls):
    journal = Journal(tmp_path / "session.yaml", Header(world="empty", robot="burger", seed=1))
    for call in calls:
        call(journal)
    journal.close()
    return yaml.safe_load((tmp_path / "session.yaml").read_text())["inputs"] or []


def ticks(first, last, asked):
    return [lambda journal, k=k: journal.tick(stamp_of(k), asked) for k in range(first, last)]


def test_a_session_file_appears_with_its_whole_header(tmp_path, monkeypatch):
    begun = []
    rename = Path.rename

    def spy(self, target):
        assert not target.exists()
        begun.append(load_session(self).header.robot)
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", spy)
    assert written(tmp_path, []) == []
    assert begun == ["burger"]
    assert [path.name for path in tmp_path.iterdir()] == ["session.yaml"]


def test_driving_is_written_as_intervals_of_a_second_at_most(tmp_path):
    entries = written(
        tmp_path, [*ticks(0, 75, Twist(0.1, 0.0)), *ticks(75, 80, Twist(0.0, 0.5)), *ticks(80, 81, None)]
    )
    assert entries == [
        {"begin": 0.0, "end": 1.0, "v": 0.1, "w": 0.0},
        {"begin": 1.0, "end": 2.0, "v": 0.1, "w": 0.0},
        {"begin": 2.0, "end": 2.5, "v": 0.1, "w": 0.0},
        {"begin": 2.5, "end": 2.666666667, "v": 0.0, "w": 0.5},
    ]
    script = tmp_path / "teleop_override.yaml"
    script.write_text(yaml.safe_dump(entries))
    assert load_script(script)[-1].end == 2.666666667


def test_what_happens_within_an_interval_stands_where_it_happened(tmp_path):
    goal = At(do="goal", pose=(1.0, 0.5, 0.0))
    actions = [
        lambda journal: journal.action(stamp_of(6), goal),
        lambda journal: journal.action(stamp_of(9), Plain(do="map_start")),
    ]
    asked = Twist(0.1, 0.0)
    entries = written(
        tmp_path, [*ticks(0, 6, asked), actions[0], *ticks(6, 9, asked), actions[1], *ticks(9, 10, None)]
    )
    assert entries == [
        {"begin": 0.0, "end": 0.2, "v": 0.1, "w": 0.0},
        {"at": 0.2, "do": "goal", "pose": [1.0, 0.5, 0.0]},
        {"begin": 0.2, "end": 0.3, "v": 0.1, "w": 0.0},
        {"at": 0.3, "do": "map_start"},
    ]


def test_a_silent_session_says_each_second_that_it_goes_on(tmp_path):
    assert written(tmp_path, ticks(0, 70, None)) == [{"at": 1.0}, {"at": 2.0}]
    recorded = load_session(tmp_path / "session.yaml")
    assert (recorded.actions, recorded.until_ns) == ((), 2 * 10**9)


def test_every_line_is_in_the_file_at_once(tmp_path):
    journal = Journal(tmp_path / "session.yaml", Header(world="empty", robot="burger", seed=1))
    assert load_session(tmp_path / "session.yaml").actions == ()
    journal.action(0, Plain(do="map_start"))
    assert [action.do for _, action in load_session(tmp_path / "session.yaml").actions] == ["map_start"]


def test_settings_come_back_as_they_were_given(tmp_path):
    """Also those that were set to what they are anyway: some count as given only then."""
    given = {
        "sensors": "realistic",
        "lidar": {"errors": {"sigma": 0.02}},
        "faults": {"kidnap": [[3, 0, 0, 1]]},
    }
    sim = SimConfig.model_validate(given)
    Journal(tmp_path / "session.yaml", Header(world="empty", robot="burger", seed=1, sim=sim)).close()
    back = load_session(tmp_path / "session.yaml").header.sim
    assert back == sim
    assert back.model_dump(exclude_unset=True) == sim.model_dump(exclude_unset=True)
    assert back.resolved(load_robot("waffle_pi")) == sim.resolved(load_robot("waffle_pi"))


@pytest.mark.slow
def test_a_map_or_world_that_has_changed_is_refused(tmp_path):
    cells = np.zeros((60, 60), dtype=np.int8)
    cells[0] = 100
    path = save_map(OccupancyGrid(cells, 0.05, SE2.from_xyt(-1.5, -1.5, 0.0)), tmp_path, "room")
    world = tmp_path / "box.yaml"
    world.write_text("name: box\nrobot: burger\nspawn: [0, 0, 0]\nshapes: []\nbounds: [-3, 3, -3, 3]\n")
    with at_the_studio(tmp_path / "live", str(world), map_path=path) as person:
        assert person.view.map_name == ""
        person.wait(0.2)
    assert replay(tmp_path / "live/session.yaml", Output(tmp_path / "again"), say=silent) == 0
    assert differences(tmp_path / "live", tmp_path / "again") == []
    for changed in (tmp_path / "room.pgm", world):
        before = changed.read_bytes()
        changed.write_bytes(before + b"\n")
        with pytest.raises(InputError, match="has changed since the session"):
            replay(tmp_path / "live/session.yaml", Output(tmp_path / "third"), say=silent)
        changed.write_bytes(before)
    path.unlink()
    with pytest.raises(InputError, match="no such map file"):
        replay(tmp_path / "live/session.yaml", Output(tmp_path / "third"), say=silent)


@pytest.mark.slow
def test_a_file_written_by_hand_is_driven_as_it_says(tmp_path):
    """Longer intervals, times between two ticks, and actions after the interval in which they happen."""
    text = (
        "sim: {sensors: clean}\ninputs:\n- {begin: 0.5, end: 2.51, v: 0.1}\n"
        "- {at: 1.01, do: record, name: a}\n- {at: 3, do: end}\n"
    )
    (tmp_path / "session.yaml").write_text(HEAD + text)
    assert replay(tmp_path / "session.yaml", Output(tmp_path / "one"), say=silent) == 0
    log = RunLog.load(tmp_path / "one/runlog.csv")
    taken = log.t_ns[[owner == "teleop" for owner in log.owner]]
    assert (taken[0], taken[-1], log.t_ns[-1]) == (stamp_of(15), stamp_of(75), stamp_of(89))
    recorded = load_session(tmp_path / "one/session.yaml")
    assert recorded.header.sim == SimConfig(sensors="clean")
    assert [(stamp, action.do) for stamp, action in recorded.actions] == [
        (stamp_of(31), "record"),
        (3 * 10**9, "end"),
    ]
    assert replay(tmp_path / "one/session.yaml", Output(tmp_path / "two"), say=silent) == 0
    assert differences(tmp_path / "one", tmp_path / "two") == []
