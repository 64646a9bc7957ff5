"""How far a campaign is: a page in its store, written anew while it runs."""

from __future__ import annotations

import math
from collections.abc import Sequence

from turtlebag.datasets.outputs import Stopwatch
from turtlebag.datasets.urls import reason_of
from turtlebag.pipeline.campaign.campaign_file import Campaign
from turtlebag.pipeline.campaign.case import Row, Where, kept_at
from turtlebag.pipeline.campaign.cases import Case
from turtlebag.pipeline.campaign.results import PAGE, names_of
from turtlebag.pipeline.terminal.messages import log
from turtlebag.reports.campaign_page import Running, Worst, render_running

EVERY_S = 5.0
SHOWN = 20
"""Failures that the page lists: the newest."""


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
            self._largest, self.worst = value, self._link(row, value)
        if self._watch is not None and self._watch.seconds() - self._written_s > EVERY_S:
            self._write(self._watch.seconds())

    def _link(self, row: Row, value: float) -> Worst:
        case, stage = self._cases[row["case"]], self._campaign.results[self._result].at.partition(":")[0]
        label, unit = names_of(self._campaign)[self._result]
        folder = kept_at(case, self._campaign, self._where.maker, stage)
        return Worst(row, label, value, unit, f"{folder}/metrics.json")

    def _write(self, now_s: float) -> None:
        self._written_s = now_s
        new, total = self._done - self._before, len(self._cases)
        running = Running(
            self._campaign.name,
            self._campaign.question,
            self._campaign.factor_names,
            total,
            self._done,
            self._failed,
            new / now_s if now_s > 0.0 else 0.0,
            self._failures[::-1],
            self.worst,
        )
        try:
            self._where.runs.put(PAGE, render_running(running, EVERY_S).encode())
        except Exception as error:  # a page that is not there ends no campaign; the next one may be
            log.warning(f"{self._where.runs.url}/{PAGE}: cannot be written ({reason_of(error)})")
