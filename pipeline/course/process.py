"""A student's file in a process of its own: asked from here, ended when it takes or prints too much."""

from __future__ import annotations

import json
import math
import os
import pickle
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from turtlebag.datasets.se2 import Array

MEMORY_MB = 2048
PRINTED_BYTES = 100_000
"""What a file may print, all cases together."""
SHOWN_CHARACTERS = 2000
ANSWER_BYTES = 20_000_000
LEAST_CPU_S, FIRST_CPU_S = 5, 60
"""CPU seconds: the least that anybody gets, and what the solution gets, whose time is not known yet."""


class Fault(Exception):
    """What a file did wrong in one case, in a line."""


class Ended(Fault):
    """The process is gone: nothing more can be asked."""


@dataclass
class Pupil:
    """A running file. Use as a context manager; `cpu_s` and `printed` are known when it is left."""

    source: Path
    wanted: Mapping[str, Sequence[str]]
    """The classes that it must have, and their methods."""
    limit_s: int = FIRST_CPU_S
    printed: str = field(default="", init=False)
    cpu_s: float = field(default=0.0, init=False)
    _bytes: int = field(default=0, init=False)
    _late: bool = field(default=False, init=False)
    _waited_s: float = field(default=0.0, init=False)
    _asked: float | None = field(default=None, init=False)
    """When the question was asked that has no answer yet [s]."""

    def __enter__(self) -> Pupil:
        theirs_in, ours_out = os.pipe()
        ours_in, theirs_out = os.pipe()
        self._folder = tempfile.TemporaryDirectory(prefix="turtlebag-grade-")
        source, wanted = self.source.resolve(), json.dumps(self.wanted)
        words = [source, wanted, MEMORY_MB, self.limit_s, theirs_in, theirs_out]
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "turtlebag.pipeline.course.pupil", *map(str, words)],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, cwd=self._folder.name,
            env={**os.environ, **threads, "PYTHONHASHSEED": "0", "PYTHONDONTWRITEBYTECODE": "1"},
            pass_fds=(theirs_in, theirs_out), start_new_session=True,
        )  # fmt: skip
        os.close(theirs_in)
        os.close(theirs_out)
        self._questions, self._answers = os.fdopen(ours_out, "wb"), os.fdopen(ours_in, "rb")
        self._pickler = pickle.Pickler(self._questions)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self._over = threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()
        return self

    def __exit__(self, *unused: object) -> None:
        self._end()
        self._folder.cleanup()

    @property
    def overflow(self) -> str:
        """The words for one that printed too much; empty for one that did not."""
        return f"it printed more than {PRINTED_BYTES // 1000} kB" if self._bytes > PRINTED_BYTES else ""

    def begin(self) -> None:
        """Wait until the file is imported; Ended when it cannot be."""
        answer = self._answer()
        if "ready" not in answer:
            raise Ended(str(answer.get("fault")))

    def new(self, name: str, **given: Any) -> None:
        """Make an object of the class of that name, in place of the last one.

        From then on, what it is given again and again, such as a costmap, is sent once.
        """
        try:
            self._say({"new": name, "given": given})
        finally:
            self._pickler.clear_memo()

    def ask(self, method: str, shape: tuple[int | None, ...] | None, **given: Any) -> Array:
        """Call a method: an array of that shape (None: any length), with finite numbers only.

        Without a shape, the answer is not looked at. Fault for anything else.
        """
        value = np.array(self._say({"call": method, "given": given, "mute": shape is None}), dtype=float)
        if shape is None:
            return value
        if len(shape) != value.ndim or any(
            n not in (None, m) for n, m in zip(shape, value.shape, strict=True)
        ):
            must = str(shape).replace("None", "n")
            raise Fault(f"{method} returned an array of shape {value.shape}; it must be {must}")
        if not np.isfinite(value).all():
            raise Fault(f"{method} returned numbers that are not finite")
        return value

    def _say(self, question: dict[str, Any]) -> Any:
        try:
            self._pickler.dump(question)
            self._questions.flush()
        except OSError:
            raise Ended(self._reason()) from None
        answer = self._answer()
        if "fault" in answer:
            raise Fault(re.sub(r"0x[0-9a-f]+", "0x...", str(answer["fault"])))
        return answer.get("value")

    def _answer(self) -> dict[str, Any]:
        begin = self._asked = time.monotonic()
        line = self._answers.readline(ANSWER_BYTES)
        self._asked = None
        self._waited_s += time.monotonic() - begin
        try:
            answer = json.loads(line)
        except (ValueError, RecursionError):
            answer = None
        if not isinstance(answer, dict):
            raise Ended(self._reason())
        return answer

    def _reason(self) -> str:
        """Why there is no answer; the process is ended first."""
        self._end()
        if self.overflow:
            return self.overflow
        if self._late or self._process.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
            return "it did not end: it used more than ten times the time of the solution"
        return f"it ended before it answered (exit code {self._process.returncode})"

    def _end(self) -> None:
        """End it, and whatever it started; once."""
        if self.cpu_s:
            return
        for pipe in (self._questions, self._answers):
            with suppress(OSError):  # what was still to be said has no reader
                pipe.close()
        self._asked = time.monotonic()
        try:
            _, status, used = os.wait4(self._process.pid, 0)
            self._process.returncode = os.waitstatus_to_exitcode(status)
            self.cpu_s = used.ru_utime + used.ru_stime
        finally:
            self._over.set()
            self._kill()
        self._reader.join(5.0)

    def _kill(self) -> None:
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)

    def _watch(self) -> None:
        """End it when its answers take too long, as he who sleeps uses no CPU time; ours between them does
        not count.
        """
        while not self._over.wait(0.5):
            asked = self._asked
            waited_s = self._waited_s + (time.monotonic() - asked if asked is not None else 0.0)
            if waited_s > 4.0 * self.limit_s + 20.0:
                self._late = True
                self._kill()
                return

    def _read(self) -> None:
        """Keep the beginning of what it prints; end it when that is too much."""
        assert self._process.stdout is not None
        kept = b""
        with self._process.stdout as stream:
            while chunk := os.read(stream.fileno(), 65536):
                kept = (kept + chunk)[: 4 * SHOWN_CHARACTERS]
                self._bytes += len(chunk)
                self.printed = kept.decode(errors="replace")[:SHOWN_CHARACTERS]
                if self._bytes > PRINTED_BYTES:
                    self._kill()


def cpu_limit(solution_s: float) -> int:
    """CPU seconds of a student's file: ten times those of the solution."""
    return max(LEAST_CPU_S, math.ceil(10.0 * solution_s))
