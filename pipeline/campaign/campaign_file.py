"""A campaign file: factors, the stages each case runs, and the numbers to keep."""

from __future__ import annotations

import hashlib
import itertools
import json
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, model_validator

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.yaml_files import checked, find_named, read_mapping
from turtlebag.reports.numbers import UNITS

FOLDER = Path(__file__).parents[2] / "reports" / "studies"
LINEAR = re.compile(r"(?:(?P<a>-?[\d.]+)(?P<sign>[+-]))?(?P<b>-?[\d.]+)\*x")
COLUMNS = frozenset({"case", "failed", "error"})
"""What every row of the table holds besides factors and results."""
Scalar = bool | int | float | str


class Range(BaseModel):
    """Whole numbers from `first` to `last`, both included."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    first: int
    last: int


class Uniform(BaseModel):
    """A number drawn anew for each case; only with `sample`."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    low: float
    high: float


Levels = list[Scalar] | Range | Uniform | dict[str, str]


class Result(BaseModel):
    """A number to keep: `at` is `stage:path` in that stage's metrics.json; how it is called and shown."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    at: str
    label: str = ""
    unit: str = "plain"

    @model_validator(mode="before")
    @classmethod
    def _short(cls, data: Any) -> Any:
        return {"at": data} if isinstance(data, str) else data

    @model_validator(mode="after")
    def _unit_is_known(self) -> Result:
        _check_unit(self.unit)
        return self


def _check_unit(unit: str) -> None:
    if unit not in UNITS:
        raise ValueError(f"unit {unit}: known are {', '.join(UNITS)}")


class Figure(BaseModel):
    """One figure: result `y` over factor `x`, intervals by bootstrap.

    One line for each level of `lines`, in one panel for each level of `panels`; `unit`: other than the
    result's own.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    x: str
    y: str
    lines: str | None = None
    panels: str | None = None
    title: str = ""
    unit: str | None = None
    log: bool = False


class Campaign(BaseModel):
    """The campaign file.

    `factors`: a list of values, `{first, last}` for whole numbers, `{low, high}` to draw from, or named
    levels whose text is put into the command as several words and may name other factors. `stages`:
    command lines without `--out`, with `{factor}` and `{stage}` (an earlier stage's folder) in braces;
    `{factor:1-0.5*x}` is a number computed from the level x, `{factor:a|b|c}` the text that stands where
    the level stands among its factor's. A stage in `shared` is run once for all cases that give it the
    same command. `results`: name -> `stage:path` in that stage's metrics.json, or
    `{at: stage:path, label: ..., unit: ...}`. `against`: the level that `compare`'s other levels are
    paired with.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    name: Annotated[str, Field(pattern=r"^[a-z0-9_-]+$")]
    question: str = ""
    seed: int = 1
    factors: dict[str, Levels]
    sample: Annotated[int, Field(ge=1)] | None = None
    stages: dict[str, str]
    shared: list[str] = []
    results: dict[str, Result]
    compare: str | None = None
    against: Scalar | None = None
    figures: list[Figure] = []
    keep: list[str] = ["metrics.json", "manifest.json", "config.yaml"]

    @model_validator(mode="after")
    def _names_agree(self) -> Campaign:
        if self.sample is None and any(isinstance(levels, Uniform) for levels in self.factors.values()):
            raise ValueError("a factor with low and high needs `sample`: the number of cases to draw")
        self._columns_are_free()
        if clash := set(self.factors) & set(self.stages):
            raise ValueError(f"{sorted(clash)[0]} is both a factor and a stage")
        for stage in self.shared:
            if stage not in self.stages:
                raise ValueError(f"shared: {stage} is not a stage of this campaign")
        for name, result in self.results.items():
            if result.at.partition(":")[0] not in self.stages or ":" not in result.at:
                raise ValueError(f"results.{name}: expected STAGE:PATH with one of the stages")
        wanted = [self.compare, *(figure.x for figure in self.figures), *(f.lines for f in self.figures)]
        wanted += [figure.panels for figure in self.figures]
        for factor in wanted:
            if factor is not None and factor not in self.factors:
                raise ValueError(f"{factor} is not a factor of this campaign")
        for figure in self.figures:
            if figure.y not in self.results:
                raise ValueError(f"{figure.y} is not a result of this campaign")
            if figure.unit is not None:
                _check_unit(figure.unit)
        self._levels_are_there()
        return self

    def _columns_are_free(self) -> None:
        """Factors and results are columns of one table, beside those that every case has."""
        for kind, names in (("factors", self.factors), ("results", self.results)):
            for name in names:
                if name in COLUMNS:
                    raise ValueError(f"{kind}.{name}: the table has a column {name} of its own; rename it")
        if clash := set(self.factors) & set(self.results):
            raise ValueError(f"{sorted(clash)[0]} is both a factor and a result; rename one")

    def _levels_are_there(self) -> None:
        for name, levels in self.factors.items():
            if isinstance(levels, Range) and levels.first > levels.last:
                raise ValueError(f"factors.{name}: first {levels.first} is after last {levels.last}")
            if isinstance(levels, Uniform) and levels.low > levels.high:
                raise ValueError(f"factors.{name}: low {levels.low:g} is above high {levels.high:g}")
            if not isinstance(levels, Uniform) and not _levels(levels):
                raise ValueError(f"factors.{name}: has no levels")
        compared = None if self.compare is None else self.factors[self.compare]
        if compared is None or self.against is None or isinstance(compared, Uniform):
            return
        if self.against not in _levels(compared):
            raise ValueError(f"against: {self.against} is not a level of {self.compare}")


@dataclass(frozen=True)
class Case:
    """One combination of factor levels and the command line (without --out) of each of its stages."""

    index: int
    name: str
    factors: dict[str, Scalar]
    commands: dict[str, list[str]]


def campaign_path(name_or_path: str) -> Path:
    """The file of a shipped study or of a campaign of one's own; InputError lists the shipped."""
    return find_named(name_or_path, FOLDER, "study")


