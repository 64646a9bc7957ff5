"""Numba kernels, compiled once and kept in a folder that is named by all that they are made of.

numba's own cache takes a kernel for fresh as long as its own file is, though a kernel of another file may be
inlined in it. Here the folder's name is a hash of every source with kernels and of all modules that those
import: nothing in it is ever stale, and where one of those sources is edited, all is compiled again.
"""

from __future__ import annotations

import hashlib
import logging
import os
import re
import shutil
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import llvmlite
import numpy as np

from turtlebag.datasets.errors import InputError

with warnings.catch_warnings():
    # Of a variable that it cannot parse it would warn in ten lines and go on without.
    warnings.filterwarnings("error", "Environment variable", RuntimeWarning)
    try:
        import numba
    except (RuntimeWarning, ValueError) as error:
        reason = str(error).partition("\n")[0]
        raise InputError(f"numba: {reason} (set by a variable NUMBA_* of the environment)") from None

from numba.core.caching import FunctionCache

ROOMS = ("datasets", "pipeline", "planners", "reports", "sim")
IMPORT = re.compile(rb"^from turtlebag\.([\w.]+) import", re.M)
MOST_FOLDERS = 16
"""Folders of other sources and versions that stay: those used last."""


def njit(*, cache: bool = False, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit`; with `cache` the compiled code is kept."""

    def compiled(function: Callable[..., Any]) -> Any:
        kernel: Any = numba.njit(**options)(function)
        if cache and kernel is not function:  # NUMBA_DISABLE_JIT leaves the function as it is
            kernel._cache = KeptKernel(function)
        return kernel

    return compiled


class KeptKernel:
    """numba's cache of one kernel, made when that is first called; trouble with it never ends a command."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    @cached_property
    def _numbas(self) -> Any:
        """None where nothing can be kept: numba would then look for a place where code can be stale."""
        config: Any = numba.config
        place, before = folder(), config.CACHE_DIR
        if place is None:
            return None
        config.CACHE_DIR = str(place)  # read only while the cache is made; a user's kernels have theirs
        try:
            made = FunctionCache(self._function)
        except (RuntimeError, OSError):
            return None
        finally:
            config.CACHE_DIR = before
        return made if Path(made.cache_path).is_relative_to(place) else None

    @property
    def cache_path(self) -> str:
        """The folder of the kernel's file, empty where nothing is kept."""
        return "" if self._numbas is None else str(self._numbas.cache_path)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The code for the argument types, or None."""
        if self._numbas is None:
            return None
        try:
            kept = self._numbas.load_overload(sig, target_context)
        except Exception:  # damaged, or the type of an argument stands in another module now
            with suppress(Exception):
                self._numbas.flush()
            return None
        # Of two processes that write at once, one's index may name the other's code.
        return kept if kept is not None and tuple(kept.signature.args) == tuple(sig) else None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the code."""
        if self._numbas is not None:
            with suppress(Exception):
                self._numbas.save_overload(sig, data)


@cache
def folder() -> Path | None:
    """Where compiled kernels are kept, in NUMBA_CACHE_DIR where that is set, else in the user's cache folder;
    None, with a note, where nothing can be written."""
    user = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "turtlebag")
    place = Path(os.environ.get("NUMBA_CACHE_DIR") or user, "kernels")
    found = place.absolute() / _sources()
    try:
        if not found.is_dir():
            found.mkdir(parents=True)
            logging.getLogger("turtlebag").info(
                "note: compiling kernels (up to a minute, once); turtlebag doctor --trial compiles all"
            )
            for old in sorted(place.iterdir(), key=lambda path: path.stat().st_mtime)[:-MOST_FOLDERS]:
                shutil.rmtree(old, ignore_errors=True)
        os.utime(found)
    except OSError as error:
        if not found.is_dir():
            how = "set NUMBA_CACHE_DIR to a folder that can be written, or every command compiles them again"
            logging.getLogger("turtlebag").warning(
                "note: %s: %s: kernels are not kept; %s", place, error.strerror, how
            )
            return None
    return found


def _sources() -> str:
    """Hash of every source with kernels, of all that those import, and of the packages."""
    root, texts = Path(__file__).parents[1], dict[str, bytes]()
    for room in ROOMS:
        for place, _, files in os.walk(root / room):  # half the time of rglob
            module = os.path.relpath(place, root).replace(os.sep, ".")
            for file in files:
                if file.endswith(".py"):
                    texts[f"{module}.{file[:-3]}"] = Path(place, file).read_bytes()
    found, ahead = set[str](), [name for name, text in texts.items() if b"@njit" in text]
    while ahead:
        if (name := ahead.pop()) in texts and name not in found:
            found.add(name)
            ahead += [module.decode() for module in IMPORT.findall(texts[name])]
    versions = [numba.__version__, llvmlite.__version__, np.__version__, sys.implementation.cache_tag]
    content = [hashlib.sha256(texts[name]).digest() for name in sorted(found)]
    return hashlib.sha256(b"".join([*content, str(versions).encode()])).hexdigest()[:32]
