"""All bound planners on the arena, the house, an Intel map, mazes and an office, side by side.

python -m benchmarks.plan [--quick] [--queries N] [--out DIR]

Length is over that of the truly shortest collision-free way of the footprint (plan_shortest). Time is CPU
time of one query, costmap ready. Every path is checked anew, pose by pose. The Intel map is made by
`turtlebag map` from TURTLEBAG_DATA/radish/intel.clf.bz2, and left out without it. `solved` is what the
planner itself found, `answered` counts the last resorts of the product (the way over the cells), too.
Written: tables, every query (plan.csv), and logs in OMPL's format with their database (plan.db) for Planner
Arena.
"""

from __future__ import annotations

import math
import time
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import get_args

import numpy as np

from benchmarks.drives import built_map
from benchmarks.navigate_cases import ROOM_M, floor, pose_on, regions_of
from benchmarks.plan_database import SEED, write_database, write_log
from benchmarks.plan_shortest import Lattice
from benchmarks.runner import Row, Suite, every, grouped, options, parsed, public_log, run
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.seeds import stream
from turtlebag.planners.costmap import Costmap, CostmapConfig, costmap_from_grid
from turtlebag.planners.footprint import footprint_free, path_clearance, sample_footprint
from turtlebag.planners.global_plan import ORIENTED, OVER_CELLS, plan_path
from turtlebag.planners.ompl_planner import OmplConfig, PlannerName
from turtlebag.planners.planner import NoPath, Plan, PlanConfig
from turtlebag.planners.smoothing import densify
from turtlebag.sim.robots import RobotSpec, load_robot
from turtlebag.sim.worlds import load_world

MAPS = (
    ("turtlebot3_world", "burger"),
    ("turtlebot3_house", "burger"),
    ("turtlebot3_house", "waffle_pi"),
    ("intel", "burger"),
    ("maze:1", "burger"),
    ("maze:2", "burger"),
    ("office:1", "waffle_pi"),
)
LEAST_APART_M = 1.0
REFUSED = {"Walled-off goals": 0.0, "Goals behind a gap 0.9 footprints wide": 0.9}
"""Unsolvable queries, and the gap in footprints' widths."""


@dataclass(frozen=True, eq=False)
class Place:
    """A map with a robot on it; `queries` are starts, goals and the length of the shortest way."""

    robot: RobotSpec
    costmap: Costmap
    grid: OccupancyGrid
    cells: np.ndarray
    queries: tuple[tuple[SE2, SE2, float], ...]


@lru_cache(maxsize=1)
def place(name: str, robot_name: str, count: int, out: Path) -> Place:
    """A map and random queries between poses that one floor joins."""
    robot = load_robot(robot_name)
    if name == "intel":
        log = public_log("intel")
        assert log is not None
        grid = built_map(log, out / "intel_map").occupancy
        costmap = costmap_from_grid(grid, CostmapConfig())
        regions = regions_of(costmap, robot.model.circumscribed_radius + ROOM_M)
        cells = np.argwhere(regions == np.argmax(np.bincount(regions[regions > 0])))
    else:
        grid, cells = floor(load_world(name), robot)
    costmap = costmap_from_grid(grid, CostmapConfig())
    lattice, rng = Lattice(costmap, robot.model), stream(1, f"plan {name} {robot_name}")
    queries: list[tuple[SE2, SE2, float]] = []
    while len(queries) < count:
        a, b = pose_on(grid, cells, rng), pose_on(grid, cells, rng)
        if np.linalg.norm(a.xy - b.xy) >= LEAST_APART_M:
            queries.append((a, b, lattice.shortest(a, b)))
    return Place(robot, costmap, grid, cells, tuple(queries))


def config_of(planner: PlannerName) -> PlanConfig:
    """The product's settings."""
    # FMT asks at every sample it draws, and draws them all first.
    iterations = 10000 if planner in ("FMT", "BFMT") else 4000
    return PlanConfig(ompl=OmplConfig(planner=planner, iterations=iterations))


