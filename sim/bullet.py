"""Bullet's Python module, loaded without the line it prints at import."""

from __future__ import annotations

import os
import sys


def _load_quietly() -> None:
    sys.stdout.flush()
    kept = os.dup(1), os.dup(2)
    sink = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(sink, 1)
        os.dup2(sink, 2)
        import pybullet  # noqa: F401
    finally:
        os.dup2(kept[0], 1)
        os.dup2(kept[1], 2)
        for descriptor in (*kept, sink):
            os.close(descriptor)


_load_quietly()
import pybullet as bullet  # noqa: E402

__all__ = ["bullet"]
