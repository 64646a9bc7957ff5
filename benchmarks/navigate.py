"""Navigation by numbers: every scenario with its success rate, its 95 % interval and a row per episode.

python -m benchmarks.navigate [--quick] [--episodes N] [--only NAME ...] [--map MAP.yaml] [--out DIR]

Collisions are Bullet's contacts, errors are against the truth. `--map` is the map of the patrol
(make it with `make map`; without one a tour is recorded and mapped first). BARN worlds are taken from
the folder `barn` in TURTLEBAG_DATA. Every row names the seed that repeats it.
"""

from __future__ import annotations

import argparse
import csv
import math
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks import navigate_cases as cases
from benchmarks.no_bag import NoBag
from pipeline.build_map import build_map
from pipeline.navigation.episode import Episode, drive
from pipeline.navigation.setup import prepare
from pipeline.record import record
from sim.robots import RobotSpec
from sim.simulator import Simulator
from sim.worlds import World

COLUMNS = (
    "scenario",
    "seed",
    "world",
    "robot",
    "success",
    "reached",
    "goals",
    "reasons",
    "visible",
    "low",
    "moving_contacts",
    "worst_error_m",
    "worst_error_rad",
    "min_clearance_m",
    "localisation_rmse_m",
    "distance_m",
    "time_s",
    "score",
    "x_real_time",
)


def wilson(successes: int, n: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a rate."""
    if n == 0:
        return 0.0, 1.0
    z, p = 1.959964, successes / n
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n)
    return max(middle - half, 0.0), min(middle + half, 1.0)


def run(case: cases.Case) -> dict:
    """Drive one episode; its row."""
    started = time.process_time()
    keepout = () if case.name.startswith("avoid") else case.world.keepout
    mission = prepare(case.request, case.robot, case.config, keepout)
    with Simulator(case.world, case.robot, case.config.sim, case.seed) as simulator:
        episode = drive(simulator, mission, NoBag(), lambda line: None)
    return row_of(case, episode, time.process_time() - started)


def row_of(case: cases.Case, episode: Episode, cpu_s: float) -> dict:
    m, log = episode.metrics, episode.log
    reached = [g for g in m["goals"] if g["status"] == "reached"]
    moving = np.abs(log.v) > 0.01
    localisation = m["localisation_error_m"]
    return {
        "scenario": case.name,
        "seed": case.seed,
        "world": case.world.name,
        "robot": case.robot.name,
        "success": int(m["success"]),
        "reached": len(reached),
        "goals": len(m["goals"]),
        "reasons": "; ".join(f"{g['status']} {g.get('reason', '')}" for g in m["goals"] if g not in reached),
        "visible": m["collisions"]["visible"],
        "low": m["collisions"]["low"],
        "moving_contacts": int(((log.contact_visible | log.contact_low) & moving).any()),
        "worst_error_m": max((g["error_m"] for g in reached), default=math.nan),
        "worst_error_rad": max((g["error_rad"] for g in reached), default=math.nan),
        "min_clearance_m": m["min_clearance_m"],
        "localisation_rmse_m": math.nan if localisation is None else localisation["rmse"],
        "distance_m": m["distance_m"],
        "time_s": m["time_s"],
        "score": math.nan if case.score is None else case.score(m),
        "x_real_time": m["time_s"] / max(cpu_s, 1e-9),
    }


def slam_map(folder: Path) -> Path:
    """A map of the arena made from a recorded tour."""
    record("turtlebot3_world", "burger", "tour", 1, folder / "record")
    build_map(folder / "record", folder / "map")
    return folder / "map" / "map.yaml"


def scenarios(
    quick: bool, episodes: int | None, map_path: Path | None, folder: Path
) -> dict[str, Iterator[cases.Case]]:
    """All scenarios by name; `quick` runs a few episodes of each, `episodes` so many."""

    def maps(world: World, robot: RobotSpec) -> Path:
        return cases.true_map(world, robot, folder)

    def count(full: int, short: int) -> int:
        return episodes or (short if quick else full)

    new = [f"{kind}:{1000 + k}" for k in range(10) for kind in ("office", "maze")]
    return {
        "patrol": cases.patrol(count(100, 3), lambda: map_path or slam_map(folder)),
        "house": cases.goals("house", ["turtlebot3_house"], ["waffle_pi", "burger"], count(200, 6), maps),
        "new worlds": cases.goals("new worlds", new, ["burger"], count(100, 4), maps),
        "boxes and movers": cases.obstacles("boxes and movers", count(100, 4), maps),
        "avoid guarded": cases.avoid("guarded", count(50, 2), 600.0 if not quick else 120.0),
        "avoid tutorial": cases.avoid("tutorial", count(50, 2), 600.0 if not quick else 120.0),
        "initial pose off": cases.offsets(count(50, 3), maps),
        "BARN": cases.barn(count(3, 1)),
    }


def summary(name: str, rows: list[dict]) -> str:
    """One line of the table."""
    n, ok = len(rows), sum(row["success"] for row in rows)
    low, high = wilson(ok, n)
    errors = [row["worst_error_m"] for row in rows if math.isfinite(row["worst_error_m"])]
    scores = [row["score"] for row in rows if math.isfinite(row["score"])]
    return (
        f"| {name} | {n} | {ok} | {ok / n:.3f} | {low:.3f}..{high:.3f} "
        f"| {sum(r['visible'] for r in rows)} | {sum(r['low'] for r in rows)} "
        f"| {sum(r['moving_contacts'] for r in rows)} "
        f"| {max(errors, default=math.nan):.3f} | {np.sum([r['distance_m'] for r in rows]):.0f} "
        f"| {np.mean(scores) if scores else math.nan:.3f} "
        f"| {np.median([r['x_real_time'] for r in rows]):.0f} |"
    )


HEAD = (
    "| scenario | episodes | success | rate | 95 % | visible contacts | low contacts | moving contacts "
    "| worst error m | driven m | score | x real time |\n" + "|---" * 12 + "|"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", nargs="+", metavar="NAME")
    parser.add_argument("--episodes", type=int, metavar="N", help="episodes of each scenario")
    parser.add_argument("--map", type=Path)
    parser.add_argument("--out", type=Path, default=Path("data/benchmarks"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    lines = [HEAD]
    with tempfile.TemporaryDirectory() as scratch:
        chosen = {
            name: found
            for name, found in scenarios(args.quick, args.episodes, args.map, Path(scratch)).items()
            if not args.only or name in args.only
        }
        with (args.out / "navigate.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            writer.writeheader()
            for name, found in chosen.items():
                rows = []
                for case in found:
                    rows.append(run(case))
                    writer.writerow(rows[-1])
                    file.flush()
                if not rows:
                    print(f"{name}: no worlds (set TURTLEBAG_DATA to the folder that holds barn/)")
                    continue
                lines.append(summary(name, rows))
                print(lines[-1], flush=True)
    table = "\n".join(lines) + "\n"
    (args.out / "navigate.md").write_text(table)
    print(table)


if __name__ == "__main__":
    main()
