"""`turtlebag record` killed with SIGKILL at random moments: nothing looks whole, at most 2 s are lost.

python -m benchmarks.bags_kill [--count 200] [--quick] [--seed 0] [--out DIR]
"""

from __future__ import annotations

import argparse
import csv
import mmap
import os
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader

from turtlebag.datasets.bags.recover import recover
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.recordings import load_recording
from turtlebag.pipeline.stages.record import record


def recording_child(out: Path, seed: int, progress: mmap.mmap) -> None:
    """Record, telling after every observation how far the data is that was handed to the bag."""
    write = BagWriter.observation

    def told(self: BagWriter, observation) -> None:
        write(self, observation)
        progress[:8] = observation.stamp_ns.to_bytes(8, "little")

    BagWriter.observation = told
    record("turtlebot3_world", None, "tour", seed, out)


def one_kill(out: Path, seed: int, kill_s: float, full_s: float) -> tuple[str, float]:
    """Outcome of a recording killed when it was `kill_s` seconds long, and the seconds of data lost."""
    progress = mmap.mmap(-1, 8)
    child = os.fork()
    if child == 0:
        devnull = os.open(os.devnull, os.O_WRONLY)
        os.dup2(devnull, 1), os.dup2(devnull, 2)
        try:
            recording_child(out, seed, progress)
        finally:
            os._exit(0)
    while int.from_bytes(progress[:8], "little") * 1e-9 < kill_s:
        if os.waitpid(child, os.WNOHANG)[0]:
            return ("finished before the kill" if out.exists() else "BAD: recording failed"), 0.0
        time.sleep(0.0005)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    written = int.from_bytes(progress[:8], "little") * 1e-9
    if out.exists():
        return ("finished before the kill", 0.0) if looks_whole(out) else ("BAD: half an output", 0.0)
    partial = out.with_name(out.name + ".partial")
    bag = partial / "bag"
    if not bag.exists():
        return "killed before the bag was opened", 0.0
    if looks_whole(bag) and written < full_s:
        return "BAD: looks whole and is not", 0.0
    try:
        saved = recover(partial, out.with_name(out.name + ".saved"))
    except InputError as error:
        lost = written
        return ("nothing on disk yet" if lost < 2.0 else f"BAD: {error}"), lost
    load_recording(out.with_name(out.name + ".saved")) if written > 3.0 else None
    lost = written - saved.end_ns * 1e-9
    return ("recovered" if lost <= 2.0 else "BAD: lost more than 2 s"), lost


def looks_whole(path: Path) -> bool:
    """Whether metadata or the official reader would take it for a complete bag."""
    bag = path / "bag" if (path / "bag").is_dir() else path
    if (bag / "metadata.yaml").exists():
        return True
    try:
        with (bag / "bag_0.mcap").open("rb") as file:
            return make_reader(file).get_summary() is not None
    except (McapError, OSError):
        return False


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--quick", action="store_true", help="10 kills")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("data/benchmarks"))
    args = parser.parse_args()
    count = 10 if args.quick else args.count
    rng = np.random.default_rng(args.seed)
    outcomes: Counter[str] = Counter()
    losses, rows = [], []
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        record("turtlebot3_world", None, "tour", 1, scratch / "whole")
        full_s = max(m.log_time_ns for m in open_bag(scratch / "whole").messages()) * 1e-9
        for index, kill_s in enumerate(rng.uniform(0.0, full_s, count)):
            outcome, lost = one_kill(scratch / f"r{index}", 1, float(kill_s), full_s)
            outcomes[outcome] += 1
            rows.append((f"{kill_s:.3f}", outcome, f"{lost:.3f}"))
            losses.append(lost)
    for outcome, n in sorted(outcomes.items()):
        print(f"{n:5}  {outcome}")
    print(f"lost: {np.mean(losses):.3f} s on average, {np.max(losses):.3f} s at most")
    args.out.mkdir(parents=True, exist_ok=True)
    with (args.out / "bags_kill.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("kill_s", "outcome", "lost_s"), *rows])
    return int(any(outcome.startswith("BAD") for outcome in outcomes))


if __name__ == "__main__":
    sys.exit(main())
