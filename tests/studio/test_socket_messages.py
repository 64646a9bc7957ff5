"""What a client has put together from its frames is what the views hold, whatever changed between them."""

import itertools
import math
import struct
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from docs.examples.studio_client import BLANK, Picture, decoded
from tests.studio.fakes import SCENE, view
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.studio.socket_messages import COLUMNS, Frames, bye, hello
from turtlebag.pipeline.studio.view import Event, GoalMark, Graph, MapLayer, Path, SectorMarks, Stop

RESOLUTION = 0.05


def layer(cells, x=0, y=0, yaw=0.0):
    """A map of these cells whose corner is cell (x, y) of the map frame."""
    return MapLayer(
        OccupancyGrid(np.asarray(cells, dtype=np.int8), RESOLUTION, SE2.from_xyt(x * 0.05, y * 0.05, yaw))
    )


def seen(picture, known):
    """The client's map where a layer has cells, and whether there is nothing elsewhere."""
    grid, place = picture.grids["map"], picture.places["map"]
    assert (place["h"], place["w"]) == grid.shape
    x, y, _ = (SE2.from_xyt(*place["origin"]).inverse() @ known.origin).xyt.tolist()
    row, column = round(y / RESOLUTION), round(x / RESOLUTION)
    rows, columns = known.cells.shape
    rest = grid.copy()
    rest[row : row + rows, column : column + columns] = BLANK["map"]
    assert np.all(rest == BLANK["map"])
    return grid[row : row + rows, column : column + columns]


@st.composite
def matrices(draw, columns):
    """Up to thirty rows; their values come of one seed, as drawing each takes longer than all the rest."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    values = rng.choice([0.0, -0.0, 1e-40, *rng.uniform(-100, 100, 20)], (draw(st.integers(0, 30)), columns))
    return values.astype(np.float32).astype(float)


@st.composite
def journeys(draw):
    """Views that follow one another: arrays come, stay and go, paths grow or turn over, the map grows."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    now = dict.fromkeys(("scan", "particles", "plan", "local"), None) | {
        name: np.zeros((0, COLUMNS[name])) for name in ("boxes", "mover_segments", "mover_circles")
    }
    paths = {name: Path(0, np.zeros((0, 2))) for name in ("odom_path", "slam_path", "true_path")}
    known, graph, keepout = None, None, ()
    views = []
    for _ in range(draw(st.integers(1, 8))):
        for name in now:
            if draw(st.booleans()):
                now[name] = draw(matrices(COLUMNS[name]))
        for name, (version, points) in paths.items():
            what = draw(st.sampled_from(["stays", "grows", "turns"]))
            if what == "grows":
                paths[name] = Path(version, np.concatenate([points, draw(matrices(2))]))
            elif what == "turns":
                paths[name] = Path(version + 1, draw(matrices(2)))
        what = draw(st.sampled_from(["stays", "changes", "grows", "other", "none"]))
        if what == "other" or (known is None and what != "none"):
            cells = rng.integers(-1, 101, rng.integers(1, 300, 2))
            known = layer(cells, *rng.integers(-99, 99, 2), yaw=float(rng.choice([0.0, 0.3])))
        elif what == "changes":
            cells = known.grid.cells.copy()
            cells[tuple(rng.integers(0, cells.shape, (50, 2)).T)] += 1
            known = MapLayer(OccupancyGrid(cells, RESOLUTION, known.origin))
        elif what == "grows":
            low, left, high, right = rng.integers(0, 90, 4)
            cells = np.pad(known.grid.cells, ((low, high), (left, right)), constant_values=50)
            corner = known.origin @ SE2.from_xyt(-left * RESOLUTION, -low * RESOLUTION, 0.0)
            known = MapLayer(OccupancyGrid(cells, RESOLUTION, corner))
        elif what == "none":
            known = None
        if draw(st.booleans()):
            graph = Graph(draw(matrices(3)), rng.integers(0, 9, (5, 3)).astype(np.int32))
        if draw(st.booleans()):
            keepout = tuple(draw(st.lists(matrices(2), max_size=3)))
        dropped = draw(st.integers(0, 3)) == 0
        views.append((view(**now, **paths, map=known, graph=graph, keepout=keepout), dropped))
    return views


