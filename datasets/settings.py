"""What all settings are made of."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Settings(BaseModel):
    """Values that do not change, under names of which none may be misspelt."""

    model_config = ConfigDict(extra="forbid", frozen=True)
