"""Navigation by numbers: every scenario with its success rate, its 95 % intervals and a row per episode.

python -m benchmarks.navigate [SCENARIO ...] [--quick] [--sensors SET] [--limit N] [--from SEED] [--out DIR]
python -m benchmarks.navigate SCENARIO --replay SEED --out DIR

Collisions are Bullet's contacts, errors are against the truth. Every map is made by our own SLAM from a
recorded tour, but for the controllers side by side, which drive on the true ones. Sensors are the simulator's
`realistic` ones, on the tour and in the episodes; `--sensors clean` runs the same episodes with its clean
ones; rows and tables lie in a folder of each. Started again with the same --out, a campaign goes on where it
was (delete its folder `rows` to start anew). `--from` runs other seeds; `--replay` drives one episode again
and keeps its whole run: bag, run log, metrics. BARN worlds: the folder `barn` in TURTLEBAG_DATA; worlds of
"BARN's kind" are generated, one for each seed.
"""

from __future__ import annotations

import dataclasses
import math
import time
from argparse import Namespace
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import navigate_cases as trials
from benchmarks.drives import PLACES, Maps
from benchmarks.navigate_cases import Trial
from benchmarks.runner import Case, Row, Rows, Suite, interval, options, parsed, rows_file, run, write
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.runlog import RunLog
from turtlebag.pipeline.navigation.driver_setup import prepare
from turtlebag.pipeline.navigation.episode import Episode, drive
from turtlebag.pipeline.stages.navigate import navigate
from turtlebag.reports.metrics.navigation import GoalMetrics, collision_episodes
from turtlebag.sim.simulator import Sensors, Simulator

AVOID_S, QUICK_AVOID_S = 600.0, 120.0
EXPLORE_S = 1800.0
MOVING_M, MOVING_RAD = 0.002, 0.01
"""Wheels that turned the robot more than this in the tick before a contact make it the robot's own."""


@dataclasses.dataclass(frozen=True)
class Scenario:
    """A family of episodes: `make` builds the one of a seed, `count` and `short` are how many are run."""

    name: str
    count: int
    short: int
    make: Callable[[str, int], Trial]
    sensors: Sensors = "realistic"

    def trial(self, seed: int) -> Trial:
        """The episode of a seed; other sensors change nothing else of it."""
        return self.make(self.name, seed).simulated(sensors=self.sensors)


def scenarios(maps: Maps, quick: bool, sensors: Sensors = "realistic") -> dict[str, Scenario]:
    """All scenarios by name."""

    def of(name: str, count: int, short: int, make: Callable[..., Trial], *about: Any) -> Scenario:
        return Scenario(name, count, short, partial(make, *about), sensors)

    avoid_s, explore_s = (QUICK_AVOID_S, QUICK_AVOID_S) if quick else (AVOID_S, EXPLORE_S)
    found = [
        of("patrol", 100, 3, trials.patrol, maps),
        of("house waffle_pi", 200, 3, trials.random_goal, maps, trials.HOUSE, "waffle_pi"),
        of("house burger", 200, 3, trials.random_goal, maps, trials.HOUSE, "burger"),
        of("new worlds", 100, 3, trials.new_world_goal, maps),
        of("boxes and movers", 200, 3, trials.obstacles, maps, True),
        of("boxes and blind movers", 200, 3, trials.obstacles, maps, False),
        of("avoid guarded", 50, 2, trials.avoid, "guarded", avoid_s),
        of("avoid tutorial", 50, 2, trials.avoid, "tutorial", avoid_s),
        of("explore", 24, 1, trials.explore, explore_s),
    ]
    for place in (*PLACES, "new worlds"):
        found += [
            of(f"pose off, {place}", 50, 2, trials.offset, maps, place),
            of(f"kidnap, {place}", 100, 2, trials.kidnap, maps, place),
            of(f"wheel slip, {place}", 50, 2, trials.slip, maps, place),
            of(f"lidar dropout, {place}", 50, 2, trials.dropout, maps, place),
        ]
    for place in PLACES:
        found += [
            of(f"{controller}, {place}", 32, 1, trials.controlled, maps, place, controller)
            for controller in trials.CONTROLLERS
        ]
    found.append(of("closed ring, arena", 50, 2, trials.closed_ring, maps))
    found.append(of("closed door, house", 50, 2, trials.closed_door, maps))
    found.append(of("BARN's kind", 100, 3, trials.barn_kind))
    if worlds := trials.barn_worlds():
        found.append(of("BARN", 3 * len(worlds), len(worlds), trials.barn, worlds))
    return {scenario.name: scenario for scenario in found}


