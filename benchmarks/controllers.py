"""DWA beside the default controller: random goals in arena and house, the same for each.

python -m benchmarks.controllers [--episodes N] [--out DIR]

On the true maps, AMCL localising, the start told, from rest to rest. Collisions are Bullet's contacts, errors
are against the truth. `tutorial` is turtlebot3_navigation's DWA with its tolerances, at the robot's own
acceleration. Written: controllers.csv, a row an episode, and controllers.md.
"""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.intervals import wilson
from benchmarks.navigate_cases import goal_request, named_floor, pose_on
from turtlebag.datasets.maps import save_map
from turtlebag.datasets.seeds import stream
from turtlebag.pipeline.navigation.config import NavigateConfig
from turtlebag.pipeline.navigation.episode import drive
from turtlebag.pipeline.navigation.recorder import NoBag
from turtlebag.pipeline.navigation.setup import prepare
from turtlebag.planners.control.dwa import DwaConfig
from turtlebag.planners.control.goal_checker import GoalCheckerConfig
from turtlebag.sim.simulator import Simulator

PLACES = {"arena": ("turtlebot3_world", "burger"), "house": ("turtlebot3_house", "waffle_pi")}
CONTROLLERS = {
    "pursuit": NavigateConfig(),
    "dwa": NavigateConfig(controller="dwa"),
    "dwa, tutorial": NavigateConfig(
        controller="dwa",
        dwa=DwaConfig(preset="tutorial"),
        goal_checker=GoalCheckerConfig(preset="tutorial"),
    ),
}


def episode(place: str, controller: str, seed: int, map_path: Path) -> dict[str, Any]:
    """A random reachable start and goal; what became of it."""
    world, robot, grid, cells = named_floor(*PLACES[place])
    rng = stream(seed, f"controllers {place}")
    start, goal = pose_on(grid, cells, rng), pose_on(grid, cells, rng)
    config = CONTROLLERS[controller]
    mission = prepare(goal_request(seed, map_path, start, goal), robot, config, world.keepout)
    with Simulator(world, robot, config.sim, seed) as simulator:
        metrics = drive(simulator, mission, NoBag(), lambda line: None).metrics
    (only,) = metrics["goals"]
    reached = only["status"] == "reached"
    return {
        "place": place,
        "controller": controller,
        "seed": seed,
        "status": only["status"],
        "time_s": only["time_s"] if reached else math.nan,
        "error_m": only["error_m"] if reached else math.nan,
        "error_deg": math.degrees(only["error_rad"]) if reached else math.nan,
        "min_clearance_m": metrics["min_clearance_m"],
        "contacts": metrics["collisions"]["visible"] + metrics["collisions"]["low"],
        "distance_m": metrics["distance_m"],
    }


HEAD = (
    "| | controller | reached | Wilson 95 % | time a goal, mean | true error, mean / most | yaw error, most "
    "| least clearance | its mean | contacts |\n" + "|---" * 10 + "|"
)


def line(rows: Sequence[dict[str, Any]]) -> str:
    """A line of the table."""
    reached = [row for row in rows if row["status"] == "reached"]
    low, high = wilson(len(reached), len(rows))
    error = np.array([row["error_m"] for row in reached]) * 100.0
    room = np.array([row["min_clearance_m"] for row in rows]) * 100.0
    return (
        f"| {rows[0]['place']} | {rows[0]['controller']} | {len(reached)} of {len(rows)} "
        f"| {low:.2f} to {high:.2f} | {np.mean([row['time_s'] for row in reached]):.1f} s "
        f"| {error.mean():.1f} / {error.max():.1f} cm | {max(row['error_deg'] for row in reached):.2f}° "
        f"| {room.min():.1f} cm | {room.mean():.1f} cm | {sum(row['contacts'] for row in rows)} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--episodes", type=int, default=32, metavar="N", help="goals of each (default: 32)")
    parser.add_argument("--out", type=Path, default=Path("data/benchmarks/controllers"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    lines, rows = [HEAD], []
    for place, names in PLACES.items():
        map_path = save_map(named_floor(*names)[2], args.out, place)
        for controller in CONTROLLERS:
            found = [episode(place, controller, seed, map_path) for seed in range(args.episodes)]
            lines.append(line(found))
            rows += found
            print(lines[-1], flush=True)
    with (args.out / "controllers.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    lost = [row for row in rows if row["status"] != "reached"]
    lines += ["", *(f"- {r['place']}, {r['controller']}, seed {r['seed']}: {r['status']}" for r in lost)]
    (args.out / "controllers.md").write_text("\n".join(lines).rstrip() + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
