"""The board's inputs: simulated drives that anybody can make again, each with the hash of its bag, and the
public logs."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.registry import DATASETS
from turtlebag.datasets.yaml_files import read_mapping
from turtlebag.pipeline.campaign.campaign_file import Campaign, load_campaign
from turtlebag.pipeline.campaign.cases import Case, cases
from turtlebag.pipeline.stages.requests.request import Request

CAMPAIGN = "board"
"""The shipped campaign that the board runs."""
RECORD, SYSTEM = "record", "system"
"""Its stage that makes an input, and its factor whose levels are the rows."""
BAG = "bag/bag_0.mcap"
"""The file of a record whose hash is stated."""
HASHES = Path(__file__).with_name("inputs.yaml")


@dataclass(frozen=True)
class Drive:
    """A simulated drive: the request that makes it, that as a command line, and the sha256 of its bag, empty
    where none is stated."""

    name: str
    request: Request
    command: str
    sha256: str


@dataclass(frozen=True)
class AbsentLog:
    """A public log that is no row, with the reason."""

    name: str
    url: str
    sha256: str
    reason: str


def input_name(campaign: Campaign, case: Case) -> str:
    """The name of what a case maps: its levels but for the system and the result, `house-realistic-1`."""
    return "-".join(str(case.factors[factor]) for factor in campaign.factor_names if factor != SYSTEM)


def drives(campaign: Campaign, todo: Sequence[Case]) -> dict[str, Drive]:
    """The inputs of these cases by name."""
    stated = read_mapping(HASHES)
    found = {}
    for case in todo:
        name = input_name(campaign, case)
        if name not in found:
            command = shlex.join(["turtlebag", *case.commands[RECORD]])
            found[name] = Drive(name, case.requests[RECORD], command, str(stated.get(name, "")))
    return found


def find_drive(name: str) -> Drive:
    """The input of this name; InputError names the others."""
    campaign = load_campaign(CAMPAIGN)
    known = drives(campaign, cases(campaign))
    if name not in known:
        near = get_close_matches(name, known, 1)
        meant = f"did you mean {near[0]}?" if near else f"known: {', '.join(known)}"
        raise InputError(f"--input {name}: not an input of the board; {meant}")
    return known[name]


def absent_logs() -> list[AbsentLog]:
    """The public logs: none of them is a row yet, as they have relations and no truth."""
    reason = "has relations and no true trajectory; make bench-front-ends maps it"
    return [
        AbsentLog(log.name, file.url, file.sha256, reason)
        for log in DATASETS.values()
        for file in log.files
        if not file.name.endswith(".relations")
    ]
