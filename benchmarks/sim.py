"""Simulated seconds per second of `record`, for each world and robot.

python -m benchmarks.sim [--quick] [--sensors SET] [--out DIR]

CPU time of the process is what counts (a shared machine's wall clock says little); the drive is the
script `tour`.
"""

from __future__ import annotations

import time
from argparse import Namespace
from functools import partial

import turtlebag as tb
from benchmarks.runner import Row, Suite, each, options, parsed, run

CASES = (
    ("turtlebot3_world", "burger"), ("turtlebot3_world", "waffle_pi"), ("turtlebot3_house", "burger"),
    ("turtlebot3_house", "waffle_pi"), ("maze:1", "burger"), ("office:1", "burger"), ("forest:1", "burger"),
    ("forest:1", "jackal"), ("empty", "burger"),
)  # fmt: skip


def measure(world: str, robot: str, sensors: str) -> Row:
    """One row of the table: the faster of two drives, as the first may have to compile; reading the bag again
    does not count."""
    spent = []
    for _ in range(2):
        start = time.process_time()
        bag = tb.record(world, robot, settings={"sim.sensors": sensors})
        spent.append(time.process_time() - start)
    simulated_s = bag.recording.duration()
    return {"simulated_s": round(simulated_s, 1), "x_real_time": round(simulated_s / min(spent), 1)}


def suites(args: Namespace) -> dict[str, Suite]:
    """One table."""
    cases = each(partial(measure, sensors=args.sensors), ("world", "robot"), CASES)
    return {"sim": Suite(cases, quick=3)}


if __name__ == "__main__":
    run(*parsed(options(__doc__, "data/benchmarks/sim", "three places", sensors=True), suites))
