"""How far a campaign is: a page in its store, written anew while it runs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from turtlebag.datasets.outputs import Stopwatch
from turtlebag.datasets.urls import reason_of
from turtlebag.pipeline.campaign.campaign_file import Campaign
from turtlebag.pipeline.campaign.case import Row, Where, kept_at
from turtlebag.pipeline.campaign.cases import Case
from turtlebag.pipeline.terminal.messages import log
from turtlebag.reports.numbers import DASH, shown
from turtlebag.reports.page import fill

PAGE = "index.html"
EVERY_S = 5.0
SHOWN = 20
"""Failures that the page lists: the newest."""


@dataclass(frozen=True, eq=False)
class Worst:
    """The case with the largest value of a result, called `label`; `link` leads to its files."""

    row: Row
    label: str
    value: float
    unit: str
    link: str


class Progress:
    """Counts rows as they come; `worst` is the case with the largest value of the first result so far."""

    def __init__(self, campaign: Campaign, where: Where, todo: Sequence[Case]) -> None:
        self._campaign, self._where = campaign, where
        self._cases = {case.name: case for case in todo}
        self._result = next(iter(campaign.results), "")
        self._largest = -math.inf
        self._done = self._failed = self._before = 0
        self._failures: list[Row] = []
        self._watch: Stopwatch | None = None
        self._written_s = 0.0
        self.worst: Worst | None = None

    def start(self) -> None:
        """From now on rows are new, and the page is written."""
        self._watch, self._before = Stopwatch(), self._done
        self._write(0.0)

    def add(self, row: Row) -> None:
        """Count a row, and write the page if that is some time ago."""
        self._done += 1
        if row["failed"]:
            self._failed += 1
            self._failures = [*self._failures, row][-SHOWN:]
        value = row.get(self._result)
        if isinstance(value, (int, float)) and not isinstance(value, bool) and value > self._largest:
            case, stage = self._cases[row["case"]], self._campaign.results[self._result].at.partition(":")[0]
            folder = kept_at(case, self._campaign, self._where.maker, stage)
            label, unit = self._campaign.names[self._result]
            self._largest = value
            self.worst = Worst(row, label, value, unit, f"{folder}/metrics.json")
        if self._watch is not None and self._watch.seconds() - self._written_s > EVERY_S:
            self._write(self._watch.seconds())

    def _write(self, now_s: float) -> None:
        """The page, which a browser loads again every so often."""
        self._written_s = now_s
        done, total = self._done, len(self._cases)
        rate = (done - self._before) / now_s if now_s > 0.0 else 0.0
        page = fill(
            "campaign_running.html.j2",
            campaign=self._campaign,
            done=done,
            total=total,
            failed=self._failed,
            failures=self._failures[::-1],
            worst=self.worst,
            share=shown(done / total, "percent") if total else DASH,
            rate=f"{60.0 * rate:.3g}" if rate > 0.0 else DASH,
            left=_duration((total - done) / rate) if rate > 0.0 else DASH,
            again_s=round(EVERY_S),
        )
        try:
            self._where.runs.put(PAGE, page.encode())
        except Exception as error:  # a page that is not there ends no campaign; the next one may be
            log.warning(f"{self._where.runs.url}/{PAGE}: cannot be written ({reason_of(error)})")


def _duration(seconds: float) -> str:
    """A time span for people, to two units."""
    for size, unit, smaller, name in ((86400, "d", 3600, "h"), (3600, "h", 60, "min"), (60, "min", 1, "s")):
        if seconds >= size:
            return f"{int(seconds // size)} {unit} {int(seconds % size // smaller)} {name}"
    return f"{int(seconds)} s"
