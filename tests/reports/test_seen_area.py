"""Floor seen, by hand-made rooms: one room, a room behind a door, a pillar's shadow."""

import numpy as np
import pytest

from turtlebag.datasets.grid import FREE, OCCUPIED, OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.reports.metrics.seen_area import area_metrics, floor_seen

AT_LIDAR = SE2.identity()


def room(rows: int, cols: int) -> np.ndarray:
    cells = np.full((rows, cols), OCCUPIED, dtype=np.int8)
    cells[1:-1, 1:-1] = FREE
    return cells


def test_all_of_an_open_room_is_seen_from_its_middle():
    grid = OccupancyGrid(room(22, 22), 0.1, SE2.from_xyt(-1.1, -1.1, 0.0))
    found = area_metrics(grid, SE2.from_xyt([0.0], [0.0], [0.0]), AT_LIDAR, 3.5, 0.1)
    assert found == {"seen_m2": pytest.approx(4.0), "visible_m2": pytest.approx(4.0), "share": 1.0}


def test_no_more_is_seen_than_a_disc_of_the_lidars_range():
    grid = OccupancyGrid(np.full((200, 200), FREE, dtype=np.int8), 0.05, SE2.from_xyt(-5.0, -5.0, 0.0))
    seen = floor_seen(grid, np.zeros((1, 2)), 2.0)
    assert seen.sum() * 0.05**2 == pytest.approx(np.pi * 4.0, rel=0.06)


def test_a_room_behind_a_wall_counts_only_when_it_can_be_looked_into():
    cells = room(22, 42)
    cells[:, 21] = OCCUPIED
    grid = OccupancyGrid(cells, 0.1)
    pose = SE2.from_xyt([1.1], [1.1], [0.0])
    shut = area_metrics(grid, pose, AT_LIDAR, 3.5, 0.15)
    assert shut["visible_m2"] == pytest.approx(4.0)
    cells[8:13, 21] = FREE
    opened = area_metrics(grid, pose, AT_LIDAR, 3.5, 0.15)
    whole = float((cells == FREE).sum()) * 0.01
    assert opened["visible_m2"] == pytest.approx(whole)
    assert 4.0 < opened["seen_m2"] < whole
    assert opened["share"] == pytest.approx(opened["seen_m2"] / whole)


def test_driving_into_the_shadow_of_a_pillar_shows_it():
    cells = room(42, 42)
    cells[18:24, 18:24] = OCCUPIED
    grid = OccupancyGrid(cells, 0.1)
    behind = grid.cell_of(np.array([3.5, 2.1]))
    here = floor_seen(grid, np.array([[0.5, 2.1]]), 6.0)
    both = floor_seen(grid, np.array([[0.5, 2.1], [3.5, 0.5]]), 6.0)
    assert not here[tuple(behind)]
    assert both[tuple(behind)]


def test_a_lidar_ahead_of_the_base_sees_from_there_at_any_yaw():
    cells = room(22, 42)
    cells[:, 21] = OCCUPIED
    grid = OccupancyGrid(cells, 0.1)
    ahead = SE2.from_xyt(1.2, 0.0, 0.0)
    across = area_metrics(grid, SE2.from_xyt([1.9], [1.1], [0.0]), ahead, 3.5, 0.15)
    away = area_metrics(grid, SE2.from_xyt([1.9], [1.1], [np.pi]), ahead, 3.5, 0.15)
    assert across["seen_m2"] > 3.5
    assert away["seen_m2"] > 3.5
    assert across["visible_m2"] > away["visible_m2"] + 3.5
