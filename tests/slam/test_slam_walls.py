"""Walls that a person draws on a map and erases from it, and that follow when the map is made again."""

import numpy as np
import pytest

from tests.helpers.slam_rooms import ROOM, around_the_room, drifted, recording
from tests.studio.room_bag import write_bag
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.slam.graph.edits import Edits, WallEdit
from turtlebag.pipeline.slam.mapper import SlamConfig, run_slam
from turtlebag.pipeline.slam.walls import with_walls
from turtlebag.pipeline.stages.map import build_map
from turtlebag.pipeline.stages.requests.maps import MapRequest

STILL = SE2.identity()
EMPTY = OccupancyGrid(np.full((40, 60), FREE, dtype=np.int8), 0.05, SE2.from_xyt(-1.0, -0.5, 0.0))
CONFIDENCE = np.full((40, 60), 7, dtype=np.uint8)
TRUE = around_the_room(150)
LOG = recording(ROOM, TRUE, odometry=drifted(TRUE))


def drawn(*walls, grid=EMPTY, poses=STILL):
    return with_walls(
        grid, np.full(grid.shape, 7, dtype=np.uint8), [WallEdit(**wall) for wall in walls], poses
    )


def along(a, b, n=300):
    return np.linspace(a, b, n)


@pytest.mark.parametrize("end", [(1.2, 0.3), (1.2, 0.9), (0.1, 1.2), (-0.9, -0.4)])
def test_a_wall_of_no_width_is_a_line_without_gaps(end):
    start = (0.1, 0.3)
    grid, confidence = drawn({"do": "draw", "points": [start, end]})
    assert (grid.value_at(along(start, end)) == OCCUPIED).all()
    cells = np.argwhere(grid.cells == OCCUPIED)
    centres = grid.center_of(cells)
    away = np.linalg.norm(centres[:, None] - along(start, end)[None], axis=2).min(axis=1)
    assert away.max() < 0.04
    assert (confidence[grid.cells == OCCUPIED] == 255).all()
    assert (confidence[grid.cells != OCCUPIED] == 7).all()


def test_what_is_erased_is_free_as_wide_as_the_stroke_and_the_later_edit_counts():
    wall = {"do": "draw", "points": [(0.0, 0.0), (1.0, 0.0)], "width": 0.2}
    grid, _ = drawn(wall, {"do": "erase", "points": [(0.5, 0.0)], "width": 0.4})
    assert grid.value_at(np.array([[0.2, 0.07], [0.2, 0.13]])).tolist() == [OCCUPIED, FREE]
    row = grid.value_at(np.stack([np.arange(0.025, 1.0, 0.05), np.full(20, 0.025)], axis=1))
    assert np.count_nonzero(row == FREE) == 8
    again, _ = drawn({"do": "erase", "points": [(0.5, 0.0)], "width": 0.4}, wall)
    assert (again.value_at(along((0.0, 0.0), (1.0, 0.0))) == OCCUPIED).all()


def test_a_map_grows_for_a_wall_beyond_it_and_stays_on_its_cells():
    grid, confidence = drawn({"do": "draw", "points": [(-2.0, 0.0), (0.0, 2.4)]})
    assert (grid.value_at(along((-2.0, 0.0), (0.0, 2.4))) == OCCUPIED).all()
    np.testing.assert_allclose(grid.T_map_grid.xy, [-2.05, -0.5], atol=1e-9)
    assert grid.shape == confidence.shape == (59, 81)
    assert grid.value_at(np.array([-1.9, 2.0])) == UNKNOWN
    assert grid.value_at(np.array([1.9, 1.4])) == FREE


def test_nothing_grows_for_what_is_erased_and_a_wall_too_far_away_is_refused():
    grid, _ = drawn({"do": "erase", "points": [(50.0, 50.0), (0.0, 0.0)], "width": 0.1})
    assert grid.shape == EMPTY.shape
    with pytest.raises(InputError, match="walls: drawn so far away that the map would have"):
        drawn({"do": "draw", "points": [(90000.0, 0.0)]})


