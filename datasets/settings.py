"""The base class of all settings."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field, model_validator

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


BRITISH = {
    r"centre": "center",
    r"colour": "color",
    r"metre": "meter",
    r"grey": "gray",
    r"(behavi|neighb)our": r"\1or",
    r"(locali|initiali|optimi|normali|rasteri)s(e|ation|ing)": r"\1z\2",
}
"""What British spelling has in the words of our keys, as patterns, and the American for it."""


def american(key: str) -> str:
    """A key in American spelling."""
    for british, spelling in BRITISH.items():
        key = re.sub(british, spelling, key)
    return key


class Settings(BaseModel):
    """Base of all settings: immutable, and unknown keys are errors. Keys may be spelled as the British or as
    the Americans do."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)
    RENAMED: ClassVar[Mapping[str, str]] = {}
    """Present names of keys by their former ones, for the error that a former one is."""
    REMOVED: ClassVar[Mapping[str, str]] = {}
    """Keys that earlier versions had, and what to say of each: a file may still have them (see `checked`)."""

    @model_validator(mode="before")
    @classmethod
    def _either_spelling(cls, data: Any) -> Any:
        """The data with keys in the other spelling under their own names."""
        if not isinstance(data, Mapping) or all(key in cls.model_fields for key in data):
            return data
        own = {american(name): name for name in cls.model_fields}
        names = {key: own.get(american(key), key) for key in data if isinstance(key, str)}
        if any(names[key] != key and names[key] in data for key in names):
            return data  # both spellings: the other one is an unknown key
        return {names.get(key, key): value for key, value in data.items()}
