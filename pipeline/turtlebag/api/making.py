"""What all steps share: where an output goes and how long it lives, and the warnings of the step."""

from __future__ import annotations

import inspect
import logging
import shutil
import tempfile
import threading
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from turtlebag.api.given import PathLike
from turtlebag.datasets.output_lock import lock_output
from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.stages.command_line import said_of
from turtlebag.pipeline.stages.requests.options import XYT
from turtlebag.pipeline.stages.requests.request import Request
from turtlebag.pipeline.stages.run import run
from turtlebag.pipeline.terminal.messages import log, show_bars

# Without a handler of its own, a library's warnings are printed.
log.addHandler(logging.NullHandler())
_printed = logging.StreamHandler()


Step = TypeVar("Step", bound=Callable[..., Any])


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


@dataclass(frozen=True)
class Made:
    """An output, the objects that must live as long as it does, and the warnings of its step."""

    path: Path
    kept: tuple[object, ...]
    notes: tuple[str, ...]


def made(
    request: Request,
    out: PathLike | None,
    force: bool,
    *used: object,
    run: Callable[[Request, Output], int] = run,
) -> Made:
    """Do what is asked for, at `out`, or if that is None, in a folder that lives as long as the result, as do
    the objects `used`.

    InputError for what cannot be done; KeyboardInterrupt when a step that keeps what it has was interrupted.
    """
    folder = TemporaryFolder() if out is None else None
    place = Path(out) if folder is None else folder.path / request.VERB  # type: ignore[arg-type]
    with _heard() as notes, lock_output(place, force=force, inputs=request.files()):
        if run(request, Output(place, force)) >= 128:
            raise KeyboardInterrupt
    return Made(place, (folder, *used), tuple(notes))


def takes(kind: type[Request], but: Sequence[str] = ()) -> Callable[[Step], Step]:
    """Of a step whose other keyword arguments are fields of a request: they are shown with their types in its
    signature and its help. `but` are those that it does not take."""

    def decorated(step: Step) -> Step:
        signature = inspect.signature(step)
        own = [one for one in signature.parameters.values() if one.kind is not one.VAR_KEYWORD]
        fields = {
            name: field
            for name, field in kind.model_fields.items()
            if name not in signature.parameters and name not in but
        }
        types = get_type_hints(kind)
        shown = [
            inspect.Parameter(
                name,
                inspect.Parameter.KEYWORD_ONLY,
                default=field.get_default(call_default_factory=True),
                annotation=_type_text(types[name]),
            )
            for name, field in fields.items()
        ]
        lines = (f"    {name}: {said_of(field)}" for name, field in fields.items())
        step.__signature__ = signature.replace(parameters=[*own, *shown])  # type: ignore[attr-defined]
        step.__doc__ = "\n".join([inspect.cleandoc(step.__doc__ or ""), "", "Options:", *lines])
        return step

    return decorated


def _type_text(annotation: Any) -> str:
    """A field's type as a step takes it: any path-like is a path, and an SE2 three numbers too."""
    if get_origin(annotation) in (Union, UnionType):
        return " | ".join(_type_text(one) for one in get_args(annotation))
    text = "None" if annotation is NoneType else inspect.formatannotation(annotation)
    for long, short in (
        ("pathlib.Path", "PathLike"),
        (inspect.formatannotation(XYT), "Pose"),
        ("typing.", ""),
    ):
        text = text.replace(long, short)
    return text


@contextmanager
def _heard() -> Iterator[list[str]]:
    """This thread's warnings meanwhile."""
    me, notes = threading.get_ident(), []

    class Listener(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if record.thread == me:
                notes.append(record.getMessage().removeprefix("note: "))

    listener = Listener(logging.WARNING)
    log.addHandler(listener)
    try:
        yield notes
    finally:
        log.removeHandler(listener)
