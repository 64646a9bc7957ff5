"""The verdict of a self-check: good, or doubtful with reasons."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any


class Verdict(ABC):
    """Base of the self-checks; metrics.json shows the verdict before `numbers`."""

    reasons: tuple[str, ...]

    @property
    def good(self) -> bool:
        """Nothing was found wrong."""
        return not self.reasons

    @property
    @abstractmethod
    def numbers(self) -> dict[str, Any]:
        """What was measured, by its name in metrics.json."""

    def as_metrics(self) -> dict[str, Any]:
        """What metrics.json says of it."""
        return {
            "verdict": "good" if self.good else "doubtful",
            "reasons": list(self.reasons),
            **self.numbers,
        }
