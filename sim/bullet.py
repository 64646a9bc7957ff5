"""Bullet's functions and constants, `bullet.connect` and so on, loaded when the first one is used.

Worlds, robots and settings are needed where there is no Bullet, which prints a line when it is imported.
"""

from __future__ import annotations

import os
import sys
from functools import cache
from types import ModuleType
from typing import Any, cast


def __getattr__(name: str) -> Any:
    """ImportError where Bullet is not installed."""
    if name.startswith("__"):  # asked for by the import system
        raise AttributeError(name)
    return getattr(_loaded_quietly(), name)


@cache
def _loaded_quietly() -> ModuleType:
    sys.stdout.flush()
    kept = os.dup(1), os.dup(2)
    sink = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(sink, 1)
        os.dup2(sink, 2)
        import pybullet
    finally:
        os.dup2(kept[0], 1)
        os.dup2(kept[1], 2)
        for descriptor in (*kept, sink):
            os.close(descriptor)
    return cast(ModuleType, pybullet)
