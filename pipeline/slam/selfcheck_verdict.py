"""The verdict of a self-check: good, or doubtful with reasons."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any


class Verdict(ABC):
    """Base of the self-checks; metrics.json shows the verdict before `numbers`."""

    reasons: tuple[str, ...]

    @property
    def good(self) -> bool:
        """Whether there is no reason for doubt."""
        return not self.reasons

    @property
    @abstractmethod
    def numbers(self) -> dict[str, Any]:
        """The measurements, by their names in metrics.json."""

    def as_metrics(self) -> dict[str, Any]:
        """The self-check's entry in metrics.json."""
        return {
            "verdict": "good" if self.good else "doubtful",
            "reasons": list(self.reasons),
            **self.numbers,
        }