def episode_row(scenario: Scenario, seed: int) -> Row:
    """Drive one episode; its row."""
    trial, started = scenario.trial(seed), time.process_time()
    try:
        mission = prepare(trial.request, trial.robot, trial.config, trial.world.keepout)
    except InputError as error:
        return {"reasons": f"refused {error}"}
    with Simulator(trial.world, trial.robot, trial.config.sim, trial.request.seed) as simulator:
        episode = drive(simulator, mission)
    return row_of(trial, episode, time.process_time() - started)


def row_of(case: Trial, episode: Episode, cpu_s: float) -> Row:
    """The row of an episode. Success: every goal ended as wanted, and nothing was touched at own speed.

    Reached means truly there: a robot that believes so in the wrong place has failed. `own_speed` counts
    the contacts that began while the robot's own wheels moved it: a person who walks into a robot that
    stands still is not its collision.
    """
    m = episode.metrics
    reached = [g for g in m["goals"] if g["status"] == "reached"]
    others = [why for g in m["goals"] if (why := _why(g, case))]
    own = own_contacts(episode.log)
    standing_still = case.world.movers and not own
    # Without a map nobody can know of what is too low for the lidar: counted, but apart.
    unknown = case.request.task in ("avoid", "explore")
    counted = m["collisions"]["visible"] + (0 if unknown else m["collisions"]["low"])
    touched = counted > 0 and not standing_still
    seen = m["area"]["share"] if "area" in m else None
    unseen = seen is not None and seen < case.seen
    return {
        "world": case.world.name,
        "robot": case.robot.name,
        "success": int(not others and not touched and not unseen),
        "reached": len(reached),
        "goals": len(m["goals"]),
        "reasons": "; ".join([*others, *["saw too little of the floor"] * unseen]),
        "visible": m["collisions"]["visible"],
        "low": m["collisions"]["low"],
        "own_speed": own,
        "worst_error_m": max((g["error_m"] for g in reached if g["error_m"] is not None), default=None),
        "worst_error_rad": max((g["error_rad"] for g in reached if g["error_rad"] is not None), default=None),
        "min_clearance_m": m["min_clearance_m"],
        "distance_m": m["distance_m"],
        "seen_share": seen,
        "time_s": m["time_s"],
        "score": None if case.score is None else case.score(m),
        "x_real_time": round(m["time_s"] / max(cpu_s, 1e-9), 1),
    }


def about(scenario: Scenario, seed: int) -> Row:
    """Which episode it is, how to see it again, and what it comes to when nothing comes of it."""
    replay = f'python -m benchmarks.navigate "{scenario.name}" --sensors {scenario.sensors} --replay {seed}'
    nothing = dict.fromkeys(("success", "reached", "visible", "low", "own_speed", "distance_m"), 0)
    return {"scenario": scenario.name, "seed": seed, "replay": replay, "goals": 1, "reasons": ""} | nothing


def own_contacts(log: RunLog) -> int:
    """Contact episodes that began while the wheels moved the robot."""
    episodes = collision_episodes(log.t_ns, log.contact_visible | log.contact_low)
    count = 0
    for first, _ in episodes:
        k = int(np.searchsorted(log.t_ns, first))
        before = log.T_odom_base[max(k - 1, 0)].inverse() @ log.T_odom_base[k]
        x, y, yaw = before.xyt.tolist()
        count += math.hypot(x, y) > MOVING_M or abs(yaw) > MOVING_RAD
    return count


def _why(goal: GoalMetrics, case: Trial) -> str:
    """Why a goal did not end as wanted, by the truth; empty when it did."""
    if goal["status"] != "reached":
        return "" if goal["status"] == case.wanted else f"{goal['status']} {goal.get('reason', '')}".strip()
    off_m, off_rad = goal["error_m"], goal["error_rad"]
    assert off_m is not None
    assert off_rad is not None
    there = case.wanted == "reached" and off_m <= case.within[0] and off_rad <= case.within[1]
    return "" if there else f"reached, but truly {off_m:.2f} m and {off_rad:.2f} rad off"


