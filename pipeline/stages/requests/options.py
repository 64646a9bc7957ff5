"""The values of options: what each may be, from the command line's text, from Python and from a manifest."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.number_text import decimal, decimals
from turtlebag.datasets.parts import is_own, name_of
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.yaml_files import parsed
from turtlebag.pipeline.stages.parser import seed
from turtlebag.pipeline.terminal.messages import note_degrees

FARTHEST_M = 1e9
POSE, RAD = "X,Y,YAW", "m, m, rad"


class OrOwn(tuple[str, ...]):
    """Choices of an option that also accepts a user's class, module:Class."""

    def __contains__(self, name: object) -> bool:
        """Whether it is one of the choices, or could be such a class."""
        return super().__contains__(name) or (isinstance(name, str) and is_own(name))


@dataclass(frozen=True)
class Option:
    """What a field of a request is, and how it is given on the command line.

    `value` stands for the value in --help, `example` is one as it is typed, `unit` that of a number. `read`
    makes a value of a word; what it cannot say of the word, the field's type says. `name` is the option's if
    that is not the field's; `positional`: an argument without one.
    """

    value: str
    text: str
    example: str = ""
    unit: str = ""
    read: Callable[[str], Any] = str
    name: str = ""
    positional: bool = False
    choices: tuple[str, ...] = ()


def file(value: str, text: str, example: str, **more: Any) -> Option:
    """The option of a file or folder."""
    return Option(value, text, example, read=Path, **more)


def flag(text: str, name: str = "") -> Option:
    """An option without a value."""
    return Option("", text, name=name)


XYT = tuple[float, float, float]


def pose(value: Any) -> XYT:
    """x, y [m] and yaw [rad], finite and of plausible size: of `X,Y,YAW`, an SE2 or three numbers."""
    if isinstance(value, str):
        parts = value.split(",")
        try:
            numbers = decimals(parts)
        except ValueError:
            raise ValueError(f"expected {POSE} (metres and radians)") from None
    else:
        numbers = np.asarray(value.xyt if isinstance(value, SE2) else value, dtype=np.float64).tolist()
    if not isinstance(numbers, list) or len(numbers) != 3:
        raise ValueError(f"expected three numbers {POSE}, got {np.size(numbers)}")
    for name, number in zip(("x", "y", "yaw"), numbers, strict=True):
        if not math.isfinite(number):
            raise ValueError(f"{name} is not a finite number")
        if abs(number) > FARTHEST_M:
            raise ValueError(f"{name} is larger than any map")
    x, y, yaw = numbers
    return x, y, yaw


def flag_of(name: str) -> str:
    """The option of a field."""
    return f"--{name.replace('_', '-')}"


def typed_pose(value: Any, info: ValidationInfo) -> XYT:
    """A pose, with a note where what was typed looks like degrees."""
    xyt = pose(value)
    if isinstance(value, str):
        note_degrees(f"{flag_of(info.field_name or 'pose')} {value}", xyt[2])
    return xyt


def pose_or(*words: str) -> BeforeValidator:
    """Of a field that is a pose, one of the words, or None."""

    def known(value: Any, info: ValidationInfo) -> Any:
        if value is None or (isinstance(value, str) and value in words):
            return value
        try:
            return typed_pose(value, info)
        except ValueError as error:
            raise ValueError(f"{error}; or {' or '.join(words)}") from None

    return BeforeValidator(known)


class Laser(NamedTuple):
    """The pose of a laser on the robot [m, m, rad], and whether it is upside down."""

    x: float
    y: float
    yaw: float
    upside_down: bool = False

    @property
    def T_base_lidar(self) -> SE2:
        """Its pose on the robot."""
        return SE2.from_xyt(self.x, self.y, self.yaw)


def laser(value: Any, info: ValidationInfo) -> Laser:
    """Of `X,Y,YAW` or `X,Y,YAW,upside-down`, or of what a Laser holds."""
    if isinstance(value, str):
        upright = value.removesuffix(",upside-down")
        return Laser(*typed_pose(upright, info), upright != value)
    *xyt, upside_down = value
    return Laser(*pose(xyt), bool(upside_down))


