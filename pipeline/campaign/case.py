"""One case of a campaign: its stages run one after the other, its numbers kept, the rest thrown away."""

from __future__ import annotations

import hashlib
import io
import json
import tarfile
import tempfile
import threading
from collections.abc import Callable, Iterable, Mapping
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from turtlebag.datasets.bags.remote import brought
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import Output, Stopwatch
from turtlebag.pipeline.campaign.campaign_file import BAG, Campaign
from turtlebag.pipeline.campaign.cases import Case, with_places
from turtlebag.pipeline.campaign.store import Store
from turtlebag.pipeline.stages.requests.program import ProgramRequest
from turtlebag.pipeline.stages.requests.request import Request
from turtlebag.pipeline.terminal.messages import set_verbosity, verbosity_kept
from turtlebag.reports.numbers import lookup
from turtlebag.reports.stages import read_json

Run = Callable[[Request, Output], int]
"""Does what a request asks for; gives the exit code."""
Row = dict[str, Any]
"""A line of the table, by column."""
Done = tuple[Row, float | None]
"""The row of a case and how long it took [s]; None when its worker was lost."""
ROWS, CASES, SHARED = "rows", "cases", "shared"
"""Parts of a campaign's store: rows, files kept of each case, and of outputs that several cases use."""
STREAMS = threading.Lock()
"""Held by the thread that the streams of this process belong to."""


NUMBERS = ("manifest.json", "metrics.json")
"""Where the numbers of an output stand; what both have, the metrics say."""


class StageFailed(Exception):
    """A stage left no finished output; the text says why, in one line."""


@dataclass(frozen=True)
class Where:
    """Where a campaign keeps its rows and files, and where its stages' outputs are kept for all who use them.

    `maker` is the fingerprint of all that shapes an output besides its command: a kept one of another maker
    is not taken.
    """

    runs: Store
    outputs: Store
    maker: str


def run_case(case: Case, campaign: Campaign, where: Where, run: Run) -> Done:
    """Run a case and return its row and how long it took [s]; a stage that breaks makes a `failed` row.

    It works in a folder of its own, on whatever machine it is. Its row is put into the store last: where it
    is, the case is done.
    """
    watch = Stopwatch()
    with tempfile.TemporaryDirectory(prefix="case-", dir=_scratch()) as folder:
        work = _Work(case, campaign, where, run, Path(folder))
        try:
            work.run_stages()
            row = row_of(case, campaign, "") | work.results()
        except StageFailed as failure:
            row = row_of(case, campaign, str(failure))
        work.keep_files()
    wall_s = round(watch.seconds(), 3)
    where.runs.put(f"{ROWS}/{case.name}.json", json.dumps({"row": row, "wall_s": wall_s}).encode())
    return row, wall_s


def row_of(case: Case, campaign: Campaign, error: str) -> Row:
    """The row of a case before its results are known; `error` says why it failed, if it did."""
    nothing = dict.fromkeys(campaign.results)
    return {"case": case.name, **case.factors, "failed": bool(error), "error": error, **nothing}


def recipes(case: Case, maker: str) -> dict[str, str]:
    """For each stage a hash of all that makes its output: the same hash is the same output."""
    known = {BAG: f"{case.factors.get(BAG)} {case.bag_version}"}
    for stage, words in case.commands.items():
        text = json.dumps([maker, [with_places(word, known) for word in words]])
        known[stage] = hashlib.sha256(text.encode()).hexdigest()[:32]
    return {stage: known[stage] for stage in case.commands}


def kept_at(case: Case, campaign: Campaign, maker: str, stage: str) -> str:
    """Part of the store that holds the files kept of a stage: a case's own, or that of all who share it."""
    if stage in campaign.shared:
        return f"{SHARED}/{recipes(case, maker)[stage][:16]}"
    return f"{CASES}/{case.name}/{stage}"


