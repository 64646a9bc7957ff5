"""Navigation by numbers: every scenario with its success rate, its 95 % intervals and a row per episode.

python -m benchmarks.navigate [--quick] [--only NAME ...] [--sensors SET] [--episodes N] [--from SEED]
                              [--out DIR]
python -m benchmarks.navigate --replay NAME SEED --out DIR

Collisions are Bullet's contacts, errors are against the truth. Every map is made by our own SLAM from a
recorded tour, but for the controllers side by side, which drive on the true ones. Sensors are the simulator's
`realistic` ones, on the tour and in the episodes; `--sensors clean` runs the same episodes with its clean
ones, as scenarios "patrol, clean" and so on. Rows are written as they come: started again with the same
--out, a campaign goes on where it was (delete navigate.jsonl to start anew). `--from` runs other seeds;
`--replay` drives one episode again and keeps its whole run: bag, run log, metrics. BARN worlds: the folder
`barn` in TURTLEBAG_DATA.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, get_args

from benchmarks import navigate_cases as cases
from benchmarks import navigate_faults as faults
from benchmarks.drives import PLACES, Maps
from benchmarks.navigate_cases import Case, Scenario
from benchmarks.navigate_rows import failures, refused_row, row_of, summary
from benchmarks.runner import Row, Rows, options, write
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.navigation.episode import drive
from turtlebag.pipeline.navigation.setup import prepare
from turtlebag.pipeline.stages.navigate import navigate
from turtlebag.sim.simulator import Sensors, Simulator

SENSORS: tuple[Sensors, ...] = get_args(Sensors)
AVOID_S, QUICK_AVOID_S = 600.0, 120.0
EXPLORE_S = 1800.0


def with_sensors(scenario: Scenario, sensors: Sensors) -> Scenario:
    """The same episodes with these sensors."""
    name = scenario.name if sensors == "realistic" else f"{scenario.name}, {sensors}"

    def make(seed: int) -> Case:
        return dataclasses.replace(scenario.make(seed).simulated(sensors=sensors), name=name)

    return dataclasses.replace(scenario, name=name, make=make)


def scenarios(maps: Maps, quick: bool) -> list[Scenario]:
    """All scenarios, with the default sensors."""

    def of(name: str, count: int, short: int, make: Callable[..., Case], *about: Any) -> Scenario:
        return Scenario(name, count, short, partial(make, *about, name))

    avoid_s, explore_s = (QUICK_AVOID_S, QUICK_AVOID_S) if quick else (AVOID_S, EXPLORE_S)
    found = [
        of("patrol", 100, 3, cases.patrol, maps),
        of("house waffle_pi", 200, 3, cases.random_goal, maps, cases.HOUSE, "waffle_pi"),
        of("house burger", 200, 3, cases.random_goal, maps, cases.HOUSE, "burger"),
        of("new worlds", 100, 3, cases.new_world_goal, maps),
        of("boxes and movers", 200, 3, cases.obstacles, maps, True),
        of("boxes and blind movers", 200, 3, cases.obstacles, maps, False),
        of("avoid guarded", 50, 2, cases.avoid, "guarded", avoid_s),
        of("avoid tutorial", 50, 2, cases.avoid, "tutorial", avoid_s),
        of("explore", 24, 1, cases.explore, explore_s),
    ]
    for place in PLACES:
        found += [
            of(f"pose off, {place}", 50, 2, faults.offset, maps, place),
            of(f"kidnap, {place}", 100, 2, faults.kidnap, maps, place),
            of(f"wheel slip, {place}", 50, 2, faults.slip, maps, place),
            of(f"lidar dropout, {place}", 50, 2, faults.dropout, maps, place),
        ]
        found += [
            of(f"{controller}, {place}", 32, 1, cases.controlled, maps, place, controller)
            for controller in cases.CONTROLLERS
        ]
    found.append(of("closed ring, arena", 50, 2, faults.closed_ring, maps))
    found.append(of("closed door, house", 50, 2, faults.closed_door, maps))
    if worlds := cases.barn_worlds():
        found.append(of("BARN", 3 * len(worlds), len(worlds), cases.barn, worlds))
    return found


def run(case: Case) -> Row:
    """Drive one episode; its row."""
    started = time.process_time()
    try:
        mission = prepare(case.request, case.robot, case.config, case.world.keepout)
    except InputError as error:
        return refused_row(case, str(error))
    with Simulator(case.world, case.robot, case.config.sim, case.request.seed) as simulator:
        episode = drive(simulator, mission)
    return row_of(case, episode, time.process_time() - started)


def replay(scenario: Scenario, seed: int, out: Path) -> int:
    """One episode again, with everything that a run leaves."""
    case = scenario.make(seed)
    return navigate(case.world, case.robot, case.request, Output(out, force=True), config=case.config)


def campaign(chosen: list[Scenario], rows: Rows, first: int, episodes: int | None, quick: bool) -> None:
    """Run what has no row yet."""
    for scenario in chosen:
        count = episodes or (scenario.short if quick else scenario.count)
        for seed in range(first, first + count):
            if rows.get(f"{scenario.name} {seed}") is None:
                row = rows.add(f"{scenario.name} {seed}", run(scenario.make(seed)))
                print(f"  {row['case']}: {'success' if row['success'] else row['reasons']}", flush=True)


def main() -> None:
    parser = options(__doc__, quick="a few short episodes of each")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="these scenarios")
    parser.add_argument("--sensors", choices=SENSORS, default="realistic", help="without --only: which set")
    parser.add_argument("--episodes", type=int, metavar="N", help="episodes of each scenario")
    parser.add_argument("--from", type=int, default=0, dest="first", metavar="SEED", help="first seed")
    parser.add_argument("--replay", nargs=2, metavar=("NAME", "SEED"))
    parser.add_argument(
        "--maps", type=Path, default=Path("data/benchmarks/maps"), help="folder that keeps the maps"
    )
    args = parser.parse_args()
    sets = {
        sensors: [with_sensors(s, sensors) for s in scenarios(Maps(args.maps, sensors), args.quick)]
        for sensors in SENSORS
    }
    known = [scenario for one in sets.values() for scenario in one]
    names = args.replay[:1] if args.replay else args.only or [s.name for s in sets[args.sensors]]
    if unknown := set(names) - {scenario.name for scenario in known}:
        parser.error(f"no scenario {sorted(unknown)[0]!r}: there are {', '.join(s.name for s in known)}")
    chosen = [scenario for scenario in known if scenario.name in names]
    if args.replay:
        raise SystemExit(replay(chosen[0], int(args.replay[1]), args.out))
    rows = Rows(args.out / "navigate.jsonl")
    campaign(chosen, rows, args.first, args.episodes, args.quick)
    found = {s.name: [row for row in rows.all if row["scenario"] == s.name] for s in known}
    write(args.out, "navigate", [summary(name, part) for name, part in found.items() if part])
    print("\n".join(failures(rows.all)))


if __name__ == "__main__":
    main()