def chosen_settings(value: Any) -> dict[str, Any]:
    """Settings by their dotted names, of a mapping, or of texts `a.b=value`; a later one goes last.

    Of a class its name is taken, of an array its numbers. InputError for a text that is none.
    """
    pairs = value.items() if isinstance(value, Mapping) else [_setting(text) for text in value or ()]
    settings: dict[str, Any] = {}
    for key, one in pairs:
        settings.pop(key, None)
        settings[key] = _plain(one)
    return settings


def _setting(text: str) -> tuple[str, Any]:
    key, equals, value = text.partition("=")
    if not equals or not key:
        raise InputError(f"--set {text}: expected key=value")
    return key, parsed(value, where=f"--set {key}")


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else class_name(value)


def class_name(value: Any) -> Any:
    """The name `module:Class` of a class; anything else as it is."""
    return name_of(value) if inspect.isclass(value) else value


def map_file(path: Path) -> Path:
    """A map's YAML file; for a folder that `map` wrote, the one in it."""
    return path / "map.yaml" if path.is_dir() else path


def system_file(value: Any) -> tuple[str, Path]:
    """Of `NAME=FILE`, or a name and a file; a file alone has an empty name."""
    if not isinstance(value, str):
        name, path = value
        return str(name), Path(path)
    name, equals, path = value.partition("=")
    if not equals or Path(value).exists():
        return "", Path(value)
    if not path:
        raise InputError(f"{value}: names no file; write NAME=FILE")
    if not name:
        raise InputError("'': a system's name may contain only letters, digits, - and _")
    return name, Path(path)


def of_system(read: Callable[[Any], Any]) -> BeforeValidator:
    """Of a field that is a system's name and a value: of `NAME=VALUE`, or a value with an empty name."""

    def named(value: Any) -> tuple[str, Any]:
        if isinstance(value, str):
            name, equals, text = value.partition("=")
            return (name, read(text)) if equals else ("", read(value))
        name, held = value
        return str(name), read(held)

    return BeforeValidator(named)


def clock_shift(value: Any) -> float:
    """By how much a clock is off [s]."""
    try:
        number = decimal(value) if isinstance(value, str) else float(value)
    except ValueError:
        number = math.nan
    if not abs(number) < 4e9:
        raise ValueError("expected a number of seconds")
    return number


Name = Annotated[str, BeforeValidator(lambda value: str(value) if isinstance(value, Path) else value)]
"""A name, a path, or a class of one's own."""
Pose = Annotated[XYT, BeforeValidator(typed_pose)]
MapFile = Annotated[Path, AfterValidator(map_file)]
Positive = Annotated[float, Field(ge=0.001, le=1e6, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=1)]

World = Annotated[
    Name,
    Option(
        "W",
        "world: a name, a YAML or SDF file, a map's YAML, a twin's folder, or your own class (module:Class)",
        "empty",
    ),
]
Robot = Annotated[
    Name | None, Option("R", "robot: a name or a YAML file (default: the world's own)", "burger")
]
Seed = Annotated[int, Field(ge=0), Option("N", "random seed", "1", read=seed)]
Start = Annotated[Pose | None, Option(POSE, "true start pose (default: the world's spawn)", "-2,-0.5,0", RAD)]
ConfigFile = Annotated[Path | dict[str, Any] | None, file("FILE", "YAML file with settings", "mine.yaml")]
Overrides = Annotated[
    dict[str, Any],
    BeforeValidator(chosen_settings),
    Option("KEY=VALUE", "override one setting", "sim.sensors=clean", name="--set"),
]
Topics = Annotated[
    tuple[str, ...], BeforeValidator(lambda value: (value,) if isinstance(value, str) else value or ())
]
"""Topics; one alone, or None, in requests of earlier versions."""
LaserPose = Annotated[
    Annotated[Laser, BeforeValidator(laser)] | None,
    Option(
        "X,Y,YAW[,upside-down]",
        "pose of the laser on the robot, YAW being the direction of beam angle 0; overrides the recording's",
        "0.1,0,0,upside-down",
        RAD,
    ),
]


def on_map(purpose: str) -> Option:
    """The option of a map."""
    return file("MAP", f"map to {purpose} on: its YAML file, or a folder that map wrote", "map")
