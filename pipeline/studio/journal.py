"""`session.yaml`: the options of a session, and one line per input with its time.

It extends the format of `teleop_override.yaml`: teleop commands are intervals, everything else has a
time `at`. Whole lines are appended, never changed, so the file can be read at any moment.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import Field

from turtlebag.datasets.durations import LONGEST_S, nanoseconds, seconds
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.growing_file import GrowingFile
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.types import Twist
from turtlebag.datasets.yaml_files import checked, read_mapping
from turtlebag.pipeline.navigation.teleop_override import Interval, TeleopOverrideConfig
from turtlebag.pipeline.slam.graph.edits import Edits
from turtlebag.pipeline.studio.inputs import DRIVING, LONGEST_BAG_S, Input, parse_input
from turtlebag.sim.simulator import SimConfig

FILE = "session.yaml"
EVERY_NS = 10**9
"""A line is written at least this often, so that a kill loses no more."""


class Header(Settings):
    """The options of a session; `sha256` are those of its files, by kind."""

    version: Literal[1] = 1
    world: str
    robot: str
    seed: int = Field(ge=0)
    map: str | None = None
    sha256: dict[str, str] = Field({})
    sim: SimConfig = SimConfig()


class BagHeader(Settings):
    """The bag of a session, `sha256` by file of the bag, and the edits that it began with."""

    version: Literal[1] = 1
    bag: str
    sha256: dict[str, str]
    edits: Edits = Field(Edits(), exclude_if=lambda edits: edits == Edits())


@dataclass(frozen=True, eq=False)
class Recorded:
    """A session file: actions by time [ns], intervals of teleop, and the last time in it [ns]."""

    header: Header | BagHeader
    actions: tuple[tuple[int, Input], ...]
    script: tuple[Interval, ...]
    until_ns: int


def load_session(path: Path) -> Recorded:
    """Read a session file; InputError names the entry that is wrong."""
    data = read_mapping(path)
    entries = data.pop("inputs", None) or []
    header: Header | BagHeader
    if "bag" in data:
        header = checked(BagHeader, data, where=str(path))
    else:
        header = checked(Header, data, where=str(path))
    if not isinstance(entries, list):
        raise InputError(f"{path}: inputs: expected a list")
    longest_s = LONGEST_S if isinstance(header, Header) else LONGEST_BAG_S
    actions: list[tuple[int, Input]] = []
    intervals: list[Any] = []
    until_ns = 0
    for number, entry in enumerate(entries, start=1):
        where = f"{path}: input {number}"
        if not isinstance(entry, dict):
            raise InputError(f"{where}: expected keys and values")
        if "at" not in entry:
            interval = checked(Interval, entry, where=where)
            intervals.append(interval)
            until_ns = max(until_ns, nanoseconds(interval.end))
            continue
        at_ns, action = _timed(entry, where, longest_s)
        if at_ns < (actions[-1][0] if actions else 0):
            raise InputError(f"{where}: at {entry['at']:g} s, before the previous one; sort them by time")
        if actions and actions[-1][1].do == "end":
            raise InputError(f"{where}: comes after the session's end; remove it")
        until_ns = max(until_ns, at_ns)
        if action is not None:
            actions.append((at_ns, action))
    script = checked(TeleopOverrideConfig, {"script": intervals}, where=str(path)).script
    return Recorded(header, tuple(actions), script, until_ns)


def _timed(entry: Mapping[str, Any], where: str, longest_s: float) -> tuple[int, Input | None]:
    """Time [ns] and action of an entry; no action in a line that only says the session was still running."""
    at, rest = entry["at"], {key: value for key, value in entry.items() if key != "at"}
    if isinstance(at, bool) or not isinstance(at, (int, float)) or not 0.0 <= at <= longest_s:
        raise InputError(f"{where}: at: must be 0 to {longest_s:g} s")
    at_ns = nanoseconds(at)
    if not rest:
        return at_ns, None
    action = parse_input(rest, where)
    if action.do in DRIVING:
        raise InputError(f"{where}: {action.do}: write it as an interval with begin, end, v and w")
    return at_ns, action


class Journal:
    """Writes a session file while the session goes on."""

    def __init__(self, path: Path, header: Header | BagHeader) -> None:
        told = header.model_dump(mode="json", exclude={"sim"})
        if isinstance(header, Header) and (sim := header.sim.model_dump(mode="json", exclude_unset=True)):
            told["sim"] = sim
        begun = path.with_name(f".{path.name}")
        self._file = GrowingFile(begun)
        try:
            self._write(yaml.safe_dump(told, sort_keys=False) + "inputs:\n")
            begun.rename(path)  # a kill between the two leaves no half a header
        except OSError:
            self._file.close()
            raise
        self._asked: Twist | None = None
        self._begin_ns = self._silent_ns = 0

    def action(self, stamp_ns: int, action: Input) -> None:
        """Note an action, which happens before the tick at this stamp."""
        self._interval(stamp_ns)
        self._begin_ns = self._silent_ns = stamp_ns
        self._entry({"at": _seconds(stamp_ns), **action.model_dump(mode="json", exclude_none=True)})

    def tick(self, stamp_ns: int, asked: Twist | None) -> None:
        """Note a tick, and the speed that was asked for by hand, if one was."""
        changed = asked != self._asked
        if self._asked is not None and (changed or stamp_ns - self._begin_ns >= EVERY_NS):
            self._interval(stamp_ns)
            self._begin_ns = self._silent_ns = stamp_ns
        if changed:
            self._asked, self._begin_ns = asked, stamp_ns
        if asked is None and stamp_ns - self._silent_ns >= EVERY_NS:
            self._silent_ns = stamp_ns
            self._entry({"at": _seconds(stamp_ns)})

    def close(self) -> None:
        """Finish the file."""
        self._file.close()

    def _interval(self, end_ns: int) -> None:
        if self._asked is not None and end_ns > self._begin_ns:
            span = {"begin": _seconds(self._begin_ns), "end": _seconds(end_ns)}
            self._entry({**span, "v": self._asked.v, "w": self._asked.w})

    def _entry(self, entry: Mapping[str, Any]) -> None:
        text = yaml.safe_dump(dict(entry), default_flow_style=True, sort_keys=False, width=10**9)
        self._write(f"- {text}")

    def _write(self, text: str) -> None:
        self._file.write(text.encode())
        self._file.flush()


def _seconds(stamp_ns: int) -> float:
    return round(seconds(stamp_ns), 9)
