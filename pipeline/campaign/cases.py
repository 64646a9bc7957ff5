"""The cases of a campaign: every combination of levels, with what it asks of each stage."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import re
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.number_text import decimal
from turtlebag.datasets.seeds import stream
from turtlebag.pipeline.campaign.bags import find_bags
from turtlebag.pipeline.campaign.campaign_file import (
    BAG,
    MOST_CASES,
    Campaign,
    Levels,
    Scalar,
    Uniform,
    levels_of,
    words_of,
)
from turtlebag.pipeline.stages.command_line import read
from turtlebag.pipeline.stages.requests.program import ProgramRequest
from turtlebag.pipeline.stages.requests.request import Request
from turtlebag.pipeline.stages.requests.studio import StudioRequest

OUT = "out"
"""In braces in a program's command: the folder that it writes into."""
PLACE = re.compile(r"\{([^{}]*)\}")
Reader = Callable[[Sequence[str]], Request]
"""Makes a request of a command line; InputError for one that makes none."""
LINEAR = re.compile(r"(?:(?P<a>-?[\d.]+)(?P<sign>[+-]))?(?P<b>-?[\d.]+)\*x")


@dataclass(frozen=True)
class Case:
    """One combination of factor levels and what it asks of each of its stages: its command line (without
    --out), and the request that this makes.

    Where its bag and earlier stages lie is in braces. `bag_version` is another when the content of its bag
    is; empty without a bag.
    """

    name: str
    factors: dict[str, Scalar]
    commands: dict[str, list[str]]
    requests: dict[str, Request]
    bag_version: str = ""


def cases(campaign: Campaign, read: Reader = read) -> list[Case]:
    """Every case: the full grid, or `sample` draws of it; named by a hash of its levels and what it runs.

    InputError for bags that cannot be listed, and for a command that cannot be filled in or that `read`
    makes no request of.
    """
    _require_used(campaign)
    versions = find_bags(campaign.bags)
    bags: dict[str, Levels] = {BAG: list(versions)} if versions else {}
    factors = {**bags, **campaign.factors}
    combinations = _grid(factors) if campaign.sample is None else _drawn(campaign, factors)
    known = cache(lambda words: read(words))
    return [_case(campaign, chosen, versions.get(str(chosen.get(BAG)), ""), known) for chosen in combinations]


def with_places(text: str, places: Mapping[str, object]) -> str:
    """A text with what is known by now of `{bag}` and the stages' names in braces; others stay."""
    return PLACE.sub(lambda found: str(places.get(found[1], found[0])), text)


def _require_used(campaign: Campaign) -> None:
    """InputError for a factor that no command names: its cases would all be the same."""
    levels = [
        text for factor in campaign.factors.values() if isinstance(factor, dict) for text in factor.values()
    ]
    texts = " ".join([*campaign.stage_texts.values(), *levels])
    for name in campaign.factor_names:
        if not re.search(rf"{{{re.escape(name)}[}}:]", texts):
            raise InputError(f"factors.{name}: no stage uses it; write {{{name}}} in a command or remove it")


def _grid(factors: Mapping[str, Levels]) -> Iterator[dict[str, Scalar]]:
    every = [levels_of(levels) for levels in factors.values()]
    if (count := math.prod(map(len, every))) > MOST_CASES:
        raise InputError(
            f"factors: their levels make {count} cases; at most {MOST_CASES} (`sample` draws some)"
        )
    for values in itertools.product(*every):
        yield dict(zip(factors, values, strict=True))


def _drawn(campaign: Campaign, factors: Mapping[str, Levels]) -> Iterator[dict[str, Scalar]]:
    rng = stream(campaign.seed, "campaign cases")
    for _ in range(campaign.sample or 0):
        chosen: dict[str, Scalar] = {}
        for name, levels in factors.items():
            if isinstance(levels, Uniform):
                chosen[name] = round(float(rng.uniform(levels.low, levels.high)), 6)
            else:
                options = levels_of(levels)
                chosen[name] = options[int(rng.integers(len(options)))]
        yield chosen