def numbers_of(files: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """All that the files of NUMBERS have."""
    return {key: value for content in files for key, value in content.items()}


def made_once(store: Store, name: str, make: Callable[[], bytes]) -> bytes:
    """Content of an object; where there is none yet it is made, by one of all workers that ask for it.

    Who makes it holds a lock of the Dask scheduler, which takes it back from a worker that is lost.
    """
    from distributed import Lock

    content = store.read(name)
    if content is None:
        with Lock(store.at(name)):
            content = store.read(name)
            if content is None:
                content = make()
                store.put(name, content)
    return content


def _scratch() -> str | None:
    """The folder in which a Dask worker may write; elsewhere that of the system."""
    from distributed import get_worker

    try:
        return str(get_worker().local_directory)
    except ValueError:
        return None


class _Work:
    """The stages of one case, in a folder."""

    def __init__(self, case: Case, campaign: Campaign, where: Where, run: Run, folder: Path) -> None:
        self._case, self._campaign, self._where, self._run = case, campaign, where, run
        self._folder = folder
        self._recipes = recipes(case, where.maker)
        self._places = {stage: folder / stage for stage in case.commands}

    def run_stages(self) -> None:
        """Run what is not made already; StageFailed at the first stage that leaves nothing."""
        for stage in self._case.commands:
            if stage in self._campaign.shared:
                name, make = f"{self._recipes[stage]}.tar", partial(self._packed, stage)
                packed = made_once(self._where.outputs, name, make)
                if not self._places[stage].exists():
                    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
                        archive.extractall(self._places[stage], filter="data")
            else:
                self._make(stage)

    def results(self) -> Row:
        """The numbers to keep: each at `stage:dotted.path` of a stage's metrics.json, None if not there."""
        return {name: _value(self._places, result.at) for name, result in self._campaign.results.items()}

    def keep_files(self) -> None:
        """Put the files to keep into the store, those of a stage that several cases share once."""
        for stage, place in self._places.items():
            target = kept_at(self._case, self._campaign, self._where.maker, stage)
            if stage in self._campaign.shared and self._where.runs.has(f"{target}/manifest.json"):
                continue
            for path in sorted(place.rglob("*"), key=lambda path: (path.name == "manifest.json", path)):
                if path.is_file() and ("*" in self._campaign.keep or path.name in self._campaign.keep):
                    self._where.runs.put(f"{target}/{path.relative_to(place).as_posix()}", path.read_bytes())

    @cached_property
    def _bag(self) -> Path:
        """Where the bag lies on this machine: it comes when the first stage that reads it is run."""
        said = {word.rpartition("=")[2] for words in self._case.commands.values() for word in words}
        try:
            return brought(str(self._case.factors[BAG]), self._folder / BAG, said)
        except InputError as error:
            raise StageFailed(f"{BAG}: {error}") from None

    def _packed(self, stage: str) -> bytes:
        """The output of a shared stage, made here, as one file; StageFailed where it cannot be unpacked."""
        self._make(stage)
        packed, elsewhere = io.BytesIO(), str(self._folder / "unpacked")
        try:
            with tarfile.open(fileobj=packed, mode="w") as archive:
                archive.add(
                    self._places[stage], ".",
                    filter=lambda member: tarfile.data_filter(member, elsewhere) and member,
                )  # fmt: skip
        except tarfile.FilterError as error:  # a program may leave links and pipes
            raise self._failure(stage, f"cannot be shared: {error}") from None
        return packed.getvalue()

    def _make(self, stage: str) -> None:
        """Run a stage into its folder."""
        out = self._places[stage]
        words = self._case.commands[stage]
        bag = {BAG: self._bag} if any(f"{{{BAG}}}" in word for word in words) else {}
        places = {**self._places, **bag}
        request = self._case.requests[stage].moved(lambda one: type(one)(with_places(str(one), places)))
        command = [with_places(word, places) for word in words]
        if not isinstance(request, ProgramRequest):
            command = ["turtlebag", *command, "--out", str(out)]
        told, said = io.StringIO(), io.StringIO()
        code = None
        try:
            # Streams, settings and libraries belong to the whole process: threads take turns.
            with STREAMS, verbosity_kept(), redirect_stderr(told), redirect_stdout(said):
                set_verbosity(-1)
                code = self._run(request, Output(out, True, command))
        except InputError as error:
            raise self._failure(stage, f"turtlebag: {error}") from None
        except (Exception, SystemExit) as error:
            # A defect in one case must not end a campaign of a thousand: it becomes that case's result.
            raise self._failure(stage, f"{type(error).__name__}: {error}") from None
        if not (out / "manifest.json").is_file():
            last = told.getvalue().strip().splitlines()[-1:] or [f"exit code {code}"]
            raise self._failure(stage, last[0])

    def _failure(self, stage: str, reason: str) -> StageFailed:
        named = " ".join(reason.split())
        if url := str(self._case.factors.get(BAG, "")):
            named = named.replace(str(self._folder / BAG / url.rpartition("/")[2]), url)
        return StageFailed(f"{stage}: {named.replace(str(self._folder), 'CASE')}")


def _value(places: Mapping[str, Path], where: str) -> Any:
    stage, _, path = where.partition(":")
    files = [places[stage] / name for name in NUMBERS] if stage in places else []
    value = lookup(numbers_of(read_json(file) for file in files if file.is_file()), path)
    return value if isinstance(value, (bool, int, float, str)) else None
