"""What the terminal shows: progress and one-line messages on stderr, results on stdout."""

from __future__ import annotations

import errno
import logging
import math
import os
import re
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, TextIO, TypeVar, cast

if TYPE_CHECKING:
    from types import TracebackType

    from rich.console import Console
    from rich.progress import Progress, ProgressColumn

from turtlebag.datasets.errors import InputError

Item = TypeVar("Item")
log = logging.getLogger("turtlebag")
_bars = False
_above: list[Callable[[str], None]] = []
"""Writes a line above the bar or status line that is on the terminal now, if any."""
_UNSAFE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")
"""What a terminal obeys or does not show in its place: controls but newline and tab, and directions."""


def printable(text: str) -> str:
    """Text from anywhere (a topic, an exception, an option) in whole lines, of which a terminal obeys
    nothing."""
    return _UNSAFE.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def one_line(text: object) -> str:
    """The same in one line."""
    return printable(str(text)).replace("\n", r"\n").replace("\t", r"\t")


class _LineHandler(logging.Handler):
    """Messages on stderr, above the bar where there is one."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write one message as one line."""
        try:
            line = one_line(record.getMessage())
            if not _written_above(line):
                print(line, file=sys.stderr, flush=True)
        except Exception:
            self.handleError(record)


def _written_above(line: str) -> bool:
    """Whether there is a bar or status line, and the line was written above it."""
    for write in _above[-1:]:
        write(line)
    return bool(_above)


def set_verbosity(level: int) -> None:
    """-1 quiet, 0 normal, 1 verbose."""
    logging.basicConfig(handlers=[_LineHandler()], force=True)
    # Where there is no home it warns, twice, of the temporary folder that it finds by itself.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    log.setLevel({-1: logging.ERROR, 0: logging.INFO}.get(level, logging.DEBUG))
    show_bars(level >= 0)


@contextmanager
def verbosity_kept() -> Iterator[None]:
    """Whatever a command within makes of it, messages are shown as before when this is over."""
    root, bars = logging.getLogger(), _bars
    handlers, level = root.handlers[:], log.level
    try:
        yield
    finally:
        root.handlers[:] = handlers
        log.setLevel(level)
        show_bars(bars)


def show_bars(on: bool) -> None:
    """Whether progress is shown at all: the commands ask for it, those who call from Python may not."""
    global _bars
    _bars = on


def quiet() -> bool:
    """Whether -q was given."""
    return log.level >= logging.ERROR


def log_notes(notes: Iterable[str]) -> None:
    """What was repaired or left out on reading, each note once."""
    for note in dict.fromkeys(notes):
        log.warning(f"note: {note}")


def note_degrees(what: str, yaw: float) -> None:
    """A note where a yaw is more than a full turn [rad]."""
    if abs(yaw) > 2.0 * math.pi:
        log_notes([f"{what}: yaw {yaw:g} rad: is it in degrees?"])


def say(line: str) -> None:
    """A line of the result, on stdout as it comes; above the bar when both share a terminal."""
    line = one_line(line)
    if not (sys.stdout.isatty() and _written_above(line)):
        print(line, flush=True)


