"""Animations: sizes, frames, and scans put where the robot was at each beam."""

import numpy as np
import pytest
from PIL import Image

from tests.helpers.report_fakes import mapped_room
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.types import LidarSpec, Recording, Trajectory
from turtlebag.reports.figures.animation import (
    FPS,
    FRAMES,
    FREE,
    HOLD,
    STRIP_PX,
    UNSEEN,
    WALL,
    GrowingMap,
    Screen,
    beams_in_map,
    write_mapping,
    write_run,
)
from turtlebag.reports.figures.maps import length_text, scale_length, view_box

GREEN, ORANGE, PALE, INK = (0, 158, 115), (213, 94, 0), (156, 203, 238), (28, 32, 36)
LIDAR = LidarSpec(90, 0.0, 2 * np.pi / 90, 0.12, 3.5, time_increment=0.2 / 90)


@pytest.fixture(scope="module")
def drive():
    stamps = np.arange(40, dtype=np.int64) * 200_000_000
    path = Trajectory(stamps, SE2.from_xyt(np.linspace(-2.0, 2.0, 40), np.full(40, -1.5), np.zeros(40)))
    ranges = np.full((40, 90), 0.8, dtype=np.float32)
    ranges[:, 45:] = np.inf
    return path, Recording("fake", stamps, ranges, LIDAR, SE2.identity())


def near(image, colour):
    """Which pixels of an image have a colour, but for what a palette takes away."""
    return np.abs(np.asarray(image.convert("RGB")).astype(int) - colour).max(axis=2) <= 6


def frames(path):
    """The frames of a GIF, and the time that all of them take [s]."""
    with Image.open(path) as image:
        found, spent_ms = [], 0
        for k in range(image.n_frames):
            image.seek(k)
            found.append(image.convert("RGB"))
            spent_ms += image.info["duration"]
    return found, spent_ms / 1000


@pytest.mark.slow
def test_an_animation_is_small_has_its_frames_and_repeats_byte_for_byte(drive, tmp_path):
    path, recording = drive
    one, again = tmp_path / "one.gif", tmp_path / "again.gif"
    for file in (one, again):
        write_mapping(file, recording, path, path, mapped_room())
    assert one.read_bytes() == again.read_bytes()
    assert len(one.read_bytes()) < 500_000
    found, spent_s = frames(one)
    assert len(found) > FRAMES // 2  # frames that show nothing new are merged
    assert spent_s == pytest.approx((FRAMES + HOLD) / FPS)
    assert max(found[0].size) <= 380 + STRIP_PX
    clocks = [np.asarray(image)[-STRIP_PX:, : image.width // 3] for image in (found[0], found[-1])]
    assert all((clock != clock[0, 0]).any() for clock in clocks)
    assert (clocks[0] != clocks[1]).any()


@pytest.mark.slow
def test_the_last_frame_shows_the_whole_drive(drive, tmp_path):
    path, recording = drive
    goals = [{"x": 1.0, "y": 1.0, "status": "reached"}, {"x": -1.0, "y": 1.0, "status": "timeout"}]
    index = np.repeat([0, 1], 20)
    last = write_run(tmp_path / "run.gif", mapped_room(), path, index, goals, recording, path)
    screen = Screen(view_box(mapped_room(), [path]))
    assert last.convert("RGB").tobytes() == frames(tmp_path / "run.gif")[0][-1].tobytes()
    for (x, y), colour in (((1.0, 1.0), GREEN), ((-1.0, 1.0), ORANGE), ((0.0, -1.5), PALE)):
        row, column = round((screen.box[3] - y) * screen.scale), round((x - screen.box[0]) * screen.scale)
        assert near(last, colour)[row - 1 : row + 2, column - 1 : column + 2].any(), colour


def test_a_map_keeps_walls_that_are_thinner_than_a_pixel():
    grid = OccupancyGrid(np.zeros((3000, 3000), dtype=np.int8), 0.05, SE2.from_xyt(1.0, 2.0, 0.1))
    grid.cells[:, 1500] = 100
    screen = Screen(view_box(grid))
    shown = np.asarray(screen.ground(grid).image)
    assert np.all((np.abs(shown.astype(int) - np.array((60, 68, 77))).max(axis=2) <= 6).any(axis=1)[5:-5])


def test_a_run_without_map_scans_or_goals_still_moves(drive, tmp_path):
    path, _ = drive
    write_run(tmp_path / "run.gif", None, path, np.full(40, -1), [], None, None)
    assert len(frames(tmp_path / "run.gif")[0]) > 10


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
    recording = Recording("fake", stamps, ranges, lidar, SE2.identity())
    growing = GrowingMap((-2.375, 2.375, -2.375, 2.375), 0.05)  # walls are in the middle of a cell
    for k in range(0, n, 2):
        growing.add(recording, k, beams_in_map(recording, path, k))
    shown = growing.shades()
    middle = -2.375 + 0.05 * (np.arange(95) + 0.5)
    out = np.maximum(np.abs(middle)[None, :], np.abs(middle)[:, None])
    assert np.all(shown[out > 2.1] == UNSEEN)
    assert np.mean(shown[(out > 0.3) & (out < 1.9)] == FREE) > 0.99
    walls = np.sum(shown == WALL) * 0.05**2
    assert 0.9 < walls / (16.0 * 0.05) < 1.4  # one cell thick, all around


def test_the_scale_bar_is_as_long_as_it_says(tmp_path):
    screen = Screen((-3.0, 3.0, -2.0, 2.0))
    still = screen.write(tmp_path / "still.gif", lambda k: (screen.ground(None), 1.5), 1)
    row = near(still, INK)[-STRIP_PX // 2]
    dark = np.flatnonzero(row)
    bar = dark[dark > dark.max() - 1.05 * screen.scale]
    assert length_text(scale_length(6.0)) == "1 m"
    assert len(bar) == pytest.approx(screen.scale, abs=2)
