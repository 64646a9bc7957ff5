"""Reading typed configuration: defaults, then a YAML file, then `--set key=value`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from datasets.errors import InputError

Model = TypeVar("Model", bound=BaseModel)


def load_config(model: type[Model], path: Path | None = None, settings: Sequence[str] = ()) -> Model:
    """The model filled from `path` (YAML) and `settings` ("a.b=value"); InputError names the bad key."""
    data = read_yaml(path) if path is not None else {}
    for setting in settings:
        _apply(data, setting)
    return validated(model, data, where=str(path) if path is not None else "--set")


def read_yaml(path: Path) -> dict[str, Any]:
    """A YAML file that holds a mapping; InputError says what else it is."""
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        data = yaml.safe_load(path.read_text())
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f", line {mark.line + 1}" if mark is not None else ""
        raise InputError(f"{path}{line}: not valid YAML") from None
    except (OSError, UnicodeDecodeError):
        raise InputError(f"{path}: cannot be read as text") from None
    if data is None:
        return {}
    if not isinstance(data, dict):
        raise InputError(f"{path}: expected keys and values, found a {type(data).__name__}")
    return data


def validated(model: type[Model], data: Any, *, where: str) -> Model:
    """`data` as the model, or an InputError with the first wrong key."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "top level"
        what = "unknown key" if first["type"] == "extra_forbidden" else first["msg"]
        raise InputError(f"{where}: {key}: {' '.join(what.split())}") from None


def config_text(config: BaseModel) -> str:
    """The resolved configuration as YAML: what is saved beside an output, and hashed."""
    return yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)


def _apply(data: dict[str, Any], setting: str) -> None:
    key, equals, text = setting.partition("=")
    if not equals or not key:
        raise InputError(f"--set {setting}: expected key=value")
    try:
        value = yaml.safe_load(text)
    except yaml.YAMLError:
        raise InputError(f"--set {setting}: the value is not valid YAML") from None
    *parents, last = key.split(".")
    node = data
    for parent in parents:
        child = node.setdefault(parent, {})
        if not isinstance(child, dict):
            raise InputError(f"--set {setting}: {parent} holds no keys")
        node = child
    node[last] = value
