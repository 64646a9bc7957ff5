"""What all steps share: output folders, the equivalent command line, warnings and errors."""

from __future__ import annotations

import inspect
import json
import logging
import os
import re
import shutil
import tempfile
import textwrap
import threading
import weakref
from argparse import Namespace
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.output_lock import lock_output
from turtlebag.datasets.parts import name_of, told_kind
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.yaml_files import parsed
from turtlebag.pipeline.terminal.messages import log, show_bars

PathLike = str | os.PathLike[str]
Pose = SE2 | Sequence[float] | np.ndarray
"""x, y [m] and yaw [rad]: three numbers, or an SE2."""

# Without a handler of its own, a library's warnings are printed.
log.addHandler(logging.NullHandler())
_printed = logging.StreamHandler()
IN_PYTHON = {"set": "settings", "force": "force=True", "wiggle": "wiggle=True"}
IN_PYTHON |= {"system": "systems", **{f"system-{what}": what for what in ("base", "times", "shift")}}
FARTHEST = 1e9


def verbose(on: bool = True) -> None:
    """Show messages on stderr as the commands do, with progress bars in a terminal; False turns this off
    again."""
    show_bars(on)
    log.removeHandler(_printed)
    if on:
        log.addHandler(_printed)
    log.setLevel(logging.INFO if on else logging.NOTSET)


class TemporaryFolder:
    """A folder that exists as long as something refers to it."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="turtlebag-"))
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)


@dataclass
class Step:
    """A running step: its command, the objects that must live as long as its result, and its warnings so
    far."""

    verb: str
    out: Path
    force: bool
    kept: list[object] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def run(self, *inputs: PathLike, **options: Any) -> None:
        """Run the command, as its module does; KeyboardInterrupt when one that keeps what it has was
        interrupted."""
        args = self.arguments(*inputs, **options)
        if args.run(args) >= 128:
            raise KeyboardInterrupt

    def arguments(self, *inputs: PathLike, **options: Any) -> Namespace:
        """What the command line would make of them."""
        from turtlebag.pipeline.cli.main import build_parser

        words = command_line(self.verb, *inputs, **options, out=self.out)
        args = build_parser(self.verb).parse_args(words[1:])
        args.force, args.command_line, args.verbosity = self.force, words, -1
        return args


@contextmanager
def step(
    verb: str, out: PathLike | None, *, force: bool = False, inputs: Mapping[str, PathLike | None]
) -> Iterator[Step]:
    """Make an output within this context: at `out`, or if that is None, in a folder that lives as long as the
    result.

    An InputError names Python's arguments, not options of the command line. Inputs, by the names of their
    arguments, must not change; those that are objects live as long as the result.
    """
    read = [path_of(one, what) for what, one in inputs.items() if one is not None]
    folder = None if out is not None else TemporaryFolder()
    place = path_if(out, "out") or folder.path / verb  # type: ignore[union-attr]
    now = Step(verb, place, force, [folder, *inputs.values()])
    with in_python(), _heard(now.notes), lock_output(now.out, force=force, inputs=read):
        yield now


@contextmanager
def in_python() -> Iterator[None]:
    """InputErrors raised within name the arguments of Python instead of the command line's options."""
    try:
        yield
    except InputError as error:
        said = re.sub(r"^\w+: argument (.*) \(see turtlebag \w+ --help\)$", r"\1", str(error))
        raise InputError(re.sub(r"(?<![\w./-])--([a-z]+(?:-[a-z]+)*)", _argument, said)) from error.__cause__


def _argument(option: re.Match[str]) -> str:
    return IN_PYTHON.get(option[1], option[1].replace("-", "_"))


