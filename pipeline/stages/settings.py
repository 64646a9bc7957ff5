"""Reading typed configuration: defaults, then a YAML file, then single settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.yaml_files import checked, read_mapping
from turtlebag.pipeline.stages.requests.options import chosen_settings

Model = TypeVar("Model", bound=BaseModel)
Chosen = Mapping[str, Any] | Sequence[str]
"""Single settings by their dotted names, or as `a.b=value`."""


def load_config(model: type[Model], path: Path | None = None, settings: Chosen = ()) -> Model:
    """The model filled from `path` (YAML) and single settings; InputError names the bad key."""
    data = read_mapping(path) if path is not None else {}
    for key, value in chosen_settings(settings).items():
        _apply(data, key, value)
    return checked(model, data, where=str(path) if path is not None else "--set")


def _apply(data: dict[str, Any], key: str, value: Any) -> None:
    *parents, last = key.split(".")
    node = data
    for parent in parents:
        child = node.setdefault(parent, {})
        if not isinstance(child, dict):
            raise InputError(f"--set {key}: {parent} holds no keys")
        node = child
    node[last] = value
