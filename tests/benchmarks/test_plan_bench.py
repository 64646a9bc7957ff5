"""What judges the planners: the shortest way of a footprint, and the database of the runs."""

import math
import sqlite3
from importlib.metadata import version

import numpy as np
import pytest

from benchmarks.plan_database import write_database, write_log
from benchmarks.plan_shortest import Lattice
from tests.helpers.planning_room import BURGER
from turtlebag.datasets.grid import FREE, OCCUPIED, OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import RobotModel
from turtlebag.planners.costmap import Costmap, CostmapConfig, costmap_from_grid
from turtlebag.planners.lattice import HEADINGS


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


@pytest.mark.slow
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


SCHEMA = {
    "experiments": "id name totaltime timelimit memorylimit runcount version "
    "hostname cpuinfo date seed setup",
    "plannerConfigs": "id name settings",
    "enums": "name value description",
    "runs": "id experimentid plannerid",
    "progress": "runid time",
}
"""Tables of a benchmark database and their first columns, as OMPL's page on benchmarking lists them."""
STANDARD = {
    "solved",
    "correct_solution",
    "approximate_solution",
    "status",
    "time",
    "simplification_time",
    "solution_length",
    "solution_clearance",
}
"""Run properties of the names that page gives; all others are shown under their own names."""


ROBOTS = ("burger", "waffle_pi")


def small_database(folder):
    """Two robots, two planners, two runs each, one of them without a solution."""

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
    for robot in ROBOTS:
        write_log(folder / f"{robot}.log", "arena", robot, "map arena", runs)
    write_database(folder / "plan.db", [folder / f"{robot}.log" for robot in ROBOTS])
    return folder / "plan.db"


def test_the_database_holds_what_was_measured(tmp_path):
    with sqlite3.connect(small_database(tmp_path)) as db:
        experiments = db.execute("SELECT name, robot, runcount, version, setup FROM experiments").fetchall()
        assert experiments == [
            ("arena", robot, 2, f"OMPL {version('ompl')}", "map arena\n") for robot in ROBOTS
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


def test_the_database_has_the_tables_and_columns_that_planner_arena_reads(tmp_path):
    with sqlite3.connect(small_database(tmp_path)) as db:
        tables = {name for (name,) in db.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        assert tables - {"sqlite_sequence"} == set(SCHEMA)
        columns = {t: [row[1] for row in db.execute(f"PRAGMA table_info({t})")] for t in SCHEMA}
        for table, names in SCHEMA.items():
            assert columns[table][: len(names.split())] == names.split()
        # Whatever follows an experiment's own columns is a parameter of it, and a run's is an attribute.
        assert columns["experiments"][12:] == ["robot"]
        assert set(columns["runs"][3:]) >= STANDARD
        keys = {(row[3], row[2]) for row in db.execute("PRAGMA foreign_key_list(runs)")}
        assert keys == {("experimentid", "experiments"), ("plannerid", "plannerConfigs")}


def test_planner_arena_s_questions_have_answers(tmp_path):
    """Attributes of each planner, shares of an enumeration, a parameter, missing values, progress."""
    with sqlite3.connect(small_database(tmp_path)) as db:
        join = (
            "FROM runs JOIN plannerConfigs p ON p.id = runs.plannerid "
            "JOIN experiments e ON e.id = runs.experimentid WHERE e.name = 'arena' AND e.robot = 'burger'"
        )
        name = "REPLACE(p.name, 'geometric_', '')"
        assert db.execute(f"SELECT {name}, AVG(time) {join} GROUP BY p.id ORDER BY p.id").fetchall() == [
            ("RRT", pytest.approx(0.015)),
            ("PRM", pytest.approx(0.006)),
        ]
        shares = db.execute(
            f"SELECT {name}, (SELECT description FROM enums WHERE name = 'status' AND value = status), "
            f"COUNT(*) {join} GROUP BY 1, 2 ORDER BY 1, 2"
        ).fetchall()
        assert shares == [("PRM", "Exact solution", 2), ("RRT", "Exact solution", 1), ("RRT", "Timeout", 1)]
        missing = f"SELECT {name}, SUM(solution_length IS NULL) {join} GROUP BY 1 ORDER BY 1"
        assert db.execute(missing).fetchall() == [("PRM", 0), ("RRT", 1)]
        assert db.execute("SELECT COUNT(*) FROM progress JOIN runs ON runs.id = runid").fetchone() == (0,)
        assert db.execute("PRAGMA foreign_key_check").fetchall() == []
