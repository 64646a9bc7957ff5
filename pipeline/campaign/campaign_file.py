"""A campaign file: factors, the stages each case runs, and the numbers to keep."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    field_validator,
    model_validator,
)

from turtlebag.datasets.settings import Settings
from turtlebag.datasets.yaml_files import checked, find_named, read_mapping
from turtlebag.pipeline.stages.requests.program import ProgramRequest
from turtlebag.reports.numbers import UNITS

FOLDER = Path(__file__).parents[2] / "reports" / "studies"
BAG = "bag"
"""The factor whose levels are the campaign's bags."""
COLUMNS = frozenset({"case", "failed", "error"})
"""What every row of the table holds besides factors and results."""
OWN_OUTPUT = re.compile(r"""(^|[\s'"|])--out([=\s'"|]|$)""")
"""An option of a stage's command that a campaign sets itself."""
Scalar = bool | int | float | str
MOST_CASES = 100_000


class Range(Settings):
    """Whole numbers from `first` to `last`, both included."""

    first: int = Field(ge=-(10**9), le=10**9)
    last: int = Field(ge=-(10**9), le=10**9)

    @model_validator(mode="after")
    def _countable(self) -> Range:
        if self.last - self.first >= MOST_CASES:
            raise ValueError(f"more than {MOST_CASES} values")
        return self


class Uniform(Settings):
    """A number drawn anew for each case; only with `sample`."""

    low: float
    high: float


Levels = list[Scalar] | Range | Uniform | dict[str, str]


def _of_one_kind(data: Any, validated: ValidatorFunctionWrapHandler) -> Any:
    try:
        return validated(data)
    except ValidationError:  # it speaks of each kind in turn
        raise ValueError(
            "expected a list of values, {first, last} of whole numbers, {low, high}, or texts by name, of "
            f"{MOST_CASES} values at most"
        ) from None


def _kind(stage: Any) -> str:
    """Which of the two a stage is meant as: what is wrong is then said of that alone."""
    return "line" if isinstance(stage, str) else "program"


def _known(unit: str) -> str:
    if unit not in UNITS:
        raise ValueError(f"unit {unit}: unknown; known: {', '.join(UNITS)}")
    return unit


class Result(Settings):
    """A number to keep: `at` is `stage:path` in that stage's metrics.json; how it is called and shown."""

    at: str
    label: str = ""
    unit: Annotated[str, AfterValidator(_known)] = "plain"

    @model_validator(mode="before")
    @classmethod
    def _short(cls, data: Any) -> Any:
        return {"at": data} if isinstance(data, str) else data


class Figure(Settings):
    """One figure: result `y` over factor `x`, means with their intervals.

    One line for each level of `lines`, in one panel for each level of `panels`.
    """

    x: str
    y: str
    lines: str | None = None
    panels: str | None = None
    title: str = ""
    log: bool = False


