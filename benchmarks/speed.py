"""How fast it simulates, localises and drives: simulated seconds per second of processor time, and two cores.

python -m benchmarks.speed [SUITE ...] [--out DIR]

Suites:
  record    a recorded `tour` with realistic sensors
  patrol    the arena's patrol with AMCL, a controller and a bag, on a map made by our SLAM
  barn      an episode in a world of BARN, its loading included (the folder `barn` in TURTLEBAG_DATA)
  amcl      milliseconds of a filter update with 2000 particles and 60 beams
  campaign  patrols by one worker and by two, after the first one

Each row is the best of some runs, so that neither the loading of kernels nor a busy moment of the machine
counts; nothing is kept, all is measured anew.
"""

from __future__ import annotations

import gc
import os
import tempfile
import time
from argparse import Namespace
from collections.abc import Callable
from functools import partial
from pathlib import Path

from llvmlite.binding import get_host_cpu_name

import turtlebag as tb
from benchmarks import navigate_cases, sim, sweep
from benchmarks.drives import PLACES, Maps
from benchmarks.localise import speed as amcl
from benchmarks.navigate import Scenario, episode_row
from benchmarks.runner import Row, Suite, each, every, options, parsed, run
from turtlebag.pipeline.__main__ import GARBAGE_AFTER
from turtlebag.pipeline.stages.run import run as run_stage

RUNS, PATROLS = 3, 10


def best(timed: Callable[[], float]) -> Row:
    """Simulated seconds per second of processor time, the most of some runs; `timed` gives the former."""
    ratios = []
    for _ in range(RUNS):
        start = time.process_time()
        simulated_s = timed()
        ratios.append(simulated_s / (time.process_time() - start))
    return {"x_real_time": round(max(ratios), 1)}


def patrol(controller: str, maps: Path) -> Row:
    """The patrol of the arena as the API runs it, its outputs included."""
    yaml, (world, robot) = Maps(maps, "realistic").slam(*PLACES["arena"]), PLACES["arena"]
    settings = {"controller": controller}

    def simulated_s() -> float:
        run = tb.navigate(yaml, task=tb.Patrol(), world=world, robot=robot, settings=settings)
        return float(run.metrics["time_s"])

    return best(simulated_s)


def barn(seed: int) -> Row:
    """A world of BARN loaded, and driven through."""
    worlds = navigate_cases.barn_worlds()
    if not worlds:
        return {"error": "TURTLEBAG_DATA names no folder with `barn`"}
    scenario = Scenario("BARN", 1, 1, partial(navigate_cases.barn, worlds))
    return best(lambda: episode_row(scenario, seed)["time_s"])


def campaign(patrols: int, maps: Path) -> Row:
    """Patrols by one worker and by two, and how much sooner two are done."""
    yaml = Maps(maps, "realistic").slam(*PLACES["arena"])
    file = {
        "name": "patrols",
        "factors": {"seed": {"first": 1, "last": patrols + 1}},
        "stages": {
            "navigate": "navigate --world turtlebot3_world --task patrol --initial-pose start "
            f"--map {yaml.absolute()} --seed {{seed}}"
        },
        "results": {"time_s": "navigate:time_s"},
    }
    with tempfile.TemporaryDirectory(prefix="turtlebag-") as scratch:
        one, two = (list(sweep.timed(file, run_stage, workers, Path(scratch), 1))[-1] for workers in (1, 2))
    return {"one_s": one["wall_s"], "two_s": two["wall_s"], "speed_up": one["wall_s"] / two["wall_s"]}


def suites(args: Namespace) -> dict[str, Suite]:
    """A table each."""
    maps = (args.out / "maps").absolute()
    return {
        "record": Suite(each(partial(sim.measure, sensors="realistic"), ("world", "robot"), PLACES.values())),
        "patrol": Suite(every(partial(patrol, maps=maps), controller=("pursuit", "dwa"))),
        "barn": Suite(every(barn, seed=(0,))),
        "amcl": Suite(every(partial(amcl, sensors="realistic"), place=PLACES)),
        "campaign": Suite(every(partial(campaign, maps=maps), patrols=(PATROLS,))),
    }


if __name__ == "__main__":
    gc.set_threshold(GARBAGE_AFTER)  # as for a command
    print(f"{get_host_cpu_name()}, {os.cpu_count()} cores")
    run(*parsed(options(__doc__, "data/benchmarks/speed"), suites))
