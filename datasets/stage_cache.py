"""Results of stages kept by what made them, so that a run with one changed setting redoes only the rest.

An entry's name is the sha256 of the stage, of everything that went in (the recording's content, the
settings the stage reads, the entries before it), of our own sources, the package versions and the
processor. The least recently used go when the folder grows beyond its limit.
"""

from __future__ import annotations

import io
import os
import pickle
import platform
import re
from collections.abc import Callable, Sequence
from dataclasses import is_dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from llvmlite.binding import get_host_cpu_name

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.fingerprints import fingerprint
from turtlebag.datasets.kept import read_kept, trim_kept, user_cache, write_kept
from turtlebag.datasets.outputs import package_versions

Value = TypeVar("Value")
PLACE_VARIABLE = "TURTLEBAG_STAGE_CACHE"
"""Folder of the cache, or `off`."""
LIMIT_VARIABLE = "TURTLEBAG_STAGE_CACHE_MB"
LIMIT_MB = 1024
LIMIT_ENTRIES = 4000
SMALL = 4096
ENTRY_NAME = re.compile(r"[0-9a-f]{64}")
SOURCES = ("datasets", "pipeline/slam")
"""Whose code shapes the entries; changing any file of it makes all of them anew."""
ROOT = Path(__file__).parents[1]


class StageCache:
    """Results on disk, or with no folder nothing at all: then every stage is made."""

    def __init__(self, folder: Path | None = None, limit_mb: int = LIMIT_MB) -> None:
        self._folder, self._limit = folder, limit_mb * 1_000_000
        self._record: list[tuple[str, bool]] = []

    @property
    def on(self) -> bool:
        """Whether anything is looked up or kept."""
        return self._folder is not None

    def step(self, stage: str, inputs: Sequence[object], make: Callable[[], Value]) -> tuple[Value, str]:
        """What `make` gives, from the cache where it is, and its key for the stages that build on it.

        `inputs` are all that the result depends on: arrays, settings, dataclasses of them, other keys.
        """
        if self._folder is None:
            return make(), ""
        key = fingerprint([stage, surroundings(), *inputs])
        path = self._folder / key
        found = _read(path)
        self._record.append((stage, found is not None))
        if found is not None:
            return found[0], key
        value = make()
        self._keep(path, value)
        return value, key

    def _keep(self, path: Path, value: object) -> None:
        written = io.BytesIO()
        _Writer(written, protocol=5).dump((value,))
        payload = written.getvalue()
        if len(payload) <= self._limit:
            write_kept(path, payload)

    def trim(self) -> None:
        """Remove the least recently used entries, and what killed processes left, beyond the limits."""
        if self._folder is not None:
            trim_kept(self._folder, ENTRY_NAME, self._limit, LIMIT_ENTRIES)

    @property
    def found(self) -> list[str]:
        """Stages that came from the cache, each once, in the order of use."""
        return list(dict.fromkeys(stage for stage, hit in self._record if hit))

    @property
    def made(self) -> list[str]:
        """Stages that were made."""
        return list(dict.fromkeys(stage for stage, hit in self._record if not hit))


def default_cache() -> StageCache:
    """The cache where the user would look for it.

    TURTLEBAG_STAGE_CACHE names the folder, or is `off`. Otherwise it is `data/cache` when working in
    the project's own folder, where all that is built goes, and the user's cache folder elsewhere.
    """
    place, limit = os.environ.get(PLACE_VARIABLE, ""), os.environ.get(LIMIT_VARIABLE, str(LIMIT_MB))
    if place == "off":
        return StageCache()
    if not limit.isdecimal() or len(limit) > 15:
        raise InputError(f"{LIMIT_VARIABLE}={limit}: expected a whole number of megabytes")
    return StageCache(Path(place) if place else _usual_folder(), int(limit))


def _usual_folder() -> Path | None:
    if (ROOT / "Makefile").is_file() and Path.cwd().is_relative_to(ROOT):
        return ROOT / "data" / "cache"
    user = user_cache()
    return user / "stages" if user else None


def _read(path: Path) -> tuple[Any] | None:
    """An entry's value as a tuple of one; None when there is none, or it is not what was written."""
    payload = read_kept(path)
    if payload is None:
        return None
    try:
        value = _Entry(io.BytesIO(payload)).load()
    except pickle.UnpicklingError:
        return None
    return value if isinstance(value, tuple) and len(value) == 1 else None


class _Writer(pickle.Pickler):
    """Writes small arrays, of which graphs have thousands, in half of NumPy's own time."""

    def reducer_override(self, value: Any) -> Any:
        if (
            type(value) is np.ndarray
            and value.nbytes < SMALL
            and value.flags.c_contiguous
            and value.dtype != object
        ):
            return np.ndarray, (value.shape, value.dtype, bytearray(value.data))
        return NotImplemented


class _Entry(pickle.Unpickler):
    """Reads arrays and our own dataclasses, and nothing that could do more than hold them."""

    def find_class(self, module: str, name: str) -> Any:
        if module.split(".")[0] == "numpy" and name in (
            "ndarray",
            "dtype",
            "_reconstruct",
            "_frombuffer",
            "scalar",
        ):
            return super().find_class(module, name)
        if module.split(".")[0] == "turtlebag" and name.isidentifier():
            found = super().find_class(module, name)
            if isinstance(found, type) and is_dataclass(found):
                return found
        raise pickle.UnpicklingError(f"{module}.{name} has no place in an entry")


@cache
def surroundings(sources: tuple[str, ...] = SOURCES) -> str:
    """Fingerprint of our sources, the packages and the machine: what shapes results besides the input.

    `sources` are folders of the project whose Python and YAML files count.
    """
    files = sorted(
        path
        for folder in sources
        for path in (ROOT / folder).rglob("*")
        if path.suffix in (".py", ".yaml") and path.is_file()
    )
    read = [(path.relative_to(ROOT).as_posix(), path.read_bytes()) for path in files]
    machine = [platform.python_version(), platform.machine(), get_host_cpu_name()]
    return fingerprint([read, package_versions(), machine])