class Campaign(Settings):
    """The campaign file.

    `bags`: URLs of bags and logs, or of folders of them, also with *; they are the levels of the factor
    `bag`, and `{bag}` in a command is where such a bag lies. `factors`: a list of values, `{first, last}` for
    whole numbers, `{low, high}` to draw from, or named levels whose text is put into the command as several
    words and may name other factors and stages. `stages`: command lines without `--out`, with `{factor}` and
    `{stage}` (an earlier stage's folder) in braces; `{factor:1-0.5*x}` is a number computed from the level x,
    `{factor:a|b|c}` the text that stands where the level stands among its factor's. A stage in `shared` is
    run once for all cases that give it the same command; one with `command`, a list of words, is somebody
    else's program, which writes into `{out}`; a word `{factor}` stands for the words of its level. `results`:
    name -> `stage:path` in that stage's metrics.json (or its manifest), or `{at: stage:path, label: ...,
    unit: ...}`. `against`: the level that `compare`'s other levels are paired with.
    """

    name: Annotated[str, Field(pattern=r"^[a-z0-9_-]+$")]
    question: str = ""
    seed: int = 1
    bags: list[str] = Field([])
    factors: dict[str, Annotated[Levels, WrapValidator(_of_one_kind)]] = Field({})
    sample: Annotated[int, Field(ge=1, le=MOST_CASES)] | None = None
    stages: dict[
        Annotated[str, Field(pattern=r"^[^./\x00][^/\x00]*$")],  # a folder of that name
        Annotated[
            Annotated[str, Tag("line")] | Annotated[ProgramRequest, Tag("program")], Discriminator(_kind)
        ],
    ]
    shared: list[str] = Field([])
    results: dict[str, Result]
    compare: str | None = None
    against: Scalar | None = None
    figures: list[Figure] = Field([])
    keep: list[str] = Field(["metrics.json", "manifest.json", "config.yaml"])

    @field_validator("bags", mode="before")
    @classmethod
    def _one_or_several(cls, data: Any) -> Any:
        return [data] if isinstance(data, str) else data

    @property
    def factor_names(self) -> list[str]:
        """All factors, the bags first."""
        return [*([BAG] if self.bags else []), *self.factors]

    @property
    def stage_texts(self) -> dict[str, str]:
        """What each stage is told, in one text."""
        return {
            name: stage if isinstance(stage, str) else " ".join(words_of(stage))
            for name, stage in self.stages.items()
        }

    @property
    def programs(self) -> dict[str, str]:
        """The commands of stages that run somebody else's program."""
        return {
            name: shlex.join(stage.command)
            for name, stage in self.stages.items()
            if isinstance(stage, ProgramRequest)
        }

    @property
    def names(self) -> dict[str, tuple[str, str]]:
        """What each result is called, and its unit."""
        return {key: (item.label or key.replace("_", " "), item.unit) for key, item in self.results.items()}

    def chosen(self, row: Mapping[str, Any]) -> str:
        """The levels of a case by its row of the table."""
        return ", ".join(f"{factor} {row[factor]}" for factor in self.factor_names)

    @model_validator(mode="after")
    def _names_agree(self) -> Campaign:
        if self.sample is None and any(isinstance(levels, Uniform) for levels in self.factors.values()):
            raise ValueError("a factor with low and high needs `sample`: the number of cases to draw")
        self._columns_are_free()
        if self.bags and BAG in self.factors:
            raise ValueError(f"factors.{BAG}: `bags` already defines this factor; rename yours")
        if not self.factor_names:
            raise ValueError("needs `factors` or `bags`")
        if clash := set(self.factor_names) & set(self.stages):
            raise ValueError(f"{sorted(clash)[0]} is both a factor and a stage")
        self._outputs_are_the_campaigns()
        for stage in self.shared:
            if stage not in self.stages:
                raise ValueError(f"shared: {stage} is not a stage of this campaign")
        for name, result in self.results.items():
            if result.at.partition(":")[0] not in self.stages or ":" not in result.at:
                raise ValueError(f"results.{name}: expected STAGE:PATH with one of the stages")
        for factor in (self.compare, *(name for f in self.figures for name in (f.x, f.lines, f.panels))):
            if factor is not None and factor not in self.factor_names:
                raise ValueError(f"{factor} is not a factor of this campaign")
        for figure in self.figures:
            if figure.y not in self.results:
                raise ValueError(f"{figure.y} is not a result of this campaign")
        self._levels_are_there()
        return self

    def _columns_are_free(self) -> None:
        """Factors and results are columns of one table, beside those that every case has."""
        for kind, names in (("factors", self.factors), ("results", self.results)):
            for name in names:
                if name in COLUMNS:
                    raise ValueError(f"{kind}.{name}: the table has a column {name} of its own; rename it")
        if clash := set(self.factor_names) & set(self.results):
            raise ValueError(f"{sorted(clash)[0]} is both a factor and a result; rename one")

    def _outputs_are_the_campaigns(self) -> None:
        """No stage of ours says where it writes to; a program may, and levels that are words of one."""
        told = [stage.command for stage in self.stages.values() if not isinstance(stage, str)]
        words = {word for command in told for word in command}
        texts = {f"stages.{stage}": line for stage, line in self.stages.items() if isinstance(line, str)}
        for name, levels in self.factors.items():
            if isinstance(levels, dict) and f"{{{name}}}" not in words:
                texts |= {f"factors.{name}.{level}": text for level, text in levels.items()}
        for where, text in texts.items():
            if OWN_OUTPUT.search(text):
                raise ValueError(f"{where}: --out is set by the campaign; remove it")

    def _levels_are_there(self) -> None:
        for name, levels in self.factors.items():
            if isinstance(levels, Range) and levels.first > levels.last:
                raise ValueError(f"factors.{name}: first {levels.first} is after last {levels.last}")
            if isinstance(levels, Uniform) and levels.low > levels.high:
                raise ValueError(f"factors.{name}: low {levels.low:g} is above high {levels.high:g}")
            if not isinstance(levels, Uniform) and not levels_of(levels):
                raise ValueError(f"factors.{name}: has no levels")
            given = Counter(map(str, levels)) if isinstance(levels, list) else {}
            if twice := [text for text, count in given.items() if count > 1]:
                raise ValueError(f"factors.{name}: level {twice[0]} is given twice")
        compared = self.factors.get(self.compare or "")  # which bags there are is not known yet
        if compared is None or self.against is None or isinstance(compared, Uniform):
            return
        if self.against not in levels_of(compared):
            raise ValueError(f"against: {self.against} is not a level of {self.compare}")


def words_of(program: ProgramRequest) -> list[str]:
    """A program's command, and what it reads and leaves."""
    more = {name: value for name, value in dict(program).items() if name != "command"}
    return [*program.command, *(f"{name}={value}" for name, value in more.items() if value is not None)]


def levels_of(levels: Levels) -> list[Scalar]:
    """The levels of a factor; none of one that is drawn."""
    if isinstance(levels, Range):
        return list(range(levels.first, levels.last + 1))
    return [] if isinstance(levels, Uniform) else list(levels)


def campaign_path(name_or_path: str) -> Path:
    """The file of a shipped study or of a campaign of one's own; InputError lists the shipped."""
    return find_named(name_or_path, FOLDER, "study")


def load_campaign(name_or_path: str) -> Campaign:
    """A shipped study by name or a file by path; InputError names the first wrong key."""
    path = campaign_path(name_or_path)
    return checked(Campaign, read_mapping(path), where=str(path))