def tell_traceback(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Python's own, on stderr: `sys.excepthook` of a command."""
    print(printable("".join(traceback.format_exception(kind, error, trace))), end="", file=sys.stderr)


def show_cursor() -> None:
    """A bar or a redrawn frame hides it, and may be ended in the middle."""
    if sys.stderr.isatty():
        bare(sys.stderr).write("\x1b[?25h")


def starting() -> None:
    """A word on the terminal while a command loads its packages: its first line is written over it."""
    if _shown():
        terminal = bare(sys.stderr)
        terminal.write("starting ...\r")
        terminal.flush()


def track(items: Iterable[Item], description: str, total: int | None = None) -> Iterator[Item]:
    """Yield the items behind a progress bar; silent when stderr is not a terminal or -q was given."""
    if not _shown():
        yield from items
        return
    from rich.progress import BarColumn, MofNCompleteColumn, TimeRemainingColumn

    with _bar("{task.description}", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()) as bar:
        yield from bar.track(items, total=total, description=_for_bar(description))


Simulated = Callable[[int, str], None]
"""Called with the stamp [ns] that the simulation has reached, and a word or two on its state."""


@contextmanager
def simulated_time(total_s: float | None = None) -> Iterator[Simulated]:
    """A bar of simulated time, with its pace; silent when stderr is not a terminal or -q was given.

    Without `total_s`, the end is not known: the bar then only shows that something moves.
    """
    if not _shown():
        yield lambda stamp_ns, doing: None
        return
    from rich.progress import BarColumn

    clock = "{task.completed:.0f} s" + ("" if total_s is None else " of {task.total:.0f} s") + " simulated"
    with _bar(clock, BarColumn(bar_width=20), "{task.fields[pace]}", "{task.description}") as bar:
        task = bar.add_task("", total=total_s, pace="")

        def tell(stamp_ns: int, doing: str) -> None:
            seconds = stamp_ns * 1e-9
            elapsed = bar.tasks[0].elapsed or 0.0
            pace = f"{seconds / elapsed:.0f} x real time" if elapsed > 1.0 else ""
            bar.update(task, completed=seconds, description=_for_bar(doing), pace=pace)

        yield tell


@contextmanager
def drawing() -> Iterator[Callable[[str], None]]:
    """A progress bar of figures, called with the title of each before it is drawn; silent as the others."""
    if not _shown():
        yield lambda title: None
        return
    from rich.progress import BarColumn

    with _bar("figure {task.completed:.0f}", BarColumn(), "{task.description}") as bar:
        task = bar.add_task("", total=None)
        yield lambda title: bar.update(task, advance=1, description=_for_bar(title))


def _for_bar(text: str) -> str:
    """A bar reads [words in brackets] as a style."""
    from rich.markup import escape

    return escape(one_line(text))


def _shown() -> bool:
    return _bars and sys.stderr.isatty() and not _above


@contextmanager
def redrawn() -> Iterator[Callable[[str], None]]:
    """Shows each frame of a status line in the place of the last one; silent when stderr is not a terminal or
    -q was given. A frame is cut where the terminal ends."""
    if quiet() or not sys.stderr.isatty():
        yield lambda frame: None
        return
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    console = Console(file=bare(sys.stderr))
    with (
        Live(
            console=console,
            auto_refresh=False,
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
        ) as live,
        _lines_above(console),
    ):
        yield lambda frame: live.update(Text(printable(frame), no_wrap=True, overflow="crop"), refresh=True)


@contextmanager
def _bar(*columns: str | ProgressColumn) -> Iterator[Progress]:
    """One bar on stderr, gone when done. What is printed is not redirected: stdout may be a file."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(file=bare(sys.stderr))
    bar = Progress(*columns, console=console, transient=True, redirect_stdout=False, redirect_stderr=False)
    with bar, _lines_above(console):
        yield bar


@contextmanager
def _lines_above(console: Console) -> Iterator[None]:
    """Something is redrawn on the console meanwhile: lines go above it."""
    _above.append(lambda line: console.print(line, markup=False, highlight=False, soft_wrap=True))
    try:
        yield
    finally:
        _above.pop()


def length(metres: float) -> str:
    """A distance for people, rounded as in reports."""
    if metres >= 1.0:
        return f"{metres:.2f} m"
    return f"{metres * 100:.{2 if metres < 0.1 else 1}f} cm"


def print_table(rows: Sequence[Sequence[str]], left: Sequence[int] = (0,)) -> None:
    """Print rows as a table, a line each: the columns `left` (negative ones from the end) are left-aligned,
    the others right-aligned."""
    rows = [[one_line(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    begin = {number % len(widths) for number in left} if widths else set()
    for row in rows:
        cells = [f"{text:{'<' if k in begin else '>'}{widths[k]}}" for k, text in enumerate(row)]
        print("  ".join(cells).rstrip())


PLAIN = str.maketrans({"\u202f": " ", "\u2212": "-", "\u2013": "-", "\u00b0": "deg"})
"""Thin spaces, minus, dash and degrees, where the terminal cannot show them."""


class Words:
    """A text stream that a terminal may show (see `printable`) and whose trouble is noted: from then on
    nothing more is written to it.

    With `optional` that is all; else the first trouble is raised, as BrokenPipeError when the reader has gone
    away, as InputError otherwise.
    """

    def __init__(self, stream: TextIO, name: str, *, optional: bool) -> None:
        self._stream, self._name, self.optional = stream, name, optional
        self.problem: str | None = None

    def write(self, text: str) -> int:
        """Write what is printable of it, if that still goes."""
        return self.write_bare(printable(text))

    def write_bare(self, text: str) -> int:
        """Write, if that still goes; a terminal of few letters gets plain ones for ours."""
        try:
            self._attempt(lambda: self._stream.write(text))
        except UnicodeEncodeError:
            letters = self._stream.encoding
            plain = text.translate(PLAIN).encode(letters, "replace").decode(letters)
            self._attempt(lambda: self._stream.write(plain))
        return len(text)

    def flush(self) -> None:
        """Hand what was written to the system, if that still goes."""
        self._attempt(self._stream.flush)

    def _attempt(self, action: Callable[[], object]) -> None:
        if self.problem is not None:
            return
        try:
            action()
        except OSError as error:
            gone = isinstance(error, BrokenPipeError)
            reason = "is closed" if error.errno == errno.EBADF else error.strerror
            self.problem = "" if gone else f"{self._name}: {reason}"
            with suppress(OSError):  # what is left in the stream would fail again when Python ends
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())
            if not self.optional:
                raise error if gone else InputError(self.problem) from None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def open_streams() -> None:
    """Give Python's standard streams that were closed when it began to a file that cannot be written and has
    nothing to read: no file that is opened later gets their numbers."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDONLY), mode))


class _Bare:
    """`Words` for those who move the cursor."""

    def __init__(self, words: Words) -> None:
        self._words, self.write = words, words.write_bare

    def __getattr__(self, name: str) -> Any:
        return getattr(self._words, name)


def bare(stream: TextIO) -> TextIO:
    """A stream as rich needs it, which writes a terminal's commands: what it is to show is made printable
    before."""
    return cast(TextIO, _Bare(stream)) if isinstance(stream, Words) else stream


@contextmanager
def guarded_streams() -> Iterator[Words]:
    """Put `Words` in the place of stdout, which is yielded, and of stderr."""
    open_streams()
    before = sys.stdout, sys.stderr
    out, err = Words(sys.stdout, "stdout", optional=False), Words(sys.stderr, "stderr", optional=True)
    sys.stdout, sys.stderr = cast(TextIO, out), cast(TextIO, err)
    try:
        yield out
    finally:
        out.optional = True
        out.flush()
        err.flush()
        sys.stdout, sys.stderr = before
