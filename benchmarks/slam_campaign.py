"""The campaign of the mapper: logs, drives and disturbances that nobody tuned on, row by row.

python -m benchmarks.slam_campaign [SUITE ...] [--quick] [--limit N] [--only PATTERN] [--workers N]
                                   [--minutes M] [--keep] [--out DIR]

Suites:
  logs       the public logs, with what others published
  disturbed  the Radish logs with relations in fifteen modes (benchmarks.disturb)
  drives     300 simulated drives: five places, two robots, every script, unseen seeds
  fast50     house, burger, `fast`, seeds 1001-1050, realistic and clean sensors
  mishaps    drives in which something goes wrong, as they are and with four other lidars
  worlds     the drives of docs/lab/mapping.md
  ablation   each part of the mapper switched off or exchanged
  parts      the exchangeable parts on public logs and drives
  numbers    the numbers that matter most, halved and doubled (benchmarks.slam_parts)
  online     the mapper that works while the robot drives, beside the offline one
  growth     CPU seconds and memory of the whole command, by size of the log
  space      simulated worlds in 3D, and worth: what each part is worth there (benchmarks.slam3d)

Public logs are read from the folder in TURTLEBAG_DATA (its folders `radish` and `wild`). The order of a
suite's cases is fixed, and any first part of it (--limit) is a fair sample; --quick takes a small one of
most. Every map is a row, a JSON line in DIR/rows: the same command goes on where it was stopped. Rows of
other code are measured again, unless --keep. Errors [m, deg] are those of the relations where a log has any,
else after a rigid fit (`anchored`: with the first pose as the only anchor). CPU seconds are those of mapping
alone, in 3D with reading and writing.
"""

from __future__ import annotations

import os
from argparse import Namespace
from collections.abc import Callable, Sequence

from benchmarks import slam_logs as logs
from benchmarks.runner import Suite, options, parsed, public, run
from benchmarks.slam3d import space_cases, worth_cases
from benchmarks.slam_cost import COSTS, ONLINE, growth_cases, online_cases
from benchmarks.slam_parts import CHOICES, PARTS, ablation_cases, ablation_table, number_cases, number_table
from benchmarks.slam_scores import by

MAPPER = ("datasets", "pipeline/slam", "benchmarks/slam_scores.py", "benchmarks/known_logs.py")
DISTURBED = (*MAPPER, "benchmarks/disturb.py")
SIMULATED = (*DISTURBED, "sim", "benchmarks/slam_logs.py")
SPACE = (*SIMULATED, "pipeline/slam3d", "benchmarks/slam3d.py", "tests/helpers/drives3d.py")
BASICS = ("case", "scans", "m", "deg", "worst_m")
ENDS = ("verdict", "reasons", "loops", "cpu_s", "error")
EXACT = (*BASICS, "anchored_m", "anchored_worst_m")
WORLD = (*EXACT, "within", "iou", "walls", "stuck")
RELATIONS = ("case", "scans", "m", "deg", "before_m", "before_deg", "ratio", "scored by")
MADE = (*EXACT, "folded", "driven_m", "odometry_m")


def suites(args: Namespace) -> dict[str, Suite]:
    """Every suite by name; without the public logs those that need them have no cases."""
    out, drives = args.out.absolute(), by("world", "robot", "teleop")
    grown = (*SIMULATED, "pipeline/stages/map.py", "benchmarks/slam_cost.py")
    return {
        "logs": Suite(logs.log_cases(out), (*BASICS, *logs.COLUMNS, *ENDS), quick=99, code=MAPPER),
        "disturbed": Suite(logs.disturbed_cases(), (*RELATIONS, *ENDS), quick=15, code=DISTURBED),
        "drives": Suite(logs.drive_cases(), (*WORLD, *ENDS), drives, quick=12, code=SIMULATED),
        "fast50": Suite(logs.fast_cases(), (*EXACT, *ENDS), by("sensors"), quick=6, code=SIMULATED),
        "mishaps": Suite(logs.mishap_cases(out), (*MADE, *ENDS), by("lidar"), quick=20, code=SIMULATED),
        "worlds": Suite(logs.world_cases(out), (*WORLD, *ENDS), code=SIMULATED),
        "ablation": Suite(ablation_cases(), (*EXACT, *ENDS), ablation_table, code=SIMULATED),
        "parts": Suite(ablation_cases(CHOICES, PARTS), (*EXACT, *ENDS), ablation_table, code=SIMULATED),
        "numbers": Suite(number_cases(), (*EXACT, *ENDS), number_table, code=SIMULATED),
        "online": Suite(online_cases(), ONLINE, quick=8, code=SIMULATED),
        "growth": Suite(growth_cases(), ("case", *COSTS, "error"), code=grown),
        "space": Suite(space_cases(out), code=SPACE),
        "worth": Suite(worth_cases(), summary=ablation_table, quick=10, code=SPACE),
    }


def main(argv: Sequence[str] | None = None, suites: Callable[[Namespace], dict[str, Suite]] = suites) -> None:
    """Measure what is asked for, print and write the tables."""
    parser = options(__doc__, "data/benchmarks/slam", "a sample that takes less than 20 minutes")
    if public("radish") is None:
        print("TURTLEBAG_DATA names no folder with a folder `radish`: public logs are left out", flush=True)
    run(*parsed(parser, suites, argv, workers=os.cpu_count() or 1))


if __name__ == "__main__":
    main()