@given(journeys())
@settings(max_examples=80)
@pytest.mark.slow
def test_frames_bring_a_client_to_the_view_even_if_some_are_dropped(views):
    frames, picture = Frames(itertools.count(0, 1000).__next__), Picture()
    for now, dropped in views:
        if dropped:
            continue
        picture.take(frames.frame(now, {"factor": 1.0, "error": None}))
        for name, columns in COLUMNS.items():
            wanted = getattr(now, name)
            if wanted is not None or name in picture.arrays:
                wanted = np.zeros((0, columns)) if wanted is None else wanted
                assert np.array_equal(picture.arrays[name], wanted.astype(np.float32)), name
        for name in ("odom_path", "slam_path", "true_path"):
            points = getattr(now, name).points
            assert np.array_equal(picture.arrays.get(name, np.zeros((0, 2))), points.astype(np.float32)), name
        if now.map is not None:
            assert np.array_equal(seen(picture, now.map), now.map.cells)
        elif "map" in picture.grids:
            assert picture.grids["map"].tolist() == [[BLANK["map"]]]
        if now.graph is not None:
            assert np.array_equal(picture.arrays["graph_nodes"], now.graph.nodes.astype(np.float32))
            assert np.array_equal(picture.arrays["graph_edges"], now.graph.edges)
        if now.keepout:
            assert np.array_equal(picture.arrays["keepout"], np.concatenate(now.keepout).astype(np.float32))


def test_a_message_is_laid_out_as_it_says():
    header, blobs = decoded(hello(SCENE, maps=("", "a"), driver=True))
    assert header["kind"] == "hello"
    assert [blob["at"] % 4 for blob in header["blobs"]] == [0, 0, 0]
    assert header["maps"] == ["", "a"]
    assert blobs["outline"].dtype == np.dtype("<f4")
    assert np.allclose(blobs["outline"], SCENE.outline)
    assert blobs["world_circles"].shape == (0, 3)
    message = Frames().frame(view(map=layer(np.zeros((3, 5))), scan=np.ones((2, 2))), {})
    (length,) = struct.unpack_from("<I", message)
    assert message[4 : 4 + length].decode().startswith('{"kind":"frame"')
    assert len(message) % 4 == 0
    assert decoded(bye("enough"))[0]["reason"] == "enough"


def test_words_are_plain_json():
    now = view(
        sectors=SectorMarks(math.inf, 0.5, 1.5, "left"),
        goals=(GoalMark(1.0, 2.0, 0.5, "reached"),),
        T_map_base=SE2.from_xyt(1.0, 2.0, 0.123456),
        stamp_ns=1_500_000_000,
    )
    header, _ = decoded(Frames().frame(now, {"paused": True}))
    assert header["sectors"] == {"left": None, "front": 0.5, "right": 1.5, "decision": "left"}
    assert header["goals"] == [{"x": 1.0, "y": 2.0, "yaw": 0.5, "status": "reached"}]
    assert (header["t"], header["pose"], header["paused"]) == (1.5, [1.0, 2.0, 0.1235], True)


def test_events_and_waypoints_are_told_once():
    frames = Frames()
    events = tuple(Event(k, float(k), f"event {k}", "info") for k in range(1, 6))

    def told(upto, loaded):
        header, _ = decoded(frames.frame(view(events=events[:upto], waypoints=loaded), {}))
        return [text for _, text, _ in header["events"]], header.get("waypoints")

    first, second = (Stop(1.0, 2.0, 0.0, None),), (Stop(3.0, 2.0, 0.0, 4.0, "off the map"),)
    assert told(2, first) == (["event 1", "event 2"], [[1.0, 2.0, 0.0, None, ""]])
    assert told(2, first) == ([], None)
    assert told(5, second) == (["event 3", "event 4", "event 5"], [[3.0, 2.0, 0.0, 4.0, "off the map"]])
    assert told(5, second) == ([], None)


def test_a_layer_that_was_switched_off_comes_back_as_it_is_then():
    frames, picture = Frames(itertools.count(0, 1000).__next__), Picture()
    cells = np.zeros((100, 100), dtype=np.int8)
    picture.take(frames.frame(view(map=layer(cells), slam_path=Path(0, np.zeros((3, 2)))), {}))
    frames.layers = frozenset()
    later = view(map=layer(cells + 1), slam_path=Path(0, np.zeros((5, 2))))
    size = len(frames.frame(later, {}))
    assert size < 1000
    frames.layers = frozenset({"map", "slam_path"})
    picture.take(frames.frame(later, {}))
    assert np.all(picture.grids["map"] == 1)
    assert len(picture.arrays["slam_path"]) == 5


