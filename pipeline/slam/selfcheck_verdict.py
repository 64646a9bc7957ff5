"""The verdict of a self-check: good, or doubtful with reasons."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Literal


class Verdict(ABC):
    """Base of the self-checks; metrics.json shows the verdict before `numbers`."""

    reasons: tuple[str, ...]

    @property
    def verdict(self) -> Literal["good", "doubtful"]:
        """Good without a reason for doubt."""
        return "doubtful" if self.reasons else "good"

    @property
    @abstractmethod
    def numbers(self) -> dict[str, float]:
        """The measurements, by their names in metrics.json."""

    def as_metrics(self) -> dict[str, Any]:
        """The self-check's entry in metrics.json."""
        return {"verdict": self.verdict, "reasons": list(self.reasons), **self.numbers}
