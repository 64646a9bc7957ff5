"""All bound planners on the arena, the house, mazes and offices: time, length, clearance, success.

python -m benchmarks.plan [--quick] [--out DIR]

Length is over that of the shortest path for the disc that holds the footprint (grid search over the
true map, pulled tight). Time is CPU time of one query, costmap ready. Also written: every query as
CSV, and an OMPL benchmark database (plan.db) for Planner Arena.
"""

from __future__ import annotations

import argparse
import csv
import time
from importlib.metadata import version
from pathlib import Path
from typing import get_args

import numpy as np

from benchmarks.navigate_cases import floor, pose_on
from benchmarks.plan_database import write_database
from datasets.se2 import SE2
from datasets.seeds import stream
from planners.costmap import Costmap, CostmapConfig, costmap_from_grid
from planners.global_plan import NoPath, PlanConfig, plan_path
from planners.ompl_planner import OmplConfig, PlannerName
from planners.smoothing import densify, path_length, relax, shortcut
from planners.wavefront import descend, wave
from sim.robots import RobotSpec, load_robot
from sim.worlds import load_world

MAPS = (
    ("turtlebot3_world", "burger"),
    ("turtlebot3_house", "burger"),
    ("turtlebot3_house", "waffle_pi"),
    ("maze:1", "burger"),
    ("maze:2", "burger"),
    ("office:1", "waffle_pi"),
)
COLUMNS = (
    "map",
    "robot",
    "query",
    "planner",
    "solved",
    "time_ms",
    "length_m",
    "shortest_m",
    "ratio",
    "clearance_m",
)
ONE_RUN = ("RRT", "RRTConnect", "KPIECE1", "BKPIECE1", "LBKPIECE1")
"""Planners that stop at their first solution: these are run anew until good enough."""


def shortest(costmap: Costmap, radius: float, a: SE2, b: SE2) -> float:
    """Length of the shortest way of a disc, pulled tight within the best way over the grid [m]."""
    free = costmap.clearance > radius
    res = costmap.resolution
    ends = [costmap.T_grid_map @ p.xy for p in (a, b)]
    (r0, c0), (r1, c1) = (np.floor(xy[::-1] / res).astype(int) for xy in ends)
    cells = descend(wave(free, int(r1), int(c1), np.inf), int(r0), int(c0))
    points = (cells[:, ::-1] + 0.5) * res
    points[0], points[-1] = ends
    tight = shortcut(costmap.clearance, res, radius, points)
    band = relax(costmap.clearance, res, radius, densify(tight, 0.05), 0.0, 1.0, 0.9, 0.0, 400)
    pulled = shortcut(costmap.clearance, res, radius, band)
    return min(path_length(tight), path_length(band), path_length(pulled))


def config_of(planner: str) -> PlanConfig:
    """The product's settings; planners that go on improving get one run."""
    restarts = OmplConfig().restarts if planner in ONE_RUN else 1
    # FMT asks at every sample it draws, and draws them all first.
    iterations = 10000 if planner in ("FMT", "BFMT") else 2000
    return PlanConfig(ompl=OmplConfig(planner=planner, restarts=restarts, iterations=iterations))


def ask(costmap: Costmap, robot: RobotSpec, a: SE2, b: SE2, config: PlanConfig, seed: int):
    """(plan or None, CPU milliseconds)."""
    start = time.process_time()
    try:
        found = plan_path(costmap, robot.model, a, b, config, seed)
    except NoPath:
        found = None
    return found, (time.process_time() - start) * 1e3


def solvable(planners: list[str], maps, queries: int) -> list[dict]:
    """Every planner on the same random queries."""
    rows = []
    for world_name, robot_name in maps:
        robot, world = load_robot(robot_name), load_world(world_name)
        grid, cells = floor(world, robot)
        costmap = costmap_from_grid(grid, CostmapConfig())
        rng = stream(1, f"plan {world_name} {robot_name}")
        for query in range(queries):
            a, b = pose_on(grid, cells, rng), pose_on(grid, cells, rng)
            best = shortest(costmap, robot.model.circumscribed_radius, a, b)
            for planner in planners:
                found, ms = ask(costmap, robot, a, b, config_of(planner), 7 + query)
                rows.append(
                    {
                        "map": world_name,
                        "robot": robot_name,
                        "query": query,
                        "planner": planner,
                        "solved": int(found is not None),
                        "time_ms": ms,
                        "length_m": found.length if found else np.nan,
                        "shortest_m": best,
                        "ratio": found.length / best if found and best > 0.5 else np.nan,
                        "clearance_m": costmap.clearance_at(found.poses.xy).min() if found else np.nan,
                    }
                )
    return rows


def refusals(maps, queries: int) -> list[float]:
    """CPU milliseconds to refuse goals that are walled off."""
    times = []
    for world_name, robot_name in maps:
        robot, world = load_robot(robot_name), load_world(world_name)
        grid, cells = floor(world, robot)
        rng = stream(2, f"plan {world_name} {robot_name}")
        for query in range(queries):
            a, b = pose_on(grid, cells, rng), pose_on(grid, cells, rng)
            gap = float(np.linalg.norm(a.xy - b.xy))
            if gap < 1.5:
                continue
            costmap = costmap_from_grid(grid, CostmapConfig())
            rows, cols = np.indices(costmap.lethal.shape)
            center = costmap.T_grid_map @ b.xy / costmap.resolution
            ring = np.hypot(cols + 0.5 - center[0], rows + 0.5 - center[1]) * costmap.resolution
            costmap = costmap.with_lethal((ring > 0.6) & (ring < 0.75))
            costmap.clearance_at(a.xy)  # the field is made before the clock starts
            found, ms = ask(costmap, robot, a, b, PlanConfig(), query)
            if found is not None:
                raise SystemExit(f"{world_name}: a walled-off goal was 'reached'")
            times.append(ms)
    return times


def table(rows: list[dict], planners: list[str], refused: list[float]) -> str:
    """Markdown: one line a planner."""
    lines = [
        "| planner | queries | solved | median ms | 95 % ms | mean length / shortest | mean clearance m |",
        "|---|---|---|---|---|---|---|",
    ]
    for planner in planners:
        mine = [row for row in rows if row["planner"] == planner]
        ms = np.array([row["time_ms"] for row in mine])
        lines.append(
            f"| {planner} | {len(mine)} | {sum(r['solved'] for r in mine)} | {np.median(ms):.1f} "
            f"| {np.percentile(ms, 95):.1f} | {np.nanmean([r['ratio'] for r in mine]):.3f} "
            f"| {np.nanmean([r['clearance_m'] for r in mine]):.3f} |"
        )
    lines.append("")
    lines.append(
        f"Walled-off goals: {len(refused)} refused, median {np.median(refused):.1f} ms, "
        f"longest {max(refused):.1f} ms."
    )
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--out", type=Path, default=Path("data/benchmarks"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    planners = ["RRTConnect", "BITstar"] if args.quick else list(get_args(PlannerName))
    maps = MAPS[:3] if args.quick else MAPS
    queries = 5 if args.quick else 10
    solvable(["RRTConnect"], maps[:1], 1)  # compiled before anything is timed
    rows = solvable(planners, maps, queries)
    refused = refusals(maps, queries)
    with (args.out / "plan.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    write_database(args.out / "plan.db", rows, f"OMPL {version('ompl')}", 1)
    text = table(rows, planners, refused)
    (args.out / "plan.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
