"""The board's inputs: what its systems are run on, each pinned by the request that makes it and its seed, and
the drives by the hash of their bags too."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.yaml_files import read_mapping
from turtlebag.pipeline.campaign.campaign_file import Campaign, load_campaign
from turtlebag.pipeline.campaign.cases import Case, cases
from turtlebag.pipeline.stages.requests.drives import RecordRequest
from turtlebag.pipeline.stages.requests.request import Request

MAPPING = "board"
CHAPTERS = {
    "mapping": MAPPING,
    "logs": "board_logs",
    "localisation": "board_localise",
    "planning": "board_plan",
    "exploration": "board_explore",
    "barn": "board_barn",
}
"""The shipped campaigns that the board runs, by the names of its chapters."""
INPUT, SYSTEM = "input", "system"
"""Their stage that makes what the systems are run on, and the factor whose levels are the systems."""
BAG = "bag/bag_0.mcap"
"""The file of a drive whose hash is stated."""
HASHES = Path(__file__).with_name("inputs.yaml")


@dataclass(frozen=True)
class Drive:
    """A simulated drive: the request that makes it, that as a command line, and the sha256 of its bag, empty
    where none is stated."""

    name: str
    request: Request
    command: str
    sha256: str


def input_name(chapter: str, campaign: Campaign, case: Case) -> str:
    """The name of what a case is about: its levels but for the system, and before them the chapter's name but
    for maps, `house-realistic-1` and `barn-25-clean-1`."""
    levels = [str(case.factors[factor]) for factor in campaign.factor_names if factor != SYSTEM]
    return "-".join(levels if CHAPTERS[chapter] == MAPPING else [chapter, *levels])


def drives(chapter: str, campaign: Campaign, todo: Iterable[Case]) -> dict[str, Drive]:
    """The drives that these cases need, by the names of their inputs."""
    stated: Mapping[str, object] = read_mapping(HASHES)
    found = {}
    for case in todo:
        name, request = input_name(chapter, campaign, case), case.requests.get(INPUT)
        if name not in found and isinstance(request, RecordRequest):
            command = shlex.join(["turtlebag", *case.commands[INPUT]])
            found[name] = Drive(name, request, command, str(stated.get(name, "")))
    return found


def find_drive(name: str) -> Drive:
    """The drive of this name that is mapped; InputError names the others."""
    campaign = load_campaign(MAPPING)
    known = drives("mapping", campaign, cases(campaign))
    if name not in known:
        near = get_close_matches(name, known, 1)
        meant = f"did you mean {near[0]}?" if near else f"known: {', '.join(known)}"
        raise InputError(f"--input {name}: not an input of the board; {meant}")
    return known[name]
