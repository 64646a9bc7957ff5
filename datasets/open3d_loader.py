"""Imports Open3D on machines without libusb, and on one thread for reproducible results.

The open3d-cpu wheel links `libusb-1.0.so.0`, which a fresh machine lacks; the package `libusb-package`
carries it. Loading that copy first, with its symbols made global, satisfies the wheel.

Its figures in a browser need dash and 34 more packages, 116 MB, and nothing of ours draws any: make's
environment is without them, and where they are missing a module without figures takes the place of Open3D's.

Its point-to-plane ICP adds up in whatever order its threads finish: the last bits vary, and where a match is
poor they grow to another pose. On one thread there is one order.
"""

from __future__ import annotations

import ctypes
import sys
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

from turtlebag.datasets.errors import InputError

# The module of figures, and what Open3D imports of it.
FIGURES = ModuleType("open3d.visualization.draw_plotly")
FIGURES.__dict__.update(get_plotly_fig=None, draw_plotly=None, draw_plotly_server=None)


@cache
def open3d() -> ModuleType:
    """The `open3d` module, limited to one thread; InputError if it cannot be imported."""
    try:
        import libusb_package

        library = libusb_package.get_library_path()
        if library is not None:
            ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
        if find_spec("dash") is None:
            sys.modules[FIGURES.__name__] = FIGURES
        import open3d as module

        _keep_to_one_thread(module)
    except (ImportError, OSError, AttributeError) as error:
        raise InputError(f"open3d cannot be imported ({' '.join(str(error).split())})") from None
    module.utility.set_verbosity_level(module.utility.VerbosityLevel.Error)
    return module


class _GlobalControl(ctypes.Structure):
    """tbb::global_control: a parameter of the scheduler and the value it has while this exists."""

    _fields_ = (("value", ctypes.c_size_t), ("reserved", ctypes.c_ssize_t), ("parameter", ctypes.c_int))


_ONE_THREAD = _GlobalControl(value=1)  # of parameter 0, max_allowed_parallelism


def _keep_to_one_thread(module: ModuleType) -> None:
    """Ask the scheduler that comes with Open3D for no threads but the caller's."""
    name = "libtbb.12.dylib" if sys.platform == "darwin" else "libtbb.so.12"
    tbb = ctypes.CDLL(str(Path(str(module.__file__)).with_name(name)))
    tbb["_ZN3tbb6detail2r16createERNS0_2d114global_controlE"](ctypes.byref(_ONE_THREAD))
