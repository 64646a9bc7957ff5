"""What a map costs: CPU seconds and peak memory of `turtlebag map` as a whole command, by size of the log.

Grown are the time at one place (the arena gone round again and again), the area (a maze of more and more
cells) and a public log (ACES, there and back until it has 20,000 scans).
"""

from __future__ import annotations

import bz2
import json
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
import yaml

import turtlebag as tb
from benchmarks.runner import Case, Row
from benchmarks.slam_logs import FAR, public_log
from turtlebag.datasets.grid import UNKNOWN
from turtlebag.datasets.kernels import folders
from turtlebag.datasets.maps import load_map

SCANS = 20_000
GROWN = f"ACES to {SCANS} scans"
LAPS = (1, 2, 4)
SIDES_M = (6, 12, 18)
V = {"burger": 0.2, "jackal": 0.6}
COSTS = ("scans", "keys", "area_m2", "cpu_s", "ms a scan", "scans per s", "peak_mb", "verdict")

# A process of a few megabytes starts the command: Linux counts what the starting process held as the peak of
# the one that it starts.
METER = """
import json, os, sys
child = os.posix_spawn(sys.argv[1], sys.argv[1:], os.environ)
_, status, used = os.wait4(child, 0)
code = os.waitstatus_to_exitcode(status)
print(json.dumps([code, used.ru_utime + used.ru_stime, used.ru_maxrss]))
"""


def map_cost(log: Path, scratch: Path) -> Row:
    """CPU seconds (user and system) and peak memory [MB] of mapping a file.

    A run that had to compile a kernel does not count: the map is made again. RuntimeError when there is none.
    """
    meter = [sys.executable, "-I", "-S", "-c", METER]
    command = [*meter, sys.executable, "-m", "pipeline", "map", "-q", str(log), "--out"]
    while True:
        with tempfile.TemporaryDirectory(dir=scratch) as place:
            before, out = _compiled(), Path(place) / "map"
            done = subprocess.run([*command, str(out)], capture_output=True, text=True, check=True)
            code, cpu_s, peak_kb = json.loads(done.stdout.splitlines()[-1])
            if code:
                raise RuntimeError(done.stderr.strip() or f"exit code {code}")
            if _compiled() != before:
                continue
            said = json.loads((out / "metrics.json").read_text())
            grid = load_map(out / "map.yaml")
            return {
                "scans": said["scans"],
                "keys": said["keyframes"],
                "area_m2": round(np.count_nonzero(grid.cells != UNKNOWN) * grid.resolution**2),
                "cpu_s": round(cpu_s, 1),
                "ms a scan": round(1e3 * cpu_s / said["scans"], 2),
                "scans per s": round(said["scans"] / cpu_s),
                "peak_mb": round(peak_kb / 1e3),
                "verdict": said["self_check"]["verdict"],
            }


def _compiled() -> set[Path]:
    return {file for folder in folders() for file in folder.glob("*.kernel")}


def growth_cases(data: Path | None) -> list[Case]:
    """The public logs there are, then the arena and the floor in all sizes."""
    logs = {"Intel": public_log(data, "intel"), GROWN: public_log(data, "aces")} if data else {}
    cases = [Case(name, partial(log_row, log, name == GROWN)) for name, log in logs.items() if log.is_file()]
    cases += [
        Case(f"arena, {laps} x", partial(driven_row, "turtlebot3_world", "burger", laps)) for laps in LAPS
    ]
    return cases + [
        Case(f"maze, {n} x {n} m", partial(driven_row, f"maze:1,cells={n}", "jackal", 1)) for n in SIDES_M
    ]


def log_row(log: Path, grown: bool) -> Row:
    """A CARMEN log, as it is or there and back."""
    text = bz2.decompress(log.read_bytes())
    return text_row(there_and_back(text) if grown else text)


def driven_row(world: str, robot: str, laps: int) -> Row:
    """A world with its tour driven so many times."""
    with tempfile.TemporaryDirectory() as place:
        script, drive = Path(place) / "laps.yaml", Path(place) / "drive"
        steps = [{"wait": 1.0}, *[{"route": "tour"}] * laps, {"wait": 1.0}]
        script.write_text(yaml.safe_dump({"name": "laps", "v": V[robot], "w": 0.6, "steps": steps}))
        tb.record(world, robot, teleop=script, settings=FAR if robot == "jackal" else None, out=drive)
        return map_cost(drive, Path(place))


def text_row(text: bytes) -> Row:
    """The text of a CARMEN log."""
    with tempfile.TemporaryDirectory() as place:
        log = Path(place) / "log.clf"
        log.write_bytes(text)
        return map_cost(log, Path(place))


def there_and_back(content: bytes, scans: int = SCANS) -> bytes:
    """A CARMEN log driven forwards, then backwards, and so on, until it has so many scans.

    Only so is the way from each scan to the next one that was driven: the log does not end where it
    begins. The wheels err backwards as they do forwards. The clock goes on.
    """
    lines = [line.split() for line in content.split(b"\n") if line.startswith(b"FLASER ")]
    there = list(range(len(lines)))
    order = [0]
    while len(order) < scans:
        order += there[1:] if order[-1] == 0 else there[-2::-1]
    order = order[:scans]
    stamps = np.array([float(words[-3]) for words in lines])
    clock = stamps[0] + np.concatenate([[0.0], np.cumsum(np.abs(np.diff(stamps[order])))])
    said = (
        b" ".join([*lines[k][:-3], b"%.6f" % t, lines[k][-2], b"%.6f" % t])
        for k, t in zip(order, clock.tolist(), strict=True)
    )
    return b"\n".join(said) + b"\n"