def ask(at: Place, a: SE2, b: SE2, config: PlanConfig, seed: int) -> tuple[Plan | None, float]:
    """(plan or None, CPU milliseconds)."""
    start = time.process_time()
    try:
        plan = plan_path(at.costmap, at.robot.model, a, b, config, seed)
    except NoPath:
        plan = None
    return plan, (time.process_time() - start) * 1e3


def clearance(at: Place, plan: Plan) -> float:
    """Least clearance of the footprint on the path [m], every 2 cm of it; <= 0 is a collision."""
    poses = at.costmap.T_grid_map @ plan.poses
    if plan.planner != ORIENTED:
        dense = densify(np.ascontiguousarray(poses.xy), 0.02)
        step = np.diff(dense, axis=0, append=dense[-1:] + (dense[-1:] - dense[-2:-1]))
        yaw = np.arctan2(step[:, 1], step[:, 0])
        poses = SE2.from_xyt(dense[:, 0], dense[:, 1], yaw)
    samples = sample_footprint(at.robot.model, at.costmap.resolution / 2.0)
    xyt = np.ascontiguousarray(poses.xyt)
    field = at.costmap.clearance, at.costmap.resolution
    # Samples may straddle a thin wall; the polygon does not.
    if not all(footprint_free(*field, at.robot.model.footprint, *pose) for pose in xyt):
        return 0.0
    return float(path_clearance(*field, samples, xyt, float(xyt[0, 0]), float(xyt[0, 1]), math.inf))


@cache
def compiled() -> None:
    """Plan once, so that no row pays for what is compiled or loaded."""
    at = place(*MAPS[0], 1, Path())
    ask(at, *at.queries[0][:2], config_of("RRTConnect"), SEED)


def plan_row(map: str, robot: str, query: int, planner: PlannerName, count: int, out: Path) -> Row:
    """A planner on one of `count` queries of a place."""
    compiled()
    at = place(map, robot, count, out)
    a, b, shortest = at.queries[query]
    plan, ms = ask(at, a, b, config_of(planner), SEED + query)
    least = math.nan if plan is None else clearance(at, plan)
    length = math.nan if plan is None else plan.length
    return {
        "answered": int(plan is not None),
        "solved": int(plan is not None and plan.planner not in (OVER_CELLS, ORIENTED)),
        "correct": int(plan is not None and least > 0.0),
        "time_ms": ms,
        "length_m": length,
        "shortest_m": shortest,
        "ratio": length / shortest,
        "clearance_m": least,
    }


def refusal_row(map: str, robot: str, goals: str, count: int, out: Path) -> Row:
    """CPU milliseconds to refuse goals walled off by a ring, by its gap in REFUSED."""
    compiled()
    at, gap = place(map, robot, count, out), REFUSED[goals]
    times: list[float] = []
    rng = stream(2, f"plan {map} {robot}")
    while len(times) < count:
        a, b = pose_on(at.grid, at.cells, rng), pose_on(at.grid, at.cells, rng)
        if float(np.linalg.norm(a.xy - b.xy)) < 1.5:
            continue
        rows, cols = np.indices(at.costmap.lethal.shape)
        center = at.costmap.T_grid_map @ b.xy / at.costmap.resolution
        dx, dy = (v * at.costmap.resolution for v in (cols + 0.5 - center[0], rows + 0.5 - center[1]))
        ring = np.hypot(dx, dy)
        wall = (ring > 0.6) & (ring < 0.75)
        across = float(np.ptp(at.robot.model.footprint, axis=0).min())
        wall &= (dx < 0.0) | (np.abs(dy) > 0.5 * gap * across)
        walled = at.costmap.with_lethal(wall)
        walled.clearance_at(a.xy)  # the field is made before the clock starts
        plan, ms = ask(replace(at, costmap=walled), a, b, PlanConfig(), len(times))
        if plan is not None:
            raise RuntimeError("a walled-off goal was reached")
        times.append(ms)
    return {"ms": times}