@contextmanager
def _heard(notes: list[str]) -> Iterator[None]:
    """Collect this thread's warnings in the list meanwhile."""
    me = threading.get_ident()

    class Listener(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if record.thread == me:
                notes.append(record.getMessage().removeprefix("note: "))

    listener = Listener(logging.WARNING)
    log.addHandler(listener)
    try:
        yield
    finally:
        log.removeHandler(listener)


def command_line(verb: str, *inputs: PathLike, **options: Any) -> list[str]:
    """The equivalent command, for the manifest; options that are None or False are left out."""
    named = [os.fspath(one) for one in inputs]
    words = ["turtlebag", verb, *(f"./{path}" if path.startswith("-") else path for path in named)]
    for name, value in options.items():
        option = f"--{name.replace('_', '-')}"
        for one in value if isinstance(value, (list, tuple)) else [value]:
            if one is True:
                words.append(option)
            elif one is not None and one is not False:
                text = _option_text(one)
                words += [f"{option}={text}"] if text.startswith("-") else [option, text]
    return words


def _option_text(value: Any) -> str:
    if isinstance(value, SE2):
        return pose_text(value)
    return os.fspath(value) if isinstance(value, os.PathLike) else str(value)


def in_a_line(value: object) -> str:
    """A value as one line of limited length."""
    return textwrap.shorten(repr(value), 100, placeholder=" ...")


def pose_of(value: Pose, what: str) -> SE2:
    """A pose from three numbers; InputError names `what` if it is not one."""
    try:
        xyt = value.xyt if isinstance(value, SE2) else np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        xyt = np.zeros(0)
    if xyt.shape != (3,) or not np.isfinite(xyt).all() or np.abs(xyt).max() > FARTHEST:
        shown = in_a_line(value.xyt if isinstance(value, SE2) else value)
        raise InputError(
            f"{what}: expected three finite numbers x, y, yaw in metres and radians, not {shown}"
        )
    return SE2.from_xyt(*(float(number) for number in xyt))


def initial_pose_of(value: Pose | str | None, *words: str) -> SE2 | str | None:
    """The initial pose: a pose, one of the words, or None; InputError for anything else."""
    if value is None or (isinstance(value, str) and value in words):
        return value
    if isinstance(value, str):
        raise InputError(f"initial_pose: expected x, y, yaw or {' or '.join(words)}, not {value!r}")
    return pose_of(value, "initial_pose")


def pose_text(pose: SE2) -> str:
    """A pose as the command line takes it, with all digits."""
    return ",".join(repr(float(number)) for number in pose.xyt)


def laser_text(laser: Pose | None, upside_down: bool) -> str | None:
    """The pose of a laser as the command line takes it; InputError if it is not one."""
    if laser is not None:
        return pose_text(pose_of(laser, "laser")) + (",upside-down" if upside_down else "")
    if upside_down:
        raise InputError("upside_down: give laser, the pose of the laser on the robot, with it")
    return None


def text_of(value: PathLike, what: str, kind: str = "a name or a path") -> str:
    """A name or a path as text; InputError names `what` if it is neither."""
    text = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    if not isinstance(text, str) or not text or "\0" in text:
        shown = repr(value) if isinstance(value, str | bytes) else told_kind(value)
        raise InputError(f"{what}: expected {kind}, not {shown}")
    return text


def path_of(value: PathLike, what: str) -> Path:
    """A path; InputError names `what` if it is not one."""
    return Path(text_of(value, what, "a path"))


def path_if(value: PathLike | None, what: str) -> Path | None:
    """A path, if there is one."""
    return None if value is None else path_of(value, what)


def list_of(values: Iterable[Any], what: str) -> list[Any]:
    """The values of any list; InputError names `what` if it is not one, such as a text."""
    if isinstance(values, str | bytes | os.PathLike) or not isinstance(values, Iterable):
        raise InputError(f"{what}: expected a list, not {told_kind(values)}")
    return list(values)


def part_name(part: Any) -> Any:
    """The name `module:Class` of a user's class; anything else unchanged."""
    return name_of(part) if inspect.isclass(part) else part


def planner_name(planner: str | type | None) -> str | None:
    """The name of a planner, given by it or as a class."""
    return None if planner is None else text_of(part_name(planner), "planner", "a name or a class")


def setting_words(settings: Mapping[str, Any] | None, **more: Any) -> list[str]:
    """`{"loops.match": "open3d"}` as `loops.match=open3d`, which --set takes; classes by their names. `more`
    are settings with arguments of their own; None does not change them."""
    if not isinstance(settings, Mapping | None):
        raise InputError(
            f'settings: expected a mapping such as {{"loops.match": "open3d"}}, not {told_kind(settings)}'
        )
    chosen = {key: value for key, value in more.items() if value is not None}
    return [f"{key}={_value_text(value, key)}" for key, value in {**(settings or {}), **chosen}.items()]


def _value_text(value: Any, key: str) -> str:
    value = part_name(value)
    if isinstance(value, str) and value and parsed(value, where=key) == value:
        return value
    try:
        return json.dumps(value, default=lambda one: one.tolist())
    except (TypeError, AttributeError):
        raise InputError(
            f"settings {key}: expected a number, text, list or class, not {in_a_line(value)}"
        ) from None


def require_seed(seed: int) -> int:
    """A seed; InputError if it is not one."""
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed: expected a whole number, 0 or more, not {in_a_line(seed)}")
    return int(seed)
