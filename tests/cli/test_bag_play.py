"""`bag play`: the lines say what was recorded, at the pace asked for."""

import math
import time

import numpy as np
import pytest

from tests.helpers.bag_samples import pose, stamp, write_drive
from tests.helpers.carmen_lines import flaser, write
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.terminal.play import Player, frames, play


@pytest.fixture(scope="module")
def player(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive") / "bag"
    write_drive(folder, seconds=6)
    return Player(folder)


def test_clock_speed_command_and_pose(player):
    frame = player.frame(stamp(90))
    x, y, yaw = pose(90).xyt.tolist()
    assert frame.time_s == pytest.approx(3.0)
    assert f"x {x:+.2f} y {y:+.2f} yaw {math.degrees(yaw):+4.0f}" in frame.status
    moved = (pose(84).inverse() @ pose(90)).xyt / 0.2
    assert f"v {moved[0]:+.2f} m/s w +0.10 rad/s" in frame.status
    assert "cmd +0.20 +0.10" in frame.status


def test_a_log_whose_clock_goes_back_is_shown_with_the_newest_scan_where_that_was_taken(tmp_path):
    stamps = (1.0, 2.0, 1.5, 1.8, 3.0)
    lines = (flaser([2.0] * 180, (k, 0, 0), (k, 0, 0), f"{t:.6f}") for k, t in enumerate(stamps))
    player = Player(write(tmp_path, "".join(lines)))
    assert "odom x +3.00" in player.frame(2 * 10**9).status
    assert "odom x +3.50" in player.frame(2_500_000_000).status
    assert "odom x +4.00" in player.frame(player.end_ns).status


def test_a_log_of_one_scan_is_shown(tmp_path):
    player = Player(write(tmp_path, flaser([2.0] * 180, (1, 0, 0), (1, 0, 0))))
    assert "odom x +1.00 y +0.00 yaw   +0 deg  v +0.00" in next(frames(player, rate=1.0, every_s=0.1)).status


def test_frames_span_the_recording_at_the_rate(player):
    shown = list(frames(player, rate=2.0, every_s=0.25))
    assert [frame.time_s for frame in shown] == pytest.approx(np.append(np.arange(0.0, 5.8, 0.5), 5.8))


def test_playing_takes_the_time_it_should(player):
    shown = []
    start = time.perf_counter()
    play(player, shown.append, rate=20.0, every_s=0.05)
    assert time.perf_counter() - start >= 5.8 / 20.0
    assert len(shown) == 7


def test_a_line_for_each_recorded_second(player, capsys):
    assert main(["bag", "play", player.recording.source, "--rate", "100"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 7
    assert lines[3].startswith("    3.00 s of 5.80")
