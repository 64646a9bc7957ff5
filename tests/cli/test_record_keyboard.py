"""Keyboard teleop: steps and limits of the keys, stopping, the bag, the status line."""

import os

import numpy as np
import pytest

from turtlebag.datasets.bags.reader import read_commands
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.stages.record import Scene, record_drive
from turtlebag.pipeline.terminal.keyboard_teleop import KeyState, StatusLine, keyboard_driver, keys_of
from turtlebag.sim.robots import load_robot

BURGER = load_robot("burger")


def pressed(keys, style="keys"):
    state = KeyState(BURGER.limits, style)
    for key in keys:
        state.press(key)
    return state


def test_keys_move_by_their_steps():
    assert pressed("wwwa").command == Twist(pytest.approx(0.03), pytest.approx(0.1))
    assert pressed("WwsDd").command == Twist(pytest.approx(0.01), pytest.approx(-0.2))
    assert pressed("wwss").command == Twist(0.0, 0.0)
    for stop in "x X".replace(" ", "") + " ":
        assert pressed("wwwaa" + stop).command == Twist(0.0, 0.0)


def test_limits_of_the_robot_are_kept():
    assert pressed("w" * 100 + "a" * 100).command == Twist(0.22, 2.84)
    assert pressed("s" * 100 + "d" * 100).command == Twist(-0.22, -2.84)


def test_turtlebot3_style_follows_its_target_by_half_steps():
    state = pressed("wwa", "turtlebot3")
    assert state.command == Twist(0.0, 0.0)
    state.tick()
    assert state.command == Twist(pytest.approx(0.005), pytest.approx(0.05))
    for _ in range(10):
        state.tick()
    assert state.command == Twist(pytest.approx(0.02), pytest.approx(0.1))
    state.press("x")  # in this style: slower
    for _ in range(10):
        state.tick()
    assert state.command.v == pytest.approx(0.01)
    state.press("s")  # stop at once
    assert state.command == Twist(0.0, 0.0)


def test_a_keyboard_drive_is_a_bag_like_any_other_and_ends_standing(tmp_path):
    scene = Scene.load("empty", None, 1, None, None)
    state = KeyState(scene.robot.limits, "keys")
    typed = iter(["w" * 10, "", "aaa"] + [""] * 40 + ["q"])
    frames = []
    driver = keyboard_driver(state, lambda: next(typed), lambda time_s: None)
    status = StatusLine(state, frames.append)
    assert record_drive(scene, driver, "keyboard:keys", Output(tmp_path / "rec"), watch=status) == 0
    _, v, w = read_commands(tmp_path / "rec")
    assert v.max() == pytest.approx(0.1)
    assert w.max() == pytest.approx(0.3)
    assert (v[-1], w[-1]) == (0.0, 0.0)
    assert np.all(v[-25:] == 0.0)
    assert any("+0.10 m/s" in frame for frame in frames)


def test_keys_from_a_pipe_are_given_one_by_one_and_end():
    reader, writer = os.pipe()
    os.write(writer, b"wa")
    os.close(writer)
    with keys_of(reader) as read_keys:
        assert [read_keys() for _ in range(3)] == ["w", "a", "q"]
    os.close(reader)


def test_quiet_driving_shows_nothing(tmp_path, monkeypatch, capsys):
    with open(os.devnull) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        drive = ["teleop", "-q", "--world", "empty", "--speed", "50", "--out", str(tmp_path / "rec")]
        assert main(drive) == 0
    assert capsys.readouterr() == ("", "")


def test_the_drawing_that_is_gone_names_the_studio(tmp_path, capsys):
    assert main(["teleop", "--world", "empty", "--view", "--out", str(tmp_path / "rec")]) == 2
    assert "--view is gone; turtlebag studio shows the scan and the map" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_the_command_records_from_piped_keys_and_refuses_a_wrong_world(tmp_path, monkeypatch, capsys):
    reader, writer = os.pipe()
    os.write(writer, b"w" * 20)
    os.close(writer)
    with os.fdopen(reader) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        arguments = ["teleop", "--world", "empty", "--speed", "50", "--out", str(tmp_path / "rec")]
        assert main(arguments) == 0
    _, v, _ = read_commands(tmp_path / "rec")
    assert v.max() == pytest.approx(0.2)
    assert "W forward" in capsys.readouterr().err
    assert main(["teleop", "--world", "nowhere", "--out", str(tmp_path / "other")]) == 2
    assert not (tmp_path / "other").exists()