def summary(name: str, rows: Sequence[Row]) -> Row:
    """One line of the table."""
    from scipy.stats import binomtest  # takes a second to import, as long as all else that is imported here

    n, ok = len(rows), sum(row["success"] for row in rows)
    wilson, exact = interval(ok, n), binomtest(ok, n).proportion_ci(method="exact")

    def of(key: str) -> list[float]:
        return [row[key] for row in rows if row.get(key) is not None] or [math.nan]

    return {
        "scenario": name,
        "seeds": spans([row["seed"] for row in rows]),
        "success": f"{ok}/{n}",
        "Wilson 95 %": f"{wilson[0]:.3f}..{wilson[1]:.3f}",
        "Clopper-Pearson 95 %": f"{exact.low:.3f}..{exact.high:.3f}",
        "visible contacts": sum(of("visible")),
        "low contacts": sum(of("low")),
        "at own speed": sum(of("own_speed")),
        "worst error m": max(of("worst_error_m")),
        "worst yaw error rad": max(of("worst_error_rad")),
        "least clearance m": min(of("min_clearance_m")),
        "driven m": f"{sum(of('distance_m')):.0f}",
        "mean s": f"{np.mean(of('time_s')):.1f}",
        "seen share": float(np.mean(of("seen_share"))),
        "score": float(np.mean(of("score"))),
        "x real time": f"{np.median(of('x_real_time')):.0f}",
    }


def spans(numbers: Sequence[int]) -> str:
    """Whole numbers as runs: `0..9, 20..29`."""
    ordered = np.unique(numbers)
    runs = np.split(ordered, np.flatnonzero(np.diff(ordered) > 1) + 1)
    return ", ".join(f"{run[0]}..{run[-1]}" for run in runs)


def failures(rows: Sequence[Row]) -> list[str]:
    """A line for each episode that failed, with the command that shows it again."""
    return [
        f"- {row['scenario']}, seed {row['seed']} ({row.get('world')}, {row.get('robot')}): "
        f"{row.get('error') or row['reasons'] or 'touched something'}; "
        f"contacts {row['visible']} visible {row['low']} low, {row['own_speed']} at own speed: "
        f"`{row['replay']} --out DIR`"
        for row in rows
        if not row["success"]
    ]


def suites(args: Namespace) -> dict[str, Suite]:
    """A suite a scenario, a case an episode."""
    found = {}
    for name, scenario in scenarios(Maps(args.maps, args.sensors), args.quick, args.sensors).items():
        count = args.limit or (scenario.short if args.quick else scenario.count)
        seeds = range(args.first, args.first + count)
        cases = [Case(f"{name} {k}", partial(episode_row, scenario, k), about(scenario, k)) for k in seeds]
        found[name] = Suite(cases, quick=count, code=(), show=False)
    return found


def main() -> None:
    """Drive what has no row yet, and print the table of all rows that there are."""
    parser = options(__doc__, "data/benchmarks/navigate", "a few short episodes of each", sensors=True)
    parser.add_argument("--from", type=int, default=0, dest="first", metavar="SEED", help="first seed")
    parser.add_argument("--replay", type=int, metavar="SEED", help="one episode again, with all it leaves")
    kept = Path("data/benchmarks/maps")
    parser.add_argument("--maps", type=Path, default=kept, metavar="DIR", help="folder that keeps the maps")
    args, known = parsed(parser, suites)
    if args.replay is not None:
        named = scenarios(Maps(args.maps, args.sensors), args.quick, args.sensors)
        again, out = named[args.suites[0]].trial(args.replay), Output(args.out, force=True)
        raise SystemExit(navigate(again.world, again.robot, again.request, out, config=again.config))
    run(args, known)
    rows = {name: Rows(rows_file(args.out, name), keep=True).all for name in known}
    write(args.out, "navigate", [summary(name, part) for name, part in rows.items() if part])
    print("\n".join(failures([row for part in rows.values() for row in part])))


if __name__ == "__main__":
    main()