def refused(rows: Sequence[Row]) -> list[Row]:
    """A line for each kind of goal."""
    lines = []
    for (goals,), part in grouped(rows, "goals").items():
        ms = [time for row in part for time in row.get("ms", ())]
        figures = {"median ms": float(np.median(ms)), "longest ms": max(ms)} if ms else {}
        lines.append({"goals": goals, "refused": len(ms)} | figures)
    return lines


def figures(rows: Sequence[Row]) -> Row:
    """One line of the table."""
    ms = np.array([row["time_ms"] for row in rows])
    answers = [row for row in rows if row["answered"]] or [{"ratio": math.nan, "clearance_m": math.nan}]
    ratio, room = (np.array([row[key] for row in answers]) for key in ("ratio", "clearance_m"))
    counts = {key: sum(row[key] for row in rows) for key in ("answered", "solved", "correct")}
    return {"queries": len(rows)} | counts | {
        "median ms": f"{np.median(ms):.1f}", "95 % ms": f"{np.percentile(ms, 95):.1f}",
        "mean length / shortest": f"{ratio.mean():.3f}", "worst": f"{ratio.max():.3f}",
        "least clearance m": f"{room.min():.3f}", "mean": f"{room.mean():.3f}",
    }  # fmt: skip


def table(rows: Sequence[Row]) -> list[Row]:
    """A line for each planner, then one for each map by the default; plans that crashed have none."""
    done = [row for row in rows if "error" not in row]
    default = [row for row in done if row["planner"] == OmplConfig().name]
    keys = ("planner", "map", "robot")
    parts = grouped([row | {"map": "all", "robot": ""} for row in done], *keys) | grouped(default, *keys)
    return [dict(zip(keys, key, strict=True)) | figures(part) for key, part in parts.items()]


def logs(rows: Sequence[Row], folder: Path) -> list[Path]:
    """A log for each map and robot."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for (name, robot), part in grouped(rows, "map", "robot").items():
        runs = {planner: queries for (planner,), queries in grouped(part, "planner").items()}
        paths.append(folder / f"{name}-{robot}.log".replace(":", "_"))
        setup = f"map {name}, robot {robot}, {max(map(len, runs.values()))} queries"
        write_log(paths[-1], name.replace(":", "_"), robot, setup, runs)
    return paths


def suites(args: Namespace) -> dict[str, Suite]:
    """Plans, and goals that cannot be reached."""
    out, quick = args.out.absolute(), args.quick
    queries = args.queries or (4 if quick else 10)
    there = [m for m in (MAPS[:2] if quick else MAPS) if m[0] != "intel" or public_log("intel")]
    plans, refusals = [], []
    for map, robot in there:
        planners = ["BITstar", "RRTConnect", "PRM"] if quick else get_args(PlannerName)
        measure = partial(plan_row, count=queries, out=out)
        plans += every(measure, map=(map,), robot=(robot,), query=range(queries), planner=planners)
        shut = partial(refusal_row, count=queries, out=out)
        refusals += every(shut, map=(map,), robot=(robot,), goals=REFUSED)
    return {
        "plan": Suite(plans, summary=table, quick=len(plans), show=False),
        "refused": Suite(refusals, summary=refused, quick=len(refusals), show=False),
    }


if __name__ == "__main__":
    parser = options(__doc__, "data/benchmarks/plan", "few planners, maps and queries")
    parser.add_argument("--queries", type=int, metavar="N", help="queries of each map (default: 10)")
    args, chosen = parsed(parser, suites)
    if rows := [row for row in run(args, chosen).get("plan", []) if "error" not in row]:
        write_database(args.out / "plan.db", logs(rows, args.out / "logs"))
