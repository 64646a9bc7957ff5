"""Maps synthetic logs with exact truth and prints how far off the trajectories are.

    python -m benchmarks.slam_worlds [NAME ...]      names may hold wildcards; default: all of them

Errors in metres and degrees. `ATE` has the first pose as its only anchor, `fitted` is after a rigid
fit; `relation` is the error between poses near each other (half of them returns to a place), `return`
that of the returns alone; `folded` is the share of scans laid within 1 m of a place 3 m away.
"""

from __future__ import annotations

import argparse
import fnmatch
import time

from benchmarks.slam_logs import LOGS
from benchmarks.slam_scores import score
from pipeline.slam.slam import SlamConfig, run_slam

HEADER = (
    f"{'log':20s} {'scans':>6s} {'ATE':>7s} {'fitted':>7s} {'max':>6s} {'relation':>8s} {'deg':>6s} "
    f"{'return':>7s} {'folded':>6s} {'keys':>5s} {'loops':>5s} {'ms/scan':>7s}"
)


def row(name: str) -> str:
    """Map one log and describe the outcome in a line of the table."""
    log = LOGS[name]()
    start = time.process_time()
    result = run_slam(log.recording, SlamConfig())
    spent = (time.process_time() - start) * 1e3 / len(log.recording)
    s = score(result.trajectory.poses, log.truth)
    loops = sum(loop.accepted for loop in result.loops)
    return (
        f"{name:20s} {len(log.recording):6d} {s.ate:7.3f} {s.ate_aligned:7.4f} {s.ate_max:6.2f} "
        f"{s.relation_m:8.4f} {s.relation_deg:6.3f} {s.return_m:7.4f} {s.folded:6.2f} "
        f"{len(result.keys):5d} {loops:5d} {spent:7.2f}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("names", nargs="*", default=["*"])
    patterns = parser.parse_args().names
    print(HEADER)
    for name in LOGS:
        if any(fnmatch.fnmatch(name, pattern) for pattern in patterns):
            print(row(name), flush=True)


if __name__ == "__main__":
    main()
