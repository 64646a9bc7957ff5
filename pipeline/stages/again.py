"""A finished output once more: from the request in its manifest, and what it read, wherever that lies now."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.parts import is_own
from turtlebag.datasets.yaml_files import checked
from turtlebag.pipeline.stages.command_line import read, recorded
from turtlebag.pipeline.stages.other_systems import MARK, from_manifest
from turtlebag.pipeline.stages.recipe import folder_of
from turtlebag.pipeline.stages.requests.drives import KeyboardRequest, NavigateRequest, RecordRequest
from turtlebag.pipeline.stages.requests.request import Request
from turtlebag.pipeline.stages.requests.table import REQUESTS
from turtlebag.pipeline.stages.run import run
from turtlebag.pipeline.terminal.messages import set_verbosity, verbosity_kept
from turtlebag.reports.stages import Input, Manifest, Stage, changed_files

OURS = "turtlebag."


class NotRun(Exception):
    """Why an output cannot be made once more, in a line."""


def made_again(stage: Stage, stages: Sequence[Stage], out: Path, *, allow_commands: bool) -> None:
    """Run a stage once more, into `out`, from what it read, which may be of the other stages; NotRun says why
    it cannot be."""
    manifest = stage.manifest
    request = request_in(manifest)
    require_ours(request, allow_commands=allow_commands)
    places = {entry.path: _place_of(name, entry, stage, stages) for name, entry in manifest.inputs.items()}
    request = request.moved(lambda value: _moved(value, places))
    by_hand = isinstance(request, KeyboardRequest) or manifest.interrupted
    if isinstance(request, NavigateRequest) and request.teleop_override == "keyboard":
        driven = stage.folder / "teleop_override.yaml"
        request = request.model_copy(update={"teleop_override": driven if driven.is_file() else None})
    with quietly():
        if by_hand and isinstance(request, RecordRequest | KeyboardRequest):
            from turtlebag.pipeline.stages.record import record_again

            record_again(request, stage.folder / "bag", recorded(request, Output(out)))
        elif by_hand:
            raise NotRun("was interrupted: it cannot be run again to the same end")
        else:
            run(request, Output(out))


def report_again(report: Path, manifest: Manifest, folders: Sequence[Path], out: Path) -> None:
    """Make a report once more from the folders of its stages; NotRun says why it cannot be."""
    request = request_in(manifest)
    stages = [entry.path for label, entry in manifest.inputs.items() if not label.startswith(MARK)]
    places = dict(zip(stages, folders, strict=True))
    for one in from_manifest(manifest, report):
        for what, path in one.inputs().items():
            if (entry := manifest.inputs.get(f"{MARK}{one.name}/{what}")) is not None:
                places[entry.path] = path
    with quietly():
        run(request.moved(lambda value: _moved(value, places)), Output(out))


@contextmanager
def quietly() -> Iterator[None]:
    """Nothing is shown within; NotRun in place of what a request that cannot be done ends in."""
    try:
        with verbosity_kept(), redirect_stderr(io.StringIO()), redirect_stdout(io.StringIO()):
            set_verbosity(-1)
            yield
    except NotRun:
        raise
    except Exception as error:  # a manifest is a file: what it asks for may end in anything
        said = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
        raise NotRun(f"cannot be run again: {' '.join(said.split())}") from None


def request_in(manifest: Manifest) -> Request:
    """The request of a manifest; NotRun where there is none of ours."""
    fields = dict(manifest.request or {})
    verb = str(fields.pop("verb", None))
    kind = REQUESTS.get(verb)
    if kind is None:
        raise NotRun("made by an earlier version: run it again")
    # A page may come from anybody: no command is run for it but those that make what it shows.
    if manifest.stage != {KeyboardRequest.VERB: "record"}.get(verb, verb):
        raise NotRun(f"is an output of {manifest.stage}, but its request is of {verb}")
    if isinstance(fields.get("config"), str):  # what a file said is recorded; a name may lead to any part
        raise NotRun(
            f"its request names a settings file, {fields['config']}, instead of holding its settings"
        )
    try:
        return checked(kind, fields, where="request")
    except InputError as error:
        raise NotRun(f"cannot be run again: {error}") from None


def require_ours(request: Request, *, allow_commands: bool) -> None:
    """NotRun for a request that names what is not of this package: running it would run its code."""
    texts = set(_texts(request.model_dump(mode="json")))
    others = sorted(text for text in texts if is_own(text) and not text.startswith(OURS))
    if others and not allow_commands:
        raise NotRun(f"names {others[0]}, from outside the package; --allow-commands runs it")


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, list | dict):
        for one in value.values() if isinstance(value, dict) else value:
            yield from _texts(one)


def _place_of(name: str, entry: Input, reader: Stage, stages: Sequence[Stage]) -> Path:
    """Where an input of a stage lies now: in a stage that made it, by its hashes, or where it lay, seen from
    here or from the output of the stage that read it."""
    place, started_in = entry.path, reader.manifest.started_in
    if not place.exists() and started_in is not None:
        place = reader.folder.resolve() / started_in / place
    for stage in stages:
        if (made := folder_of(entry, stage)) is not None:
            place = stage.folder / entry.path.relative_to(made)
            break
    if not place.exists():
        raise NotRun(f"its input {name}, {entry.path}, is gone")
    if changed := changed_files(place if place.is_dir() else place.parent, entry.sha256):
        raise NotRun(f"its input {name}, {entry.path}, is not what it was ({changed[0]})")
    return place


def _moved(value: str | Path, places: Mapping[Path, Path]) -> str | Path:
    """A path of a request, or a name that begins with one, where what it names lies now."""
    path, text = Path(value), str(value)
    for old, new in places.items():
        if path == old:
            return type(value)(str(new))
        if path.parts and old.is_relative_to(path):  # a folder of which that was read
            inside = old.relative_to(path).parts
            if new.parts[-len(inside) :] == inside:
                return type(value)(str(new.parents[len(inside) - 1]))
        if isinstance(value, str) and text.startswith((f"{old}:", f"{old}+")):
            return f"{new}{text.removeprefix(str(old))}"
    return value


def command_differs(manifest: Manifest) -> str | None:
    """What is wrong with the command of a manifest, which must ask for what its request says."""
    request = request_in(manifest)
    try:
        typed = read(manifest.command[1:])
    except InputError as error:
        return f"the command in its manifest cannot run: {error}"
    if type(typed) is not type(request):
        return f"the command in its manifest is of {typed.VERB}"
    for name, value in typed:
        asked = getattr(request, name)
        files = (getattr(one, "config", None) for one in (typed, request))
        read_then = name in ("config", "settings") and any(files)  # what it said stands in the request
        in_folder = name == "map" and isinstance(value, Path) and value / "map.yaml" == asked
        if value != asked and not read_then and not in_folder:
            return f"the command in its manifest has another {name} than its request: {value} and {asked}"
    return None
