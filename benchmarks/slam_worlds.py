"""Maps synthetic logs with exact truth; prints and writes how far off the trajectories are.

    python -m benchmarks.slam_worlds [NAME ...] [--quick] [--out DIR]

NAMEs may hold wildcards (default: all logs, see benchmarks.slam_logs). Errors in metres and degrees.
`ate` has the first pose as its only anchor, `fitted` is after a rigid fit and `max` its largest;
`relation` is the error between poses near each other (half of them returns to a place), `return` that
of the returns alone; `folded` is the share of scans laid within 1 m of a place that is 3 m away;
`verdict` is the mapper's own, made without truth. Time is CPU time.
"""

from __future__ import annotations

import argparse
import csv
import fnmatch
import time
from pathlib import Path

from benchmarks.slam_logs import LOGS
from benchmarks.slam_scores import score
from datasets.maps import save_map
from pipeline.slam.slam import SlamConfig, run_slam

COLUMNS = {
    "log": 20, "scans": 6, "length_m": 8, "odometry": 8, "ate": 7, "fitted": 7, "max": 6, "relation": 8,
    "deg": 6, "return": 7, "folded": 6, "verdict": 8, "keys": 5, "loops": 5, "ms_per_scan": 11,
}  # fmt: skip
QUICK = ("ring-8m-1", "hall-2", "office-all-1", "rooms-1", "arena-fast-1")


def measured(name: str, out: Path) -> list[str]:
    """Map one log, save its map, and return its row of the table."""
    log = LOGS[name]()
    start = time.process_time()
    result = run_slam(log.recording, SlamConfig())
    spent = (time.process_time() - start) * 1e3 / len(log.recording)
    save_map(result.grid, out, name)
    s = score(result.trajectory.poses, log.truth)
    assert log.recording.T_odom_base is not None
    odometry = score(log.recording.T_odom_base, log.truth)
    loops = sum(loop.accepted for loop in result.loops)
    return [
        name, str(len(log.recording)), f"{log.truth.length():.0f}", f"{odometry.ate_aligned:.2f}",
        f"{s.ate:.3f}", f"{s.ate_aligned:.4f}", f"{s.ate_max:.3f}", f"{s.relation_m:.4f}",
        f"{s.relation_deg:.3f}", f"{s.return_m:.4f}", f"{s.folded:.2f}",
        "good" if result.check.good else "doubtful", str(len(result.keys)), str(loops), f"{spent:.2f}",
    ]  # fmt: skip


def main() -> None:
    """Print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--quick", action="store_true", help=f"only {', '.join(QUICK)}")
    parser.add_argument("--out", type=Path, default=Path("data/benchmarks/slam_worlds"))
    arguments = parser.parse_args()
    patterns = arguments.names or (QUICK if arguments.quick else ("*",))
    arguments.out.mkdir(parents=True, exist_ok=True)
    with (arguments.out / "slam_worlds.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        print(" ".join(f"{name:>{width}s}" for name, width in COLUMNS.items()))
        for name in LOGS:
            if any(fnmatch.fnmatch(name, pattern) for pattern in patterns):
                row = measured(name, arguments.out)
                writer.writerow(row)
                print(
                    " ".join(f"{value:>{width}s}" for value, width in zip(row, COLUMNS.values(), strict=True))
                )


if __name__ == "__main__":
    main()
