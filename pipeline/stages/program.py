"""Somebody else's program as a stage: what it leaves is measured as ours is, and so is what it takes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.outputs import Output, Stopwatch
from turtlebag.datasets.trajectories import load_tum
from turtlebag.pipeline.stages.requests.program import ProgramRequest
from turtlebag.reports.metrics.references import References

LOG = "program.log"
"""What the program said, in its output folder."""
MEMORY_UNITS = 2**20 if sys.platform == "darwin" else 2**10
"""In a megabyte: the system counts memory in kilobytes, that of a Mac in bytes."""


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
            drifting = load_tum(_left(folder, request.odometry)) if request.odometry else None
            errors = references.errors(path, grid, odometry=False, before_loops=drifting)
            metrics |= {"poses": len(path), **errors}
        out.finish(folder, "program", references.inputs, metrics=metrics)
    return 0


def _left(folder: Path, name: str) -> Path:
    path = folder / name
    if not path.is_file():
        raise InputError(f"the program left no {name}")
    return path


# A process of its own starts the program: what a large one starts counts as large as that from the beginning.
_LAUNCHER = """
import json, resource, subprocess, sys
try:
    code, error = subprocess.call(sys.argv[2:], stdin=subprocess.DEVNULL), None
except OSError as failed:
    code, error = 1, failed.strerror
used = resource.getrusage(resource.RUSAGE_CHILDREN)
with open(sys.argv[1], "w") as file:
    json.dump([code, error, used.ru_utime + used.ru_stime, used.ru_maxrss], file)
"""


def _effort(words: list[str], log: Path, limit_s: float) -> Effort:
    """Run it to its end; InputError for one that fails, or runs longer than the limit."""
    watch = Stopwatch()
    with tempfile.TemporaryDirectory() as aside, log.open("wb") as said:
        told = Path(aside) / "used.json"
        launcher = [sys.executable, "-I", "-S", "-c", _LAUNCHER, str(told), *words]
        process = subprocess.Popen(launcher, stdout=said, stderr=subprocess.STDOUT, start_new_session=True)
        try:
            process.wait(limit_s)
        except subprocess.TimeoutExpired:
            raise InputError(f"{words[0]}: ran longer than {limit_s:g} s") from None
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        if not told.is_file():
            raise InputError(f"{words[0]}: was killed, with the process that measures it")
        code, error, cpu_s, memory = json.loads(told.read_text())
    if error is not None:
        raise InputError(f"{words[0]}: cannot be started ({error})")
    if code != 0:
        lines = log.read_text(errors="replace").strip().splitlines()[-1:] or ["it said nothing"]
        raise InputError(f"{words[0]}: exit code {code}: {lines[0]}")
    return Effort(round(watch.seconds(), 3), round(cpu_s, 3), round(memory / MEMORY_UNITS, 1))
