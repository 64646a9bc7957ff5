"""Animations: sizes, frames, and scans put where the robot was at each beam."""

import io

import numpy as np
import pytest
from PIL import Image, ImageDraw

from tests.helpers.report_fakes import mapped_room
from turtlebag.datasets.grid import FREE as FREE_CELL
from turtlebag.datasets.grid import OCCUPIED, OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.types import LidarSpec, Recording, Trajectory
from turtlebag.reports.figures.animation import (
    FRAMES,
    FREE,
    STRIP_PX,
    SUPER,
    UNSEEN,
    WALL,
    Canvas,
    beams_in_map,
    gif,
    last_frame,
    mapping,
    run,
)
from turtlebag.reports.figures.maps import length_text, scale_length, view_box

GREEN, BAD_RGB, PALE = (0, 158, 115), (213, 94, 0), (156, 203, 238)
LIDAR = LidarSpec(90, 0.0, 2 * np.pi / 90, 0.12, 3.5, time_increment=0.2 / 90)


@pytest.fixture(scope="module")
def drive():
    stamps = np.arange(40, dtype=np.int64) * 200_000_000
    path = Trajectory(stamps, SE2.from_xyt(np.linspace(-2.0, 2.0, 40), np.full(40, -1.5), np.zeros(40)))
    ranges = np.full((40, 90), 0.8, dtype=np.float32)
    ranges[:, 45:] = np.inf
    return path, Recording("fake", stamps, ranges, LIDAR, SE2.identity())


@pytest.mark.slow
def test_an_animation_is_small_has_its_frames_and_repeats_byte_for_byte(drive):
    path, recording = drive
    first, again = (gif(mapping(recording, path, path, mapped_room())) for _ in range(2))
    assert first == again
    assert len(first) < 500_000
    with Image.open(io.BytesIO(first)) as image:
        assert image.n_frames > FRAMES // 2  # frames that show nothing new are merged
        assert max(image.size) <= 400


@pytest.mark.slow
def test_the_last_frame_shows_the_whole_drive(drive):
    path, recording = drive
    goals = [{"x": 1.0, "y": 1.0, "status": "reached"}, {"x": -1.0, "y": 1.0, "status": "timeout"}]
    index = np.repeat([0, 1], 20)
    data = last_frame(gif(run(mapped_room(), path, index, goals, recording, path)))
    with Image.open(io.BytesIO(data)) as image:
        colours = {colour for _, colour in image.convert("RGB").getcolors(100_000)}
    assert {GREEN, BAD_RGB, PALE} <= colours


def test_a_run_without_map_scans_or_goals_still_moves(drive):
    path, _ = drive
    assert len(gif(run(None, path, np.full(40, -1), [], None, None))) > 1000


def test_beams_of_a_turning_lidar_are_put_where_the_robot_was(drive):
    path, recording = drive
    origins, directions = beams_in_map(recording, path, 3)
    np.testing.assert_allclose(origins[0], path.poses.xy[3])
    np.testing.assert_allclose(origins[45], 0.5 * (path.poses.xy[3] + path.poses.xy[4]))
    np.testing.assert_allclose(directions, LIDAR.directions)
    still, _ = beams_in_map(recording, path, 39)
    np.testing.assert_allclose(still, path.poses.xy[[39] * 90])


@pytest.mark.parametrize("fov", [360, 240, 120])
def test_a_map_that_grows_shows_thin_walls_and_nothing_behind_them(fov):
    """A square room of 4 m, ranges with noise of 2 cm, and one beam in ten silent, each time another."""
    n, angles = 60, np.deg2rad(np.arange(fov) - fov / 2)
    lidar = LidarSpec(fov, angles[0], np.deg2rad(1.0), 0.12, 3.5)
    stamps = np.arange(n, dtype=np.int64) * 200_000_000
    path = Trajectory(stamps, SE2.from_xyt(np.zeros(n), np.zeros(n), np.linspace(0.0, 7.0, n)))
    bearing = angles + path.poses.yaw[:, None]
    true = 2.0 / np.maximum(np.abs(np.cos(bearing)), np.abs(np.sin(bearing)))
    rng = stream(1, "animation")
    ranges = (true + 0.02 * rng.standard_normal(true.shape)).astype(np.float32)
    ranges[rng.random(true.shape) < 0.1] = np.inf
    cells = np.full((84, 84), OCCUPIED, dtype=np.int8)
    cells[2:-2, 2:-2] = FREE_CELL
    grid = OccupancyGrid(cells, 0.05, SE2.from_xyt(-2.1, -2.1, 0.0))
    *_, last = mapping(Recording("fake", stamps, ranges, lidar, SE2.identity()), path, None, grid)
    canvas = Canvas.over(view_box(grid))
    shown = np.asarray(last)[: canvas.size[1]]
    x = canvas.x0 + (np.arange(canvas.size[0]) + 0.5) / canvas.scale
    y = canvas.y1 - (np.arange(canvas.size[1]) + 0.5) / canvas.scale
    out = np.maximum(np.abs(x)[None, :], np.abs(y)[:, None])
    assert np.all(shown[out > 2.1] == UNSEEN)
    assert np.mean(shown[(out > 0.3) & (out < 1.9)] == FREE) > 0.99
    walls = np.mean(shown == WALL) * shown.size / canvas.scale**2
    assert 0.9 < walls / (16.0 * 0.05) < 1.4  # one cell thick, all around


def test_a_clock_below_the_picture_tells_the_simulated_time(drive):
    path, recording = drive
    first, *_, last = mapping(recording, path, path, mapped_room())
    clocks = [np.asarray(frame)[-SUPER * STRIP_PX :, : frame.width // 3] for frame in (first, last)]
    assert all((clock != clock[0, 0]).any() for clock in clocks)
    assert (clocks[0] != clocks[1]).any()


def test_the_scale_bar_is_as_long_as_it_says():
    canvas = Canvas.over((-3.0, 3.0, -2.0, 2.0))
    image = canvas.blank()
    canvas.caption(ImageDraw.Draw(image), 1.5)
    row = np.asarray(image)[canvas.size[1] + SUPER * STRIP_PX // 2]
    dark = np.flatnonzero(row == 3)
    bar = dark[dark > dark.max() - 1.05 * canvas.scale]
    assert length_text(scale_length(6.0)) == "1 m"
    assert len(bar) == pytest.approx(canvas.scale, abs=2)
