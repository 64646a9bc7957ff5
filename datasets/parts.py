"""User-defined parts: a class `module:Class`, wherever the name of one of our parts is accepted.

A `Protocol` is the contract of a part: its methods with their parameters, also `__init__` if
the part takes arguments. The module is found as `python -m` finds one, in the current folder first.
"""

from __future__ import annotations

import importlib
import inspect
import re
import sys
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BeforeValidator
from pydantic_core import PydanticCustomError

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.files import Signature, signatures

_OWN = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_][\w.]*")


class _Source(NamedTuple):
    """A class that was found, the file that it is written in, and how that file was then."""

    part: type
    file: Path
    signature: dict[Path, Signature]


_found: dict[str, _Source] = {}
"""By the names of the parts: what a manifest names, and where an error came up."""


def is_own(name: str) -> bool:
    """Whether it names a class of the user's."""
    return _OWN.fullmatch(name) is not None


def part_of(*ours: str) -> BeforeValidator:
    """Of a setting that names a part, as `Annotated[str, part_of("lines")]`: ours or `module:Class`.

    The class is not looked for yet: settings can be read where it is not.
    """

    def known(name: object) -> str:
        if isinstance(name, str) and (name in ours or is_own(name)):
            return name
        said = "expected {ours} or your own class (module:Class), not {name}"
        raise PydanticCustomError("part", said, {"name": repr(name), "ours": ", ".join(ours)})

    return BeforeValidator(known)


def chosen(name: str, ours: Mapping[str, Callable[..., Any]], contract: type) -> Any:
    """What a setting names: one of ours, or a class of the user's, as in `find`."""
    return ours[name] if name in ours else find(name, contract)


def find(name: str, contract: type) -> type:
    """The class `module:Class`, which has all that the contract, a Protocol, asks for.

    InputError in one line when the module cannot be imported, has no such class, or the class lacks a method
    or takes other parameters.
    """
    if not is_own(name):
        raise InputError(f"{name}: give a class of your own as module:Class")
    module_name, _, qualname = name.partition(":")
    module = _imported(module_name, name)
    found = _attribute(module, qualname)
    if not inspect.isclass(found):
        raise InputError(f"{name}: {_place(module)} has no class {qualname}{_classes_of(module)}")
    require(found, contract, name)
    file = getattr(sys.modules.get(found.__module__), "__file__", None)
    if file is not None and (name not in _found or _found[name].part is not found):
        _found[name] = _Source(found, Path(file), signatures(Path(file)))
    return found


def require(part: type, contract: type, name: str | None = None) -> None:
    """InputError unless the class has the methods of the contract, and they take what its methods take."""
    for method in _methods(contract):
        _require_method(part, method, contract, name or _label(part))


def name_of(part: type) -> str:
    """`module:Class` of a class; InputError when that does not lead back to it."""
    name = _label(part)
    if _attribute(sys.modules.get(part.__module__), part.__qualname__) is not part:
        raise InputError(
            f"{name}: the class cannot be imported by this name: define it at the top level of a module"
        )
    return name


def source_files(names: Mapping[str, str | None]) -> dict[str, Path]:
    """The files that parts of the user's own are written in, for a manifest's inputs.

    `names` are parts by what they are (`front_end`); ours have none, nor has a class typed in a notebook.
    InputError when a file is no longer the one that was imported.
    """
    files: dict[str, Path] = {}
    for kind, name in names.items():
        if name is not None and name in _found:
            _, file, before = _found[name]
            if signatures(file) != before:
                raise InputError(f"{name}: {file} has changed since it was imported; run the command again")
            files[kind] = _from_here(file)
    return files


def place_of(error: BaseException) -> str | None:
    """An exception from within a user's part in one line, with its place in the code; None for any other."""
    files = {source.file for source in _found.values()}
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if Path(frame.filename) in files:
            return f"{_from_here(Path(frame.filename))}, line {frame.lineno}, in {frame.name}: {_said(error)}"
    return None


def _from_here(file: Path) -> Path:
    """A file as seen from the current folder, if it lies below."""
    return file.relative_to(Path.cwd()) if file.is_relative_to(Path.cwd()) else file


def _label(part: type) -> str:
    return f"{part.__module__}:{part.__qualname__}"


def _imported(module: str, name: str) -> Any:
    if module not in sys.modules and str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module}.".startswith(f"{error.name}."):
            raise InputError(f"{name}: {module} cannot be imported: {_said(error)}") from error
        raise InputError(
            f"{name}: no module {error.name} in this folder or among the installed packages"
        ) from None
    except (Exception, SystemExit) as error:
        raise InputError(f"{name}: {module} cannot be imported: {_said(error)}") from error


def _said(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split()).removesuffix(":")


def _attribute(module: Any, qualname: str) -> Any:
    found = module
    for part in qualname.split("."):
        found = getattr(found, part, None)
    return found


def _place(module: Any) -> str:
    file = getattr(module, "__file__", None)
    return module.__name__ if file is None else f"{module.__name__} ({_from_here(Path(file))})"


def _classes_of(module: Any) -> str:
    """What classes are written in a module, for one who mistyped."""
    written = [key for key, value in vars(module).items() if inspect.isclass(value)]
    own = [key for key in written if vars(module)[key].__module__ == module.__name__]
    return f"; it has {', '.join(own)}" if own else ""


def _methods(contract: type) -> list[str]:
    """Names of the methods that a Protocol asks for; `__init__` where it says so itself."""
    return [
        key
        for key, value in vars(contract).items()
        if inspect.isfunction(value)
        and (not key.startswith("_") or (key == "__init__" and value.__module__ == contract.__module__))
    ]


def _require_method(part: type, method: str, contract: type, name: str) -> None:
    """InputError unless the method can be called with what the contract's takes."""
    _, *asked = inspect.signature(getattr(contract, method)).parameters.values()
    made = method == "__init__"
    given = part if made else getattr(part, method, None)
    text = f"{contract.__name__}{'' if made else '.' + method}({', '.join(p.name for p in asked)})"
    if not callable(given):
        raise InputError(f"{name}: has no method {method}; the contract is {text}")
    try:
        signature = inspect.signature(given)
    except ValueError:  # of compiled code
        return
    unbound = not made and inspect.isfunction(inspect.getattr_static(part, method))
    positional = [p for p in asked if p.kind is not p.KEYWORD_ONLY]
    keywords = [p.name for p in asked if p.kind is p.KEYWORD_ONLY]
    try:
        signature.bind(*([None] if unbound else []), *positional, **dict.fromkeys(keywords))
    except TypeError:
        raise InputError(
            f"{name}: {'is made with' if made else method} {signature}; the contract is {text}"
        ) from None