class LevelText(str):
    """The text of a level as it stands in a command.

    `{level:A+B*x}` puts in a linear function of it instead, `{level:a|b|c}` the text of its place.
    """

    level: Scalar
    levels: Levels

    def __format__(self, spec: str) -> str:
        if not spec:
            return str(self)
        if "|" in spec:
            texts = spec.split("|")
            known = [str(level) for level in levels_of(self.levels)]
            place = known.index(str(self.level)) if known else 0
            if place >= len(texts):
                raise ValueError(f"'{spec}' has no text for level {self.level} (number {place + 1})")
            return texts[place]
        found = LINEAR.fullmatch(spec)
        if found is None:
            raise ValueError(f"'{spec}' is not of the form A+B*x")
        sign = -1.0 if found["sign"] == "-" else 1.0
        value = decimal(found["a"] or "0") + sign * decimal(found["b"]) * decimal(self)
        return f"{value:.6g}"


def _text(text: object, level: Scalar, levels: Levels) -> LevelText:
    found = LevelText(text)
    found.level, found.levels = level, levels
    return found


def _case(campaign: Campaign, chosen: dict[str, Scalar], bag_version: str, read: Reader) -> Case:
    texts: dict[str, str] = {
        name: _text(chosen[name], chosen[name], levels) for name, levels in campaign.factors.items()
    }
    # Where the bag and the folders of earlier stages lie is known to who runs them: they stay in braces.
    places = {BAG: f"{{{BAG}}}"} if BAG in chosen else {}
    later = {name: f"{{{name}}}" for name in (OUT, *campaign.stages)}
    for name, levels in campaign.factors.items():
        if isinstance(levels, dict):
            others = {other: text for other, text in texts.items() if other != name}
            text = levels[str(chosen[name])]
            known = {**later, **others, **places}
            texts[name] = _text(_filled(text, known, f"{name}.{chosen[name]}"), chosen[name], levels)
    commands: dict[str, list[str]] = {}
    requests: dict[str, Request] = {}
    for stage, told in campaign.stages.items():
        where, known_there = f"stages.{stage}", {**texts, **places}
        if isinstance(told, str):
            words = _words(_filled(told, known_there, where), where)
            if words:  # a stage may have nothing to do for some levels
                commands[stage], requests[stage] = words, _request(stage, words, read)
        else:
            program = _program(told, campaign, texts, {**known_there, OUT: f"{{{OUT}}}"}, where)
            commands[stage], requests[stage] = words_of(program), program
        named = {name for word in commands.get(stage, ()) for name in PLACE.findall(word)}
        for name in named & set(later) - set(places) - {OUT}:  # by the text of a level
            raise InputError(f"{where}: {{{name}}} is not an earlier stage")
        places[stage] = f"{{{stage}}}"
    parts = [chosen, commands, *([bag_version] if bag_version else [])]
    digest = hashlib.sha256(json.dumps(parts).encode()).hexdigest()
    return Case(digest[:16], chosen, commands, requests, bag_version)


def _program(
    told: ProgramRequest, campaign: Campaign, texts: Mapping[str, str], values: dict[str, Any], where: str
) -> ProgramRequest:
    """A program's request for a case; a word that is a factor alone stands for the words of its level."""

    def filled(text: str | Path) -> str | Path:
        return type(text)(_filled(str(text), values, where))

    whole = {f"{{{name}}}": name for name, levels in campaign.factors.items() if isinstance(levels, dict)}
    words = [_words(texts[whole[word]], where) if word in whole else [filled(word)] for word in told.command]
    return told.moved(filled).model_copy(update={"command": tuple(itertools.chain.from_iterable(words))})


def _request(stage: str, words: Sequence[str], read: Reader) -> Request:
    try:
        request = read(tuple(words))
        if isinstance(request, StudioRequest):
            request.replayed()  # no person is there
        return request
    except InputError as error:
        raise InputError(f"stages.{stage}: {error}") from None


def _words(text: str, where: str) -> list[str]:
    try:
        return shlex.split(text)
    except ValueError as error:
        raise InputError(f"{where}: `{text.strip()}`: {str(error).lower()}") from None


def _filled(line: str, values: dict[str, Any], where: str) -> str:
    try:
        return line.format(**values)
    except KeyError as error:
        raise InputError(f"{where}: {{{error.args[0]}}} is neither a factor nor an earlier stage") from None
    except IndexError:
        raise InputError(f"{where}: a brace without a name; name a factor, or write {{{{ and }}}}") from None
    except (AttributeError, TypeError, ValueError) as error:
        raise InputError(f"{where}: {error}") from None
