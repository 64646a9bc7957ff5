"""Imports Open3D on machines without libusb, and on one thread for reproducible results.

The open3d-cpu wheel links `libusb-1.0.so.0`, which a fresh machine lacks; the package `libusb-package`
carries it. Loading that copy first, with its symbols made global, satisfies the wheel.

Its plots for notebooks import dash, plotly and flask, half a second and 40 MB: they do so when one is drawn.

Its point-to-plane ICP adds up in whatever order its threads finish: the last bits vary, and where a match is
poor they grow to another pose. On one thread there is one order.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from turtlebag.datasets.errors import InputError


@cache
def open3d() -> ModuleType:
    """The `open3d` module, limited to one thread; InputError if it cannot be imported."""
    import libusb_package

    library = libusb_package.get_library_path()
    try:
        if library is not None:
            ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
        _plots_when_asked()
        import open3d as module

        _keep_to_one_thread(module)
    except (ImportError, OSError, AttributeError) as error:
        raise InputError(f"open3d cannot be imported ({' '.join(str(error).split())})") from None
    module.utility.set_verbosity_level(module.utility.VerbosityLevel.Error)
    return module


PLOTS = "open3d.visualization.draw_plotly"


def _plots_when_asked() -> None:
    """Put off the import of Open3D's plots to the first one, unless it was imported before."""
    if "open3d" in sys.modules:
        return
    stand_in = ModuleType(PLOTS)
    for name in ("get_plotly_fig", "draw_plotly", "draw_plotly_server"):
        setattr(stand_in, name, _when_asked(name))
    sys.modules[PLOTS] = stand_in


def _when_asked(name: str) -> Callable[..., Any]:
    def plot(*args: Any, **options: Any) -> Any:
        if not hasattr(sys.modules[PLOTS], "__file__"):
            del sys.modules[PLOTS]
        return getattr(import_module(PLOTS), name)(*args, **options)

    return plot


class _GlobalControl(ctypes.Structure):
    """tbb::global_control: a parameter of the scheduler and the value it has while this exists."""

    _fields_ = (("value", ctypes.c_size_t), ("reserved", ctypes.c_ssize_t), ("parameter", ctypes.c_int))


_ONE_THREAD = _GlobalControl(value=1)  # of parameter 0, max_allowed_parallelism


def _keep_to_one_thread(module: ModuleType) -> None:
    """Ask the scheduler that comes with Open3D for no threads but the caller's."""
    tbb = ctypes.CDLL(str(Path(str(module.__file__)).with_name("libtbb.so.12")))
    tbb["_ZN3tbb6detail2r16createERNS0_2d114global_controlE"](ctypes.byref(_ONE_THREAD))
