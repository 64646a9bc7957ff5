"""Typed YAML files: validated with a pydantic model, errors in one line."""

from __future__ import annotations

import logging
import re
from collections.abc import Collection
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from turtlebag.datasets.errors import InputError

Model = TypeVar("Model", bound=BaseModel)
Loc = tuple[int | str, ...]
"""Keys that lead to a value, as pydantic names them."""
# libyaml's, where it is there: the same in a fraction of the time.
_SAFE: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
DUMPER: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
DEEPEST = 100
"""Collections within collections; libyaml would go on until the stack is full, and the process gone."""
MOST_VALUES = 1_000_000
"""Values of one text with its aliases written out: some 100,000 inputs of a session."""
ONE_VALUE = 10_000
"""Characters of a text that count as one value, so that aliases cannot repeat a long one without bound."""
MOST_BYTES = 64 << 20
MOST_DOCUMENTS = 10_000
KINDS = {
    **dict.fromkeys(("tuple_type", "list_type"), "expected a list"),
    **dict.fromkeys(("dict_type", "model_type", "model_attributes_type"), "expected keys and values"),
    "missing": "is missing",
}
"""Messages for values of the wrong type, without names of Python classes."""


class _Loader(_SAFE):  # type: ignore[misc]
    """YAML 1.1, but for its numbers to the base of 60: `1:30` is a text, as in YAML 1.2, not 90."""

    def resolve(self, kind: type, value: str | None, implicit: object) -> str:
        """The tag of a value."""
        tag: str = super().resolve(kind, value, implicit)
        number = tag in ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
        return "tag:yaml.org,2002:str" if number and value is not None and ":" in value else tag


LOADER: Any = _Loader


class TooLarge(ValueError):
    """YAML that would take minutes or gigabytes to read, however short its text is."""


def read_yaml(path: Path, *, where: str) -> Any:
    """A YAML file as plain values; an InputError starts with `where`."""
    return parsed(_text(path, where), where=where)


def read_documents(path: Path, *, where: str) -> list[Any]:
    """The documents of a YAML file, without empty ones: `ros2 topic echo` parts its messages by `---`."""
    parts = re.split(r"(?m)^---[ \t]*$", _text(path, where))
    if len(parts) > MOST_DOCUMENTS:
        raise InputError(f"{where}: more than {MOST_DOCUMENTS} documents")
    found: list[Any] = []
    for number, part in enumerate(parts):
        try:
            found.append(parsed(part, where=where))
        except InputError:  # the same once more, with the file's numbers of the lines
            parsed("\n" * sum(above.count("\n") for above in parts[:number]) + part, where=where)
            raise
    return [document for document in found if document is not None]


def _text(path: Path, where: str) -> str:
    if path.is_dir():
        raise InputError(f"{where}: is a folder; give a file")
    if not path.is_file():
        raise InputError(f"{where}: no such file")
    try:
        if path.stat().st_size > MOST_BYTES:
            raise InputError(f"{where}: larger than {MOST_BYTES >> 20} MB")
        return path.read_text()
    except OSError as error:
        raise InputError(f"{where}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{where}: not a text file") from None


def read_mapping(path: Path) -> dict[str, Any]:
    """Read a YAML file with a mapping; InputError for anything else."""
    data = read_yaml(path, where=str(path))
    if data is None:
        raise InputError(f"{path}: the file is empty")
    if not isinstance(data, dict):
        raise InputError(f"{path}: expected keys and values, found a {type(data).__name__}")
    return data