def load_campaign(name_or_path: str) -> Campaign:
    """A shipped study by name or a file by path; InputError names the first wrong key."""
    path = campaign_path(name_or_path)
    return checked(Campaign, read_mapping(path), where=str(path))


def cases(campaign: Campaign) -> list[Case]:
    """Every case: the full grid, or `sample` draws of it; named by a hash of its levels and what it runs."""
    _require_used(campaign)
    combinations = _drawn(campaign) if campaign.sample is not None else _grid(campaign)
    return [_case(campaign, index, chosen) for index, chosen in enumerate(combinations)]


def _require_used(campaign: Campaign) -> None:
    """InputError for a factor that no command names: its cases would all be the same."""
    levels = [
        text for factor in campaign.factors.values() if isinstance(factor, dict) for text in factor.values()
    ]
    texts = " ".join([*campaign.stages.values(), *levels])
    for name in campaign.factors:
        if not re.search(rf"{{{re.escape(name)}[}}:]", texts):
            raise InputError(f"factors.{name}: no stage uses it; write {{{name}}} in a command or remove it")


def _grid(campaign: Campaign) -> Iterator[dict[str, Scalar]]:
    names = list(campaign.factors)
    for values in itertools.product(*(_levels(campaign.factors[name]) for name in names)):
        yield dict(zip(names, values, strict=True))


def _drawn(campaign: Campaign) -> Iterator[dict[str, Scalar]]:
    rng = stream(campaign.seed, "campaign cases")
    for _ in range(campaign.sample or 0):
        chosen: dict[str, Scalar] = {}
        for name, levels in campaign.factors.items():
            if isinstance(levels, Uniform):
                chosen[name] = round(float(rng.uniform(levels.low, levels.high)), 6)
            else:
                options = _levels(levels)
                chosen[name] = options[int(rng.integers(len(options)))]
        yield chosen


def _levels(levels: Levels) -> list[Scalar]:
    if isinstance(levels, Range):
        return list(range(levels.first, levels.last + 1))
    if isinstance(levels, Uniform):
        raise ValueError("a drawn factor has no levels")
    return list(levels)


class LevelText(str):
    """A level as it stands in a command.

    `{level:A+B*x}` puts in a linear function of it instead, `{level:a|b|c}` the text of its place.
    """

    place: int

    def __format__(self, spec: str) -> str:
        if not spec:
            return str(self)
        if "|" in spec:
            texts = spec.split("|")
            if self.place >= len(texts):
                raise ValueError(f"'{spec}' has no text for level {self} (number {self.place + 1})")
            return texts[self.place]
        found = LINEAR.fullmatch(spec)
        if found is None:
            raise ValueError(f"'{spec}' is not of the form A+B*x")
        sign = -1.0 if found["sign"] == "-" else 1.0
        value = float(found["a"] or 0.0) + sign * float(found["b"]) * float(self)
        return f"{value:.6g}"


def _text(level: Scalar, levels: Levels) -> LevelText:
    text = LevelText(level)
    text.place = 0 if isinstance(levels, Uniform) else _levels(levels).index(level)
    return text


def _case(campaign: Campaign, index: int, chosen: dict[str, Scalar]) -> Case:
    texts: dict[str, str] = {name: _text(level, campaign.factors[name]) for name, level in chosen.items()}
    for name, levels in campaign.factors.items():
        if isinstance(levels, dict):
            others = {other: text for other, text in texts.items() if other != name}
            texts[name] = _filled(levels[str(chosen[name])], others, f"{name}.{chosen[name]}")
    commands: dict[str, list[str]] = {}
    for stage, line in campaign.stages.items():
        # Folders of earlier stages stay in braces: they depend on where the campaign is written.
        places = {earlier: "{" + earlier + "}" for earlier in commands}
        commands[stage] = _words(_filled(line, {**texts, **places}, f"stages.{stage}"), stage)
    digest = hashlib.sha256(json.dumps([chosen, commands]).encode()).hexdigest()
    return Case(index, digest[:12], chosen, commands)


def _words(text: str, stage: str) -> list[str]:
    try:
        return shlex.split(text)
    except ValueError as error:
        raise InputError(f"stages.{stage}: `{text.strip()}`: {str(error).lower()}") from None


def _filled(line: str, values: dict[str, Any], where: str) -> str:
    try:
        return line.format(**values)
    except (KeyError, IndexError) as error:
        raise InputError(f"{where}: {{{error}}} is neither a factor nor an earlier stage") from None
    except ValueError as error:
        raise InputError(f"{where}: {error}") from None
