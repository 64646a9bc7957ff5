"""Reading typed configuration: defaults, then a YAML file, then single settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.yaml_files import checked, read_mapping
from turtlebag.pipeline.stages.requests.options import chosen_settings

Model = TypeVar("Model", bound=BaseModel)
ConfigSource = Path | Mapping[str, Any] | None
"""A YAML file of settings, or what one says."""
Chosen = Mapping[str, Any] | Sequence[str]
"""Single settings by their dotted names, or as `a.b=value`."""


def settings_of(source: ConfigSource) -> dict[str, Any]:
    """What a file of settings says; empty without one."""
    return read_mapping(source) if isinstance(source, Path) else deepcopy(dict(source or {}))


def load_config(model: type[Model], source: ConfigSource = None, settings: Chosen = ()) -> Model:
    """The model filled from a YAML file and single settings; InputError names the bad key."""
    data = settings_of(source)
    for key, value in chosen_settings(settings).items():
        _apply(data, key, value)
    return checked(model, data, where=str(source) if isinstance(source, Path) else "--set")


def _apply(data: dict[str, Any], key: str, value: Any) -> None:
    *parents, last = key.split(".")
    node = data
    for parent in parents:
        child = node.setdefault(parent, {})
        if not isinstance(child, dict):
            raise InputError(f"--set {key}: {parent} holds no keys")
        node = child
    node[last] = value
