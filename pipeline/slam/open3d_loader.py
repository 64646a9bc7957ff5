"""Importing Open3D on a machine without libusb.

The open3d-cpu wheel links `libusb-1.0.so.0`, which a fresh machine lacks; the package `libusb-package`
carries it. Loading that copy first, with its symbols made global, satisfies the wheel.
"""

from __future__ import annotations

import ctypes
from functools import cache
from types import ModuleType

from datasets.errors import InputError


@cache
def open3d() -> ModuleType:
    """The imported `open3d` module; InputError says what is missing."""
    import libusb_package

    library = libusb_package.get_library_path()
    try:
        if library is not None:
            ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
        import open3d as module
    except (ImportError, OSError) as error:
        raise InputError(f"open3d cannot be imported ({' '.join(str(error).split())})") from None
    module.utility.set_verbosity_level(module.utility.VerbosityLevel.Error)
    return module
