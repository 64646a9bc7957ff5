"""The stamps of a topic or link: clocks that stand or go back, repeats and gaps."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from turtlebag.datasets.bags.plausibility import stands_still
from turtlebag.datasets.findings import Finding
from turtlebag.datasets.plurals import counted
from turtlebag.datasets.types import Stamps

_GAP_NS = 3e8
_GAP_STEPS = 5.0
"""A gap is as long as both: this time, and this many usual steps."""


def running(topic: str, stamps: ArrayLike, log_times: Stamps, findings: list[Finding]) -> Stamps:
    """The stamps (n,) [ns], or for a clock that never ran the times of recording."""
    times = np.asarray(stamps, dtype=np.int64)
    if stands_still(times):
        what = f"all {len(times)} stamps are {times[0] * 1e-9:g} s"
        useless = stands_still(log_times)
        remedy = "and so are the recording times" if useless else "the recording times are used instead"
        findings.append(Finding("no time", topic, what, len(times), int(log_times[0]), remedy))
        return times if useless else log_times
    return times


def check_order(topic: str, stamps: ArrayLike, log_times: Stamps, remedy: str = "") -> Iterator[Finding]:
    """Stamps (n,) [ns] that go back or repeat, and gaps; `remedy` is what is done when they go back."""
    times = np.asarray(stamps, dtype=np.int64)
    if stands_still(times):
        return
    steps = np.diff(times)
    back, again = np.flatnonzero(steps < 0), np.flatnonzero(steps == 0)
    if len(back):
        worst = float(steps.min()) * -1e-9
        what = f"stamps go back {counted(len(back), 'time')}, by up to {worst:.3f} s"
        first = int(log_times[back[0] + 1])
        yield Finding("time goes backwards", topic, what, len(back), first, remedy)
    elif len(again):
        what = f"{counted(len(again), 'message')} with the stamp of the one before"
        yield Finding("repeated stamps", topic, what, len(again), int(log_times[again[0] + 1]))
    yield from _gaps(topic, times, log_times)


def _gaps(topic: str, stamps: Stamps, log_times: Stamps) -> Iterator[Finding]:
    in_time, first = np.unique(stamps, return_index=True)
    steps = np.diff(in_time)
    if len(steps) < 3:
        return
    usual, longest = float(np.median(steps)), float(steps.max())
    limit = round(max(_GAP_STEPS * usual, _GAP_NS))
    gaps = np.flatnonzero(steps >= limit)
    if len(gaps):
        what = (
            f"{counted(len(gaps), 'gap')}, the longest {longest * 1e-9:.2f} s (usually {usual * 1e-9:.3f} s)"
        )
        yield Finding("gaps", topic, what, len(gaps), int(log_times[first[gaps[0]]]))
