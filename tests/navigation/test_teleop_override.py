"""Teleop overrides: one owner a tick, the log and the bag say which, and navigation goes on afterwards."""

import itertools
import json
import os
import signal
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import Output, sha256_tree
from turtlebag.datasets.runlog import RunLog
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.navigation.config import NavigateConfig
from turtlebag.pipeline.navigation.mission import Request
from turtlebag.pipeline.navigation.teleop_override import Interval, Script, TeleopOverrideConfig, load_script
from turtlebag.pipeline.stages.navigate import navigate
from turtlebag.pipeline.terminal.keyboard_teleop import OverrideKeys
from turtlebag.planners.tasks.patrol import GoalSequence, SequenceConfig
from turtlebag.planners.tasks.waypoints import Waypoint
from turtlebag.reports.metrics.navigation import overrides
from turtlebag.sim.robots import load_robot
from turtlebag.sim.worlds import load_world

WORLD = "turtlebot3_world"
ARENA, BURGER = load_world(WORLD), load_robot("burger")
S = 10**9
SCRIPT = (Interval(begin=2.0, end=3.0, v=-0.05, w=0.6), Interval(begin=3.0, end=4.5, v=0.15))


def goal_run(out: Path, true_map: Path, script=(), source=None) -> dict:
    request = Request(
        task="goal",
        seed=1,
        map_path=true_map,
        initial_pose="start",
        goal=SE2.from_xyt(-0.6, -1.6, 1.2),
        teleop_override=source,
    )
    config = NavigateConfig(teleop_override=TeleopOverrideConfig(script=script))
    assert navigate(ARENA, BURGER, request, Output(out), config=config, say=lambda line: None) == 0
    return json.loads((out / "metrics.json").read_text())


@pytest.fixture(scope="module")
def taken(true_map, tmp_path_factory):
    out = tmp_path_factory.mktemp("taken") / "run"
    return out, goal_run(out, true_map, SCRIPT)


def owners_in(bag: Path) -> list[tuple[int, str]]:
    with AnyReader([bag]) as reader:
        wanted = [c for c in reader.connections if c.topic == "/cmd_vel_owner"]
        return [(t, reader.deserialize(raw, c.msgtype).data) for c, t, raw in reader.messages(wanted)]


@pytest.mark.slow
def test_the_goal_is_reached_after_an_override_and_metrics_count_it(taken):
    _, metrics = taken
    assert metrics["goals"][0]["status"] == "reached"
    assert metrics["overrides"] == {"count": 1, "time_s": pytest.approx(2.5)}
    assert metrics["collisions"] == {"visible": 0, "low": 0}


@pytest.mark.slow
def test_log_and_bag_say_who_owned_each_tick(taken):
    out, _ = taken
    log = RunLog.load(out / "runlog.csv")
    owned = np.array([owner == "teleop" for owner in log.owner])
    np.testing.assert_array_equal(owned, (log.t_ns >= 2 * S) & (log.t_ns < 4.5 * S))
    assert {state for state, mine in zip(log.state, owned, strict=True) if mine} == {"teleop"}
    assert owners_in(out / "bag") == [(2 * S, "teleop"), (4500000000, "navigation")]


@pytest.mark.slow
def test_what_was_asked_for_is_driven_within_the_limits(taken):
    log = RunLog.load(taken[0] / "runlog.csv")
    last_of_first = int(np.searchsorted(log.t_ns, 3 * S)) - 1
    assert (log.v[last_of_first], log.w[last_of_first]) == (-0.05, 0.6)
    assert log.v[log.t_ns < 4.5 * S][-1] == 0.15
    assert np.abs(np.diff(log.v)).max() <= load_robot("burger").model.max_dv / 30.0 + 1e-5


@pytest.mark.slow
def test_a_run_drives_again_from_its_own_override_file(taken, true_map, tmp_path):
    out, metrics = taken
    assert load_script(out / "teleop_override.yaml") == SCRIPT
    assert goal_run(tmp_path / "again", true_map, source=out / "teleop_override.yaml") == metrics
    for name in ("teleop_override.yaml", "runlog.csv", "trajectory.tum"):
        assert (tmp_path / "again" / name).read_bytes() == (out / name).read_bytes(), name


@pytest.mark.slow
def test_the_monitor_stops_an_override_short_of_a_wall_unless_it_is_off(tmp_path):
    push = (Interval(begin=0.0, end=9.0, v=0.2),)
    contacts = {}
    for monitored in (True, False):
        config = NavigateConfig(teleop_override=TeleopOverrideConfig(script=push, monitor=monitored))
        request = Request(task="avoid", seed=1, duration_s=9.0, start=SE2.from_xyt(-2.0, -0.5, np.pi))
        navigate(
            ARENA, BURGER, request, Output(tmp_path / str(monitored)), config=config, say=lambda line: None
        )
        metrics = json.loads((tmp_path / str(monitored) / "metrics.json").read_text())
        contacts[monitored] = metrics["collisions"]["visible"]
    assert contacts == {True: 0, False: 1}


