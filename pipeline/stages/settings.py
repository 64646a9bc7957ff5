"""Reading typed configuration: defaults, then a YAML file, then `--set key=value`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.yaml_files import checked, parsed, read_mapping

Model = TypeVar("Model", bound=BaseModel)


def load_config(model: type[Model], path: Path | None = None, settings: Sequence[str] = ()) -> Model:
    """The model filled from `path` (YAML) and `settings` ("a.b=value"); InputError names the bad key."""
    data = read_mapping(path) if path is not None else {}
    for setting in settings:
        _apply(data, setting)
    return checked(model, data, where=str(path) if path is not None else "--set")


def _apply(data: dict[str, Any], setting: str) -> None:
    key, equals, text = setting.partition("=")
    if not equals or not key:
        raise InputError(f"--set {setting}: expected key=value")
    value = parsed(text, where=f"--set {key}")
    *parents, last = key.split(".")
    node = data
    for parent in parents:
        child = node.setdefault(parent, {})
        if not isinstance(child, dict):
            raise InputError(f"--set {setting}: {parent} holds no keys")
        node = child
    node[last] = value