def test_a_wall_moves_as_its_scan_does():
    before, now = SE2.from_xyt(0.3, 0.1, 0.4), SE2.from_xyt(0.5, 0.3, 1.2)
    wall = {"do": "draw", "points": [(0.0, 0.2), (0.6, 0.2)]}
    tied = {**wall, "scan": 1, "pose": tuple(before.xyt.tolist())}
    poses = SE2(np.stack([np.zeros(3), now.xyt]))
    moved = now @ before.inverse() @ along((0.0, 0.2), (0.6, 0.2))
    grid, _ = drawn(tied, poses=poses)
    assert (grid.value_at(moved) == OCCUPIED).all()
    assert grid.value_at(np.array([0.0, 0.2])) == FREE
    assert (drawn(wall, poses=poses)[0].value_at(along((0.0, 0.2), (0.6, 0.2))) == OCCUPIED).all()


@pytest.mark.slow
def test_walls_are_where_they_were_in_the_room_when_another_setting_moves_the_scans():
    """The front end alone leaves the odometry's drift in the poses, and the walls are drawn along it."""
    usual = run_slam(LOG, SlamConfig())
    k = int(usual.keys[len(usual.keys) // 2])
    was = usual.trajectory.poses[k]
    line = was @ along((0.3, -0.3), (0.3, 0.3))
    wall = WallEdit(do="draw", points=(tuple(line[0]), tuple(line[-1])), scan=k, pose=tuple(was.xyt.tolist()))
    edits = Edits(walls=(wall,))
    drifting = SlamConfig(sensors="odometry")
    other, bare = run_slam(LOG, drifting, edits=edits), run_slam(LOG, drifting)
    now = other.trajectory.poses[k]
    moved = now @ along((0.3, -0.3), (0.3, 0.3))
    assert np.linalg.norm(moved - line, axis=1).min() > 0.1
    assert (other.grid.value_at(moved) == OCCUPIED).all()
    assert not (bare.grid.value_at(moved) == OCCUPIED).all()
    late = Edits(walls=(wall.model_copy(update={"scan": 150}),))
    with pytest.raises(InputError, match=r"^--edits: walls 1: test has no scan 150; its scans are"):
        run_slam(LOG, SlamConfig(), edits=late)


@pytest.mark.slow
def test_a_map_that_is_continued_has_the_walls_of_both_recordings(tmp_path):
    one, two = (
        write_bag(tmp_path / name, recording(ROOM, poses, odometry=drifted(poses), seed=seed))
        for seed, (name, poses) in enumerate({"one": TRUE, "two": around_the_room(120)}.items())
    )
    both = MapRequest(source=one, also=(two,))
    assert build_map(both, Output(tmp_path / "both")) == 0
    poses = np.loadtxt(tmp_path / "both" / "trajectory.tum")[:, [1, 2]]
    assert len(poses) == 270
    edits = tmp_path / "edits.yaml"
    lines = []
    for scan in (30, 200):
        x, y = poses[scan]
        lines.append(f"- {{do: draw, points: [[{x - 0.2}, {y}], [{x + 0.2}, {y}]]}}")
    edits.write_text("walls:\n" + "\n".join(lines) + "\n")
    assert build_map(both.model_copy(update={"edits": edits}), Output(tmp_path / "together")) == 0
    assert build_map(MapRequest(source=one, edits=edits), Output(tmp_path / "map")) == 0
    more = MapRequest(source=two, continued=tmp_path / "map", edits=edits)
    assert build_map(more, Output(tmp_path / "more")) == 0
    grid = load_map(tmp_path / "more" / "map.yaml")
    for scan in (30, 200):
        x, y = poses[scan]
        assert (grid.value_at(along((x - 0.2, y), (x + 0.2, y))) == OCCUPIED).all()
    for name in ("map.pgm", "confidence.pgm", "trajectory.tum"):
        assert (tmp_path / "more" / name).read_bytes() == (tmp_path / "together" / name).read_bytes()
    assert (tmp_path / "both" / "map.pgm").read_bytes() != (tmp_path / "more" / "map.pgm").read_bytes()
