"""Numba kernels with a cache that is keyed by everything the machine code depends on.

numba's own cache identifies a kernel only by its file: if an inlined kernel in another file changes,
the old code is still used. Here the key is a hash of the
kernel's own bytecode and options, of those of every kernel it calls, of the constants they read, of the
packages, the processor and the types of the arguments. So no kernel is stale, and only affected
kernels are compiled again.
"""

from __future__ import annotations

import os
import stat
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cached_property
from importlib.util import cache_from_source
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
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

from numba.core.caching import IndexDataCacheFile, _Cache
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.runtime import rtsys

from turtlebag.datasets.fingerprints import fingerprint

MADE_BY = [numba.__version__, llvmlite.__version__, np.__version__, sys.implementation.cache_tag]


def njit(*, cache: bool = False, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit`; with `cache` the compiled code is kept by all that it was made of."""

    def compiled(function: Callable[..., Any]) -> Any:
        kernel: Any = numba.njit(**options)(function)
        if cache and kernel is not function:  # NUMBA_DISABLE_JIT leaves the function as it is
            kernel._cache = KernelCache(kernel)
        return kernel

    return compiled


class KernelCache(_Cache):
    """The compiled forms of one kernel, one for each tuple of argument types, in files."""

    def __init__(self, kernel: Dispatcher) -> None:
        self._kernel, self._on = kernel, True

    @cached_property
    def key(self) -> str:
        """Hash of all that the kernel's code is made of; TypeError names what cannot be hashed.

        Asked for at the first use, when the modules that it reads are whole.
        """
        return fingerprint([MADE_BY, content(self._kernel, frozenset(), set())])

    @property
    def cache_path(self) -> str:
        """Where the code would be kept."""
        return str(next(folders()))

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The cached code for the argument types, or None."""
        # all that finished code needs; what a compiler needs takes longer to load than many kernels
        rtsys.initialize(target_context)
        for folder in folders() if self._on else ():
            file, wanted = self._file(folder), (sig, target_context.codegen().magic_tuple())
            try:
                kept = file.load(wanted)
                if kept is not None and kept[0] == (self.key, wanted):
                    return CompileResult._rebuild(target_context, *kept[1])
            except Exception:  # damaged, or the type of an argument stands in another module now
                with suppress(OSError):
                    file.flush()
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the code, if it may be used by another process; in the first folder that takes it."""
        if not self._on or data.library.has_dynamic_globals or any(not x.can_cache for x in data.lifted):
            return
        for folder in folders(make=True):
            with suppress(Exception):  # trouble with a folder never ends a run
                folder.mkdir(parents=True, exist_ok=True)
                made = sig, data.codegen.magic_tuple()
                # numba writes index and code apart: of processes that write at once, one's index may name
                # the other's code, which therefore says itself what it is of
                self._file(folder).save(made, ((self.key, made), data._reduce()))
                return

    def _file(self, folder: Path) -> IndexDataCacheFile:
        """Numba's own file of the code for each tuple of types, which counts as empty with another key."""
        kernel = self._kernel.py_func
        return IndexDataCacheFile(str(folder), f"{kernel.__module__}.{kernel.__qualname__}"[-120:], self.key)

    def enable(self) -> None:
        """Enable lookup and storage, which is the default."""
        self._on = True

    def disable(self) -> None:
        """Neither look up nor keep."""
        self._on = False

    def flush(self) -> None:
        """Nothing to do: a new key never has cached code."""


def folders(*, make: bool = False) -> Iterator[Path]:
    """Possible cache folders; the first writable one is used for writing.

    NUMBA_CACHE_DIR, where it is set; else beside Python's own bytecode of this package, in the user's
    cache folder, or for want of both below the temporary one, where `make` makes a folder of our own.
    """
    if place := os.environ.get("NUMBA_CACHE_DIR"):
        yield Path(place)
        return
    yield Path(cache_from_source(__file__)).parent / "kernels"
    user = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    if os.path.isabs(user):
        yield Path(user) / "turtlebag/kernels"
    ours = Path(tempfile.gettempdir()) / f"turtlebag-{os.getuid()}"
    with suppress(OSError):
        if make:
            ours.mkdir(mode=0o700, exist_ok=True)
        found = ours.lstat()
        # What is read from it is run: a folder that somebody else made or may write to is none.
        if stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o022:
            yield ours / "kernels"


def content(value: object, names: frozenset[str], seen: set[int]) -> object:
    """The value that `fingerprint` hashes for a constant of a kernel; TypeError if there is none.

    Of a module the attributes called `names` count. A function that is no kernel can only be one that
    numba itself knows: its name says all, with numba's version.
    """
    if isinstance(value, Dispatcher):
        return _of_kernel(value, seen)
    if isinstance(value, ModuleType):
        found = sorted(name for name in names if hasattr(value, name))
        return [value.__name__, {name: content(getattr(value, name), names - {name}, seen) for name in found}]
    if isinstance(value, CodeType):
        return _of_code(value, seen)
    if isinstance(value, (tuple, list)):
        return [type(value).__name__, *(content(item, names, seen) for item in value)]
    if isinstance(value, frozenset):
        return ["set", *sorted(fingerprint(content(item, names, seen)) for item in value)]
    if isinstance(value, (complex, np.generic, np.dtype, type(...), numba.types.Type)):
        return [type(value).__name__, repr(value)]
    if isinstance(value, (type, FunctionType, BuiltinFunctionType, np.ufunc)) or callable(value):
        return [getattr(value, "__module__", ""), getattr(value, "__qualname__", repr(value))]
    if value is None or isinstance(value, (bool, int, float, str, bytes, np.ndarray)):
        return value
    raise TypeError(f"a kernel cannot be kept that reads a {type(value).__name__}")


def _of_kernel(kernel: Dispatcher, seen: set[int]) -> object:
    function = kernel.py_func
    if id(function) in seen:
        return ["again", function.__qualname__]
    seen.add(id(function))
    options = {name: str(option) for name, option in sorted(kernel.targetoptions.items())}
    names = frozenset(_names(function.__code__))
    read = {name: function.__globals__[name] for name in sorted(names & function.__globals__.keys())}
    cells = [cell.cell_contents for cell in function.__closure__ or ()]
    return [
        function.__qualname__,
        options,
        _of_code(function.__code__, seen),
        content([function.__defaults__, list((function.__kwdefaults__ or {}).items()), cells], names, seen),
        {name: content(value, names, seen) for name, value in read.items()},
    ]


def _of_code(code: CodeType, seen: set[int]) -> object:
    """All of the bytecode but where it stands."""
    counts = [code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags]
    names = [code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars]
    return [
        code.co_code,
        counts,
        names,
        getattr(code, "co_exceptiontable", b""),  # Python 3.11 and later
        [content(constant, frozenset(), seen) for constant in code.co_consts],
    ]


def _names(code: CodeType) -> set[str]:
    """Global names and attributes that the code and the functions within it speak of."""
    inner = (constant for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*map(_names, inner))
