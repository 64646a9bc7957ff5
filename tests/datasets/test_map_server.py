"""Our maps read by an independent program, as map_server, Nav2 and a costmap do."""

import numpy as np
import pytest
import yaml

from turtlebag.datasets.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from turtlebag.datasets.maps import save_map
from turtlebag.datasets.se2 import SE2

NO_INFORMATION, LETHAL_OBSTACLE, FREE_SPACE = 255, 254, 0


def read_pgm(path):
    """(width, height, pixels from the top left) of a binary greymap, by the format's definition."""
    data, place, words = path.read_bytes(), 0, []
    while len(words) < 4:
        if data[place : place + 1] == b"#":
            place = data.index(b"\n", place) + 1
        elif data[place : place + 1].isspace():
            place += 1
        else:
            end = place
            while not data[end : end + 1].isspace():
                end += 1
            words.append(data[place:end])
            place = end
    magic, width, height, top = words[0], *map(int, words[1:])
    assert (magic, top) == (b"P5", 255)
    pixels = data[place + 1 :]
    assert len(pixels) == width * height
    return width, height, pixels


def map_server(path):
    """nav_msgs/OccupancyGrid (width, height, resolution, origin, data) as map_io.cpp fills it."""
    told = yaml.safe_load(path.read_text())
    assert not set(told) - {
        "image",
        "mode",
        "resolution",
        "origin",
        "negate",
        "occupied_thresh",
        "free_thresh",
    }
    assert told.get("mode", "trinary") == "trinary"
    assert isinstance(told["resolution"], float)
    assert [type(value) for value in told["origin"]] == [float] * 3
    width, height, pixels = read_pgm(path.parent / told["image"])
    data = [0] * (width * height)
    for y in range(height):
        for x in range(width):
            shade = pixels[y * width + x] / 255.0
            occ = shade if told["negate"] else 1.0 - shade
            value = 100 if told["occupied_thresh"] < occ else 0 if occ < told["free_thresh"] else -1
            data[width * (height - y - 1) + x] = value
    return width, height, told["resolution"], told["origin"], data


def costmap(data):
    """The static layer's cost of each cell: its defaults, unknown space tracked."""
    costs = {-1: NO_INFORMATION, 0: FREE_SPACE, 100: LETHAL_OBSTACLE}
    return [costs[value] for value in data]


@pytest.fixture
def saved(tmp_path):
    cells = np.full((7, 11), UNKNOWN, dtype=np.int8)
    cells[1:6, 1:9] = FREE
    cells[1, 1:9] = OCCUPIED
    cells[1:4, 8] = [100, 65, 66]
    cells[2, 2:6] = [25, 26, 64, 3]
    grid = OccupancyGrid(cells, 0.05, SE2.from_xyt(-3.45, -3.1, 0.25))
    return grid, save_map(grid, tmp_path)


def test_map_server_reads_the_cells_that_were_written(saved):
    grid, path = saved
    width, height, resolution, origin, data = map_server(path)
    assert (height, width) == grid.shape
    assert resolution == 0.05
    np.testing.assert_allclose(origin, [-3.45, -3.1, 0.25], atol=1e-6)
    expected = np.where(grid.cells >= 65, 100, np.where((grid.cells >= 0) & (grid.cells <= 25), 0, -1))
    assert data == expected.ravel().tolist()
    assert {-1, 0, 100} == set(data)


def test_a_costmap_takes_walls_for_lethal_and_the_unseen_for_no_information(saved):
    grid, path = saved
    costs = np.reshape(costmap(map_server(path)[4]), grid.shape)
    assert costs[0, 0] == NO_INFORMATION
    assert (costs[1, 1:9] == LETHAL_OBSTACLE).all()
    assert (costs[3:6, 1:8] == FREE_SPACE).all()
    assert costs[2, 3] == NO_INFORMATION