def parsed(text: str, *, where: str) -> Any:
    """YAML text as plain values, or an InputError with the line that is wrong."""
    try:
        return plain_values(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        # At the end of the text libyaml counts a line that is not there.
        line = "" if mark is None else f", line {min(mark.line + 1, len(text.splitlines()))}"
        raise InputError(f"{where}{line}: not valid YAML") from None
    except TooLarge as error:
        raise InputError(f"{where}: {error}") from None
    except (ValueError, OverflowError) as error:
        # A date of the year 0, an integer of a million digits: YAML's own constructors refuse.
        raise InputError(f"{where}: not valid YAML ({' '.join(str(error).split())})") from None


def plain_values(text: str) -> Any:
    """Parse YAML; yaml.YAMLError or ValueError if that fails, TooLarge if it would take too long."""
    _require_bounded(text)
    return yaml.load(text, Loader=LOADER)


def _require_bounded(text: str) -> None:
    """TooLarge unless the depth and what the aliases repeat are within bounds.

    An alias is cheap to parse, but merge keys and whoever walks through the values write it out: ten lines
    that each name the one above ten times are more than any memory holds.
    """
    count, started = 0, list[tuple[str | None, int]]()
    sizes: dict[str | None, int] = {}
    """Values below each anchor, its aliases written out."""
    for event in yaml.parse(text, Loader=LOADER):
        if isinstance(event, yaml.CollectionStartEvent):
            started.append((event.anchor, count))
            sizes[event.anchor] = MOST_VALUES  # until it ends: within itself it has no end
            count += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = started.pop()
            sizes[anchor] = count - before
        elif isinstance(event, yaml.ScalarEvent):
            sizes[event.anchor] = 1 + len(event.value) // ONE_VALUE
            count += sizes[event.anchor]
        elif isinstance(event, yaml.AliasEvent):
            count += sizes.get(event.anchor, 1)  # one that names nothing is the loader's to refuse
        if len(started) > DEEPEST:
            raise TooLarge("nested too deeply to be read")
        if count > MOST_VALUES:
            raise TooLarge(f"more than {MOST_VALUES} values, with its aliases (*name) written out")


def checked(model: type[Model], data: Any, *, where: str) -> Model:
    """`data` as the model, or an InputError with the first wrong key.

    Keys that a model names in `REMOVED` are left out, with a note: files of earlier versions still have them.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        errors = error.errors()
    if removed := {said["loc"]: note for said in errors if (note := _of_model(model, said, "REMOVED"))}:
        for loc, note in removed.items():
            logging.getLogger("turtlebag").warning("note: %s: %s: left out: %s", where, _dotted(loc), note)
        return checked(model, _without(data, removed), where=where)
    first = errors[0]
    if first["type"] == "missing":  # a misspelt key is named before the key that it stands for
        beside = (e for e in errors if e["type"] == "extra_forbidden" and e["loc"][:-1] == first["loc"][:-1])
        first = next(beside, first)
    what = plain_message(first)
    if first["type"] == "extra_forbidden":
        what = _unknown(model, first)
    elif description := _description(model, first["loc"]):
        what += f" ({description})"
    raise InputError(f"{where}: {_dotted(first['loc'])}: {' '.join(what.split())}")


def _dotted(loc: Loc) -> str:
    return ".".join(str(part) for part in loc) or "top level"


def _without(data: Any, locs: Collection[Loc]) -> Any:
    """The data less the values at these places; what is given stays as it is."""
    here, below = {loc[0] for loc in locs if len(loc) == 1}, [loc for loc in locs if len(loc) > 1]
    return {
        key: _without(value, inner) if (inner := [loc[1:] for loc in below if loc[0] == key]) else value
        for key, value in data.items()
        if key not in here
    }


def plain_message(error: ErrorDetails) -> str:
    """What is wrong with a value, without Python's words."""
    said = error["msg"].removeprefix("Value error, ").replace(" after validation", "")
    said = said.partition(", unable to ")[0]
    return KINDS.get(error["type"], re.sub(r"^\w+ should ", "must ", said))


def _unknown(model: type[BaseModel], error: ErrorDetails) -> str:
    """What to say of an unknown key: its present name, else the known keys where there is a plain model."""
    if new := _of_model(model, error, "RENAMED"):
        return f"is now called {new}"
    inner = _innermost(model, error["loc"])
    return "unknown key" if inner is None else f"unknown key (known: {', '.join(inner.model_fields)})"


def _of_model(model: type[BaseModel], error: ErrorDetails, table: str) -> str | None:
    """What a table of `Settings` (not imported here: pydantic's first model would slow the start of every
    verb) says of an unknown key."""
    if error["type"] != "extra_forbidden":
        return None
    said: str | None = getattr(_innermost(model, error["loc"]), table, {}).get(error["loc"][-1])
    return said


def _innermost(model: type[BaseModel], loc: Loc) -> type[BaseModel] | None:
    """The model that the last key of a place is asked of, where plain models lead to it."""
    for part in loc[:-1]:
        field = model.model_fields.get(str(part))
        inner: Any = None if field is None else field.annotation
        if not (isinstance(inner, type) and issubclass(inner, BaseModel)):
            return None
        model = inner
    return model


def _description(model: type[BaseModel], loc: Loc) -> str | None:
    """What the innermost key of a place is to hold, where the models say so."""
    field = model.model_fields.get(str(loc[0])) if loc else None
    inner: Any = None if field is None else field.annotation
    if isinstance(inner, type) and issubclass(inner, BaseModel):
        return _description(inner, loc[1:])
    return None if field is None else field.description


def load_model(model: type[Model], path: Path) -> Model:
    """A YAML file as the model."""
    return checked(model, read_mapping(path), where=str(path))


def config_text(config: BaseModel) -> str:
    """A resolved configuration as YAML: what is saved beside an output, and hashed."""
    return yaml.dump(config.model_dump(mode="json"), Dumper=DUMPER, sort_keys=False)


def find_named(name_or_path: str, folder: Path, kind: str) -> Path:
    """File of a built-in `kind` by name, or the file itself by path; InputError lists the known names."""
    if name_or_path.endswith((".yaml", ".yml")) or "/" in name_or_path:
        path = Path(name_or_path)
        if not path.is_file():
            raise InputError(f"{name_or_path}: no such {kind} file")
        return path
    path = folder / f"{name_or_path}.yaml"
    if not path.is_file():
        known = ", ".join([*known_names(folder), "a .yaml file"])
        raise InputError(f"unknown {kind} '{name_or_path}'; known: {known}")
    return path


def known_names(folder: Path) -> list[str]:
    """Names of the YAML files in a folder, sorted."""
    return sorted(path.stem for path in folder.glob("*.yaml"))
