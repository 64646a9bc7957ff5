"""What judges the planners: the shortest way of a footprint, and the database of the runs."""

import math
import sqlite3

import numpy as np
import pytest
from planning_room import BURGER

from benchmarks.plan_database import write_database, write_log
from benchmarks.plan_shortest import Lattice
from datasets.grid import FREE, OCCUPIED, OccupancyGrid
from datasets.se2 import SE2
from datasets.types import RobotModel
from planners.costmap import Costmap, CostmapConfig, costmap_from_grid
from planners.lattice import HEADINGS


def hall(*, wall_rows: int = 60, gap: slice | None = None) -> Costmap:
    """4 x 4 m at 5 cm with a wall at x = 2.0 .. 2.05, open above `wall_rows` or in a gap."""
    cells = np.full((80, 80), FREE, dtype=np.int8)
    cells[[0, -1], :] = OCCUPIED
    cells[:, [0, -1]] = OCCUPIED
    cells[:wall_rows, 40] = OCCUPIED
    if gap is not None:
        cells[gap, 40] = FREE
    return costmap_from_grid(OccupancyGrid(cells, 0.05), CostmapConfig())


def test_headings_go_round_once_and_no_gap_is_wider_than_the_docstring_says():
    angles = np.arctan2(HEADINGS[:, 1], HEADINGS[:, 0])
    gaps = np.diff(np.append(angles, angles[0] + 2.0 * np.pi))
    assert len(HEADINGS) == 32
    assert gaps.min() > 0.0
    assert gaps.max() < math.radians(18.5)


def test_a_straight_way_is_as_long_as_the_straight_line():
    a, b = SE2.from_xyt(0.525, 0.525, 0.3), SE2.from_xyt(1.525, 3.325, -2.0)
    assert Lattice(hall(), BURGER).shortest(a, b) == pytest.approx(math.hypot(1.0, 2.8), rel=1e-6)


def test_round_a_wall_the_way_is_that_of_a_string_round_its_end():
    """Between the disc in the footprint and the disc round it, each pulled round the wall's last cell."""
    a, b = SE2.from_xyt(1.525, 1.025, 0.0), SE2.from_xyt(2.525, 1.025, 0.0)
    found = Lattice(hall(), BURGER).shortest(a, b)

    def round_the_end(radius: float) -> float:
        # Tangents from (+-0.5, -1.95) to a circle, and the arc between them.
        side = math.hypot(0.5, 1.95)
        turn = 2.0 * (math.atan2(1.95, 0.5) + math.asin(radius / side))
        return 2.0 * math.sqrt(side**2 - radius**2) + radius * turn

    low = round_the_end(BURGER.inscribed_radius + 0.025)
    assert low < found < round_the_end(BURGER.circumscribed_radius + 0.025)


def test_a_gap_that_only_the_turned_footprint_passes_is_passed():
    long = RobotModel(
        name="long",
        footprint=np.array([[-0.3, -0.1], [0.3, -0.1], [0.3, 0.1], [-0.3, 0.1]]),
        max_v=0.2,
        max_w=1.0,
        max_dv=1.0,
        max_dw=3.0,
    )
    costmap = hall(wall_rows=80, gap=slice(36, 44))
    a, b = SE2.from_xyt(1.025, 2.025, 1.5), SE2.from_xyt(3.025, 2.025, 1.5)
    assert Lattice(costmap, long).shortest(a, b) == pytest.approx(2.0, rel=0.02)
    assert Lattice(hall(wall_rows=80, gap=slice(39, 41)), long).shortest(a, b) == math.inf


def test_the_database_holds_what_was_measured(tmp_path):
    def run(solved: int, ms: float) -> dict[str, float]:
        return {
            "solved": solved,
            "correct": solved,
            "time_ms": ms,
            "length_m": 3.0 if solved else math.nan,
            "ratio": 1.2 if solved else math.nan,
            "clearance_m": 0.1 if solved else math.nan,
        }

    runs = {"RRT": [run(1, 10.0), run(0, 20.0)], "PRM": [run(1, 5.0), run(1, 7.0)]}
    for space in ("disc", "se2"):
        setup = "map arena, robot burger"
        write_log(tmp_path / f"{space}.log", "arena", {"space": space}, setup, runs, version="2.0.1", seed=7)
    write_database(tmp_path / "plan.db", [tmp_path / "disc.log", tmp_path / "se2.log"])
    with sqlite3.connect(tmp_path / "plan.db") as db:
        experiments = db.execute("SELECT name, space, runcount, version, setup FROM experiments").fetchall()
        assert experiments == [
            ("arena", s, 2, "OMPL 2.0.1", "map arena, robot burger\n") for s in ("disc", "se2")
        ]
        rows = db.execute(
            "SELECT c.name, solved, status, time, solution_length, length_over_shortest FROM runs "
            "JOIN plannerConfigs c ON c.id = plannerid WHERE experimentid = 1 ORDER BY runs.id"
        ).fetchall()
        assert rows == [
            ("geometric_RRT", 1, 6, 0.01, 3.0, 1.2),
            ("geometric_RRT", 0, 4, 0.02, None, None),
            ("geometric_PRM", 1, 6, 0.005, 3.0, 1.2),
            ("geometric_PRM", 1, 6, 0.007, 3.0, 1.2),
        ]
        assert db.execute("SELECT description FROM enums WHERE value = 6").fetchall() == [("Exact solution",)]
        best = db.execute("SELECT plannerid, avg_solved FROM bestPlannerConfigs").fetchall()
        assert best[0] == (2, 1.0)
