"""What a method of a part must return, in the words of its contract."""

from __future__ import annotations

import inspect
from types import UnionType

import numpy as np

from turtlebag.datasets.plurals import one
from turtlebag.datasets.types import Twist

Asked = type | UnionType | tuple[int, ...]
"""A type, or the shape of a finite array, () for a number."""
BOOL, INT = bool | np.bool_, int | np.integer


def broken(part: object, text: str) -> AssertionError:
    """What a check raises: which part, and what the contract asks."""
    kind = part if inspect.isclass(part) else type(part)
    return AssertionError(f"{kind.__module__}:{kind.__qualname__}: {text}")


def require_answer(part: object, method: str, answer: object, kind: type, **attributes: Asked) -> None:
    """AssertionError unless a method returned a `kind` with these attributes."""
    if not isinstance(answer, kind):
        raise broken(part, f"{method}: must return {one(kind.__name__)}, not {_kind_of(answer)}")
    require_attributes(part, method, answer, **attributes)


def require_attributes(part: object, method: str, owner: object, **attributes: Asked) -> None:
    """AssertionError unless these attributes of `owner` are what is asked."""
    for name, asked in attributes.items():
        require_value(part, f"{method}: {name}", getattr(owner, name), asked)


def require_value(part: object, what: str, value: object, asked: Asked) -> None:
    """AssertionError unless a value is what is asked."""
    if not isinstance(asked, tuple):
        if not isinstance(value, asked):
            kind = asked.__args__[0] if isinstance(asked, UnionType) else asked
            raise broken(part, f"{what} must be {one(kind.__name__)}, not {_kind_of(value)}")
        return
    numbers = np.asarray(value) if isinstance(value, np.ndarray | np.number | float | int) else None
    if numbers is None or numbers.shape != asked or numbers.dtype.kind not in "fiu":
        shape = f"an array of shape {asked}" if asked else "a number"
        raise broken(part, f"{what} must be {shape}, not {_kind_of(value)}")
    if not np.isfinite(numbers).all():
        raise broken(part, f"{what} is not finite")


def _kind_of(value: object) -> str:
    """What a value is, in a few words."""
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape}"
    return "None" if value is None else one(type(value).__name__)


def require_twist(part: object, method: str, command: object) -> None:
    """AssertionError unless a method returned a command, finite."""
    require_answer(part, method, command, Twist, v=(), w=())
