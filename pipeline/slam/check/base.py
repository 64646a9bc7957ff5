"""The verdict of a self-check: good, or doubtful with reasons."""

from __future__ import annotations

from typing import Any, Literal


class Verdict:
    """Base of the self-checks, whose numbers are in metrics.json by their names."""

    reasons: tuple[str, ...]

    @property
    def verdict(self) -> Literal["good", "doubtful"]:
        """Good without a reason for doubt."""
        return "doubtful" if self.reasons else "good"

    def as_metrics(self) -> dict[str, Any]:
        """The self-check's entry in metrics.json."""
        numbers = {name: value for name, value in vars(self).items() if isinstance(value, int | float)}
        return {"verdict": self.verdict, "reasons": list(self.reasons), **numbers}