def test_the_goals_time_and_the_wait_before_it_stand_meanwhile():
    sequence = GoalSequence([Waypoint(SE2.identity())], SequenceConfig(initial_wait=3.0, timeout=60.0))
    sequence.update(0)
    sequence.postpone(10 * S)
    assert sequence.update(12 * S) is None
    assert sequence.update(13 * S) is not None
    sequence.postpone(100 * S)
    assert sequence.update(173 * S - 1) is not None
    assert sequence.update(173 * S) is None
    assert sequence.outcomes[0].status == "timeout"


def test_any_driving_key_takes_over_and_q_hands_back():
    typed = iter(["", "w", "a", "", "q", "", " ", "\n"])
    keys = OverrideKeys(
        load_robot("burger").limits, lambda: next(typed), lambda time_s: None, lambda text: None
    )
    asked = [keys.asked(k) for k in range(8)]
    w, wa = Twist(0.01, 0.0), Twist(0.01, 0.1)
    assert asked == [None, w, wa, wa, None, None, Twist(), None]


def test_the_end_of_a_pipe_hands_back():
    typed = itertools.chain(["ww"], itertools.repeat("q"))
    keys = OverrideKeys(
        load_robot("burger").limits, lambda: next(typed), lambda time_s: None, lambda text: None
    )
    assert [keys.asked(k) for k in range(3)] == [Twist(0.02, 0.0), None, None]


@pytest.mark.slow
def test_ctrl_c_during_a_keyboard_override_keeps_the_drive(true_map, tmp_path, monkeypatch, capfd):
    now_s = [0.0]

    def sleep(seconds):
        now_s[0] += seconds
        if now_s[0] >= 3.0 - 1e-6:
            signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)  # ignored, where the tests run in the background
    reader, writer = os.pipe()
    os.write(writer, b"w" * 5)
    out = tmp_path / "run"
    words = [
        "navigate",
        "--world",
        WORLD,
        "--task",
        "patrol",
        "--map",
        str(true_map),
        "--initial-pose",
        "start",
    ]
    with os.fdopen(reader) as stdin, os.fdopen(writer, "wb"):
        monkeypatch.setattr("sys.stdin", stdin)
        monkeypatch.setattr("time.sleep", sleep)
        monkeypatch.setattr("time.monotonic", lambda: now_s[0])
        assert main([*words, "--teleop-override", "keyboard", "--out", str(out)]) == 130
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["time_s"] == pytest.approx(3.0)
    assert metrics["overrides"]["count"] == 1
    assert {goal["reason"] for goal in metrics["goals"]} == {"the run was interrupted"}
    assert {"bag/metadata.yaml", "teleop_override.yaml", "trajectory.tum"} <= set(sha256_tree(out))
    assert (out / "manifest.json").is_file()
    assert "the run so far is kept" in capfd.readouterr().err
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.slow
@pytest.mark.parametrize("noise", ["-q", "-v"])
def test_the_table_of_keys_is_shown_unless_it_is_to_be_quiet(tmp_path, monkeypatch, capsys, noise):
    with open(os.devnull) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        words = ["navigate", noise, "--world", WORLD, "--task", "avoid", "--duration", "1"]
        words += [
            "--teleop-override",
            "keyboard",
            "--set",
            "teleop_override.speed=50",
            "--out",
            str(tmp_path / "run"),
        ]
        assert main(words) == 0
    out, err = capsys.readouterr()
    assert ("hand back" in err, bool(out)) == (noise == "-v", noise == "-v")
    assert noise == "-v" or err == ""


def test_intervals_that_touch_are_one_override():
    stamps = np.arange(6) * S
    assert overrides(stamps, ["navigation", "teleop", "teleop", "navigation", "teleop", "navigation"]) == {
        "count": 2,
        "time_s": 3.0,
    }
    script = Script(SCRIPT)
    found = [script.asked(t) for t in (0, 2 * S, 3 * S - 1, 3 * S, 4500000000)]
    assert found == [None, Twist(-0.05, 0.6), Twist(-0.05, 0.6), Twist(0.15, 0.0), None]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("7", "list of intervals"),
        ("- {begin: 1, end: 1}", "must end after"),
        ("- {begin: 1, end: 2}\n- {begin: 1.5, end: 3}", "overlap"),
        ("- {begin: 1, end: 2, vv: 1}", "unknown key"),
        ("- {begin: 1, end: .nan}", "finite"),
        ("- {begin: 1, end: 1.0e300}", "less than or equal"),
    ],
)
def test_bad_override_files_are_one_line(tmp_path, capsys, text, said):
    path = tmp_path / "t.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        load_script(path)
    words = ["navigate", "--world", WORLD, "--task", "avoid", "--teleop-override", str(path)]
    assert main([*words, "--out", str(tmp_path / "run")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "run").exists()