def test_of_a_map_that_stays_where_it_is_only_the_rectangle_that_changed_is_sent():
    frames, picture = Frames(itertools.count(0, 1000).__next__), Picture()
    cells = np.random.default_rng(4).integers(0, 100, (300, 200))
    for row, column in ((0, 0), (70, 65), (90, 50)):
        cells[row, column] = 101
        picture.take(frames.frame(view(map=layer(cells)), {}))
        assert np.array_equal(picture.grids["map"], cells)
        cells = cells.copy()
    assert picture.places["map"]["tiles"] == [[50, 90, 1, 1]]
    assert picture.places["map"]["version"] == 1


@pytest.mark.parametrize(
    "other",
    [
        layer(np.ones((100, 100)), 10, 10),
        layer(np.ones((200, 150))),
        layer(np.ones((200, 200)), 1, 0),
        layer(np.ones((200, 200)), 0, 0, yaw=np.pi / 2),
    ],
)
def test_another_map_has_its_own_size(other):
    frames, picture = Frames(itertools.count(0, 1000).__next__), Picture()
    for known in (layer(np.zeros((200, 200))), other):
        picture.take(frames.frame(view(map=known), {}))
        assert picture.grids["map"].shape == known.cells.shape
        assert np.allclose(picture.places["map"]["origin"], known.origin.xyt)
    assert picture.places["map"]["version"] == 2


def corridors(rng, cells):
    """A building's map: corridors and rooms, with the probabilities of a log that was driven."""
    world = np.full((cells, cells), -1, dtype=np.int8)
    for at in range(40, cells, 120):
        for rows, columns in ((slice(at, at + 60), slice(20, -20)), (slice(20, -20), slice(at, at + 60))):
            world[rows, columns] = rng.integers(0, 12, world[rows, columns].shape)
    walls = (world[1:-1, 1:-1] == -1) & ((world[2:, 1:-1] >= 0) | (world[1:-1, 2:] >= 0))
    world[1:-1, 1:-1][walls] = rng.integers(60, 100, int(walls.sum()))
    return world


@pytest.mark.slow
def test_a_map_as_large_as_aces_stays_below_200_kb_a_second_while_it_grows():
    """60 x 60 m, driven at 3.5 m/s with a lidar of 10 m; each scan changes every 50th cell that it sees."""
    rng = np.random.default_rng(5)
    world = corridors(rng, 1200)
    known = np.full_like(world, -1)
    yy, xx = np.mgrid[-200:201, -200:201]
    disc = yy**2 + xx**2 < 200**2
    frames, picture, sizes, spent = Frames(lambda: 0.1 * k), Picture(), [], []
    for k in range(300):
        x, y = 70 + k % 150 * 7, 70 + k // 150 * 120
        left, low = max(x - 200, 0), max(y - 200, 0)
        about = slice(low, y + 201), slice(left, x + 201)
        within = known[about]  # a view of it
        near = disc[low - y + 200 :, left - x + 200 :][: within.shape[0], : within.shape[1]]
        within[near] = world[about][near]
        flicker = near & (rng.random(near.shape) < 0.02) & (within >= 0)
        within[flicker] = np.clip(within[flicker] + 1, 0, 100)
        rows, columns = np.flatnonzero((known >= 0).any(axis=1)), np.flatnonzero((known >= 0).any(axis=0))
        shown = known[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].copy()
        now = layer(shown, columns[0], rows[0])
        begun = time.process_time()
        message = frames.frame(view(map=now), {})
        spent.append(time.process_time() - begun)
        sizes.append(len(message))
        picture.take(message)
    k += 10
    picture.take(frames.frame(view(map=now), {}))
    assert np.array_equal(seen(picture, now), now.cells)
    seconds = np.add.reduceat(sizes, np.arange(0, 300, 10))
    assert np.convolve(seconds, [0.5, 0.5])[1:-1].max() < 200_000
    assert np.median(spent) < 0.02
