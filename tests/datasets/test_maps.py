"""Maps are byte-compatible with map_saver and read as map_server reads."""

import subprocess
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from PIL import Image

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from turtlebag.datasets.maps import load_map, save_confidence, save_map
from turtlebag.datasets.se2 import SE2

YAML = (
    "image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\n"
    "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
)


def test_a_confidence_is_an_image_of_the_map_s_size(tmp_path):
    save_confidence(np.array([[0, 255, 128], [51, 0, 255]], dtype=np.uint8), tmp_path / "confidence.pgm")
    pixels = np.asarray(Image.open(tmp_path / "confidence.pgm"))
    assert pixels.tolist() == [[51, 0, 255], [0, 255, 128]]  # the row of the largest y comes first


def write(folder, pixels, text=YAML):
    Image.fromarray(np.asarray(pixels, dtype=np.uint8)).save(folder / "map.pgm")
    (folder / "map.yaml").write_text(text)
    return folder / "map.yaml"


def test_saved_pixels_are_top_row_first_with_map_savers_values(tmp_path):
    cells = np.array([[FREE, OCCUPIED], [UNKNOWN, FREE], [25, 65]], dtype=np.int8)
    save_map(OccupancyGrid(cells, 0.05), tmp_path)
    data = (tmp_path / "map.pgm").read_bytes()
    assert data.startswith(b"P5\n# CREATOR:")
    assert data.endswith(bytes([254, 0, 205, 254, 254, 0]))


def test_pixel_205_stays_unknown_at_0196_and_becomes_free_at_025(tmp_path):
    assert load_map(write(tmp_path, [[205]])).cells[0, 0] == UNKNOWN
    assert load_map(write(tmp_path, [[205]], YAML.replace("0.196", "0.25"))).cells[0, 0] == FREE


@pytest.mark.slow
@given(
    cells=arrays(
        np.int8, array_shapes(min_dims=2, max_dims=2), elements=st.sampled_from([UNKNOWN, FREE, OCCUPIED])
    ),
    origin=st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-3, 3)),
)
def test_round_trip_keeps_cells_and_origin(tmp_path_factory, cells, origin):
    folder = tmp_path_factory.mktemp("map")
    loaded = load_map(save_map(OccupancyGrid(cells, 0.05, SE2.from_xyt(*origin)), folder))
    np.testing.assert_array_equal(loaded.cells, cells)
    np.testing.assert_allclose(loaded.T_map_grid.xyt, origin, atol=1e-6)


def test_negated_and_scaled_maps(tmp_path):
    assert load_map(write(tmp_path, [[255]], YAML.replace("negate: 0", "negate: 1"))).cells[0, 0] == OCCUPIED
    # p = (255 - 147) / 255 = 0.4235, halfway up the ramp: 1 + floor(98 * 0.501)
    assert load_map(write(tmp_path, [[147]], YAML + "mode: scale\n")).cells[0, 0] == 50


GREYS = [[0, 89, 90, 204, 205, 206, 254, 255]]


def stored(folder, image, name):
    """The map of an image, in a file of that name."""
    if isinstance(image, bytes):
        (folder / name).write_bytes(image)
    else:
        image.save(folder / name)
    (folder / "map.yaml").write_text(YAML.replace("map.pgm", name))
    return load_map(folder / "map.yaml").cells.tolist()


def test_every_depth_and_kind_of_image_is_the_same_map(tmp_path):
    grey = Image.fromarray(np.array(GREYS, dtype=np.uint8))
    deep = Image.fromarray(np.array(GREYS, dtype=np.uint16) * 257)
    of_1000 = b"P5 3 1 1000\n" + np.array([0, 803, 1000], ">u2").tobytes()
    clear = Image.fromarray(
        np.array([[[0, 0, 0, 255], [205, 205, 205, 255], [255, 255, 255, 254]]], np.uint8)
    )
    expected = [[OCCUPIED, OCCUPIED, UNKNOWN, UNKNOWN, UNKNOWN, FREE, FREE, FREE]]
    assert [stored(tmp_path, grey, name) for name in ("a.pgm", "a.png", "a.bmp")] == [expected] * 3
    assert [stored(tmp_path, deep, name) for name in ("b.pgm", "b.png")] == [expected] * 2
    assert [stored(tmp_path, grey.convert(mode), "c.png") for mode in ("RGB", "P", "RGBA")] == [expected] * 3
    assert stored(tmp_path, of_1000, "d.pgm") == [[OCCUPIED, UNKNOWN, FREE]]
    assert stored(tmp_path, clear, "e.png") == [[OCCUPIED, UNKNOWN, UNKNOWN]]


def test_colours_count_by_their_mean_and_deep_raw_pixels_by_their_eighth_bit(tmp_path):
    # Green seems lighter than blue to the eye; map_server asks no eye.
    colours = np.array([[[0, 255, 0], [0, 0, 255], [252, 252, 111]]], np.uint8)
    assert stored(tmp_path, Image.fromarray(colours), "a.png") == [[OCCUPIED, OCCUPIED, UNKNOWN]]
    deep = Image.fromarray(np.array([[0, 42 * 257 + 3, 100 * 257, 101 * 257]], np.uint16))
    deep.save(tmp_path / "map.png")
    (tmp_path / "map.yaml").write_text(YAML.replace("map.pgm", "map.png") + "mode: raw\n")
    assert load_map(tmp_path / "map.yaml").cells.tolist() == [[0, 42, 100, UNKNOWN]]


EPS = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\n%%EndComments\nshowpage\n%%EOF\n"


@pytest.mark.parametrize("name", ["x.eps", "x.pgm"])
def test_no_image_starts_a_program(tmp_path, monkeypatch, name):
    """Pillow opens PostScript by Ghostscript, whatever the file is called."""
    for call in ("Popen", "run", "check_call", "check_output"):
        monkeypatch.setattr(subprocess, call, lambda *args, **options: pytest.fail("a program was started"))
    with pytest.raises(InputError, match=r"not a readable image.*PGM, PNG, BMP and JPEG are read"):
        stored(tmp_path, EPS, name)


def test_reading_a_map_takes_a_few_bytes_a_pixel(tmp_path):
    path = write(tmp_path, np.full((2000, 2000), 254))
    tracemalloc.start()
    load_map(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 6 * 2000 * 2000


@given(st.tuples(st.integers(0, 9), st.integers(0, 6)), st.floats(-3, 3))
def test_cell_centres_map_back_to_their_cells_on_turned_grids(cell, yaw):
    grid = OccupancyGrid(np.zeros((10, 7), np.int8), 0.05, SE2.from_xyt(-3.0, 2.0, yaw))
    assert tuple(grid.cell_of(grid.center_of(np.array(cell)))) == cell


def test_points_off_the_grid_are_unknown():
    grid = OccupancyGrid(np.zeros((2, 2), np.int8), 1.0)
    assert grid.value_at(np.array([[0.5, 0.5], [-0.1, 0.5], [0.5, 2.1]])).tolist() == [0, -1, -1]
