"""Somebody else's program as a stage: what it leaves is measured as ours is, and so is what it takes."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
from dataclasses import asdict, dataclass
from pathlib import Path

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.outputs import Output, Stopwatch
from turtlebag.datasets.trajectories import load_tum
from turtlebag.pipeline.stages.requests.program import ProgramRequest
from turtlebag.reports.metrics.references import References
from turtlebag.reports.metrics.trajectory import trajectory_metrics

LOG = "program.log"
"""What the program said, in its output folder."""


@dataclass(frozen=True)
class Effort:
    """What a program and all that it started took; memory is that of the largest one of them."""

    wall_s: float
    cpu_s: float
    memory_mb: float


def run_program(request: ProgramRequest, out: Output) -> int:
    """Run a program and measure what it leaves, against the truth where that is given.

    InputError, with the last line that it said, when it fails, takes too long, or leaves no such file.
    """
    references = References.load(request.truth, request.relations)
    with out.staged() as folder:
        words = [word.replace("{out}", str(folder)) for word in request.command]
        effort = _effort(words, folder / LOG, request.time_limit_s)
        metrics: dict[str, object] = asdict(effort)
        grid = load_map(_left(folder, request.map)) if request.map else None
        if request.trajectory:
            path = load_tum(_left(folder, request.trajectory))
            metrics |= {"poses": len(path), **references.errors(path, grid, odometry=False)}
        if request.odometry and references.truth is not None:
            drift = trajectory_metrics(load_tum(_left(folder, request.odometry)), references.truth)
            metrics["front_end"] = {"rpe": drift["rpe"]}
        out.finish(folder, "program", references.inputs, metrics=metrics)
    return 0


def _left(folder: Path, name: str) -> Path:
    path = folder / name
    if not path.is_file():
        raise InputError(f"the program left no {name}")
    return path


def _effort(words: list[str], log: Path, limit_s: float) -> Effort:
    """Run it to its end; InputError for one that fails, or runs longer than the limit."""
    watch, late = Stopwatch(), threading.Event()
    with log.open("wb") as said:
        try:
            process = subprocess.Popen(
                words, stdin=subprocess.DEVNULL, stdout=said, stderr=subprocess.STDOUT, start_new_session=True
            )
        except OSError as error:
            raise InputError(f"{words[0]}: cannot be started ({error.strerror})") from None

        def stop() -> None:
            late.set()
            os.killpg(process.pid, signal.SIGKILL)

        timer = threading.Timer(limit_s, stop)
        timer.start()
        try:
            _, status, used = os.wait4(process.pid, 0)
        except BaseException:
            os.killpg(process.pid, signal.SIGKILL)
            raise
        finally:
            timer.cancel()
    process.returncode = os.waitstatus_to_exitcode(status)
    if late.is_set():
        raise InputError(f"{words[0]}: ran longer than {limit_s:g} s")
    if process.returncode != 0:
        lines = log.read_text(errors="replace").strip().splitlines()[-1:] or ["it said nothing"]
        raise InputError(f"{words[0]}: exit code {process.returncode}: {lines[0]}")
    cpu_s = used.ru_utime + used.ru_stime
    return Effort(round(watch.seconds(), 3), round(cpu_s, 3), round(used.ru_maxrss / 1024.0, 1))
