"""The run log: one row for each control tick of a closed-loop run, saved as runlog.csv."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.number_text import decimals, whole
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Stamps, Twist

_POSES = tuple(f"{whose}_{part}" for whose in ("true", "estimate", "odom") for part in ("x", "y", "yaw"))
_FLAGS = ("contact_visible", "contact_low", "goal_index")
COLUMNS = ("t_ns", *_POSES, "cmd_v", "cmd_w", "clearance_m", *_FLAGS, "state", "owner")
OWNER = "navigation"
_NOWHERE = SE2(np.full(3, np.nan))


class Row(NamedTuple):
    """One control tick, see `RunLog`; `T_map_base` is None while the robot does not know where it is."""

    t_ns: int
    T_world_base: SE2
    T_map_base: SE2 | None
    T_odom_base: SE2
    command: Twist
    clearance_m: float
    contact_visible: bool
    contact_low: bool
    goal_index: int
    state: str
    owner: str = OWNER


@dataclass(frozen=True, eq=False)
class RunLog:
    """Columns of a run, each (n,): poses in m and rad, the command of the tick in m/s and rad/s.

    `T_map_base` is the estimate, NaN while the robot does not know where it is; `goal_index` is -1
    without a goal; `state` is the driver's own word for what it was doing; `owner` says whose the command
    was: `navigation` or, during a teleop override, `teleop`.
    """

    t_ns: Stamps
    T_world_base: SE2
    T_map_base: SE2
    T_odom_base: SE2
    v: Array
    w: Array
    clearance_m: Array
    contact_visible: NDArray[np.bool_]
    contact_low: NDArray[np.bool_]
    goal_index: NDArray[np.int64]
    state: list[str]
    owner: list[str]

    def __len__(self) -> int:
        return len(self.t_ns)

    def save(self, path: Path) -> None:
        """Write CSV; numbers with 6 decimals, NaN as an empty field."""
        with path.open("w", newline="") as file:
            write_header(file)
            self.write_rows(file)

    def write_rows(self, file: TextIO) -> None:
        """Append the rows to a file that begins with the header."""
        columns = [_texts(column) for column in self.columns().values()]
        csv.writer(file, lineterminator="\n").writerows(zip(*columns, strict=True))

    def columns(self) -> dict[str, NDArray[Any]]:
        """Every column by its name in the file, (n,) each."""
        poses = np.concatenate([self.T_world_base.xyt, self.T_map_base.xyt, self.T_odom_base.xyt], axis=1)
        words = (np.array(self.state, dtype=object), np.array(self.owner, dtype=object))
        flags = (self.contact_visible, self.contact_low, self.goal_index)
        arrays = (self.t_ns, *poses.T, self.v, self.w, self.clearance_m, *flags, *words)
        return dict(zip(COLUMNS, arrays, strict=True))

    @staticmethod
    def of(rows: Sequence[Row]) -> RunLog:
        """The log of some ticks."""
        t_ns, true, estimates, odom, commands, clearances, visible, low, goals, states, owners = (
            zip(*rows, strict=True) if rows else ((),) * len(Row._fields)
        )
        speeds = np.array([(command.v, command.w) for command in commands], dtype=np.float64).reshape(-1, 2)
        return RunLog(
            t_ns=np.array(t_ns, dtype=np.int64),
            T_world_base=_poses(true),
            T_map_base=_poses(_NOWHERE if T is None else T for T in estimates),
            T_odom_base=_poses(odom),
            v=speeds[:, 0],
            w=speeds[:, 1],
            clearance_m=np.array(clearances, dtype=np.float64),
            contact_visible=np.array(visible, dtype=bool),
            contact_low=np.array(low, dtype=bool),
            goal_index=np.array(goals, dtype=np.int64),
            state=list(states),
            owner=list(owners),
        )

    @staticmethod
    def joined(parts: Sequence[RunLog]) -> RunLog:
        """Logs that follow on one another as one; at least one."""

        def together(name: str) -> Any:
            found = [getattr(part, name) for part in parts]
            if isinstance(found[0], SE2):
                return SE2(np.concatenate([poses.xyt for poses in found]))
            return list(chain(*found)) if isinstance(found[0], list) else np.concatenate(found)

        return RunLog(*(together(column.name) for column in fields(RunLog)))

    @staticmethod
    def load(path: Path) -> RunLog:
        """Read a CSV written by `save`; InputError names the line that is wrong."""
        if not path.is_file():
            raise InputError(f"{path}: no such run log")
        found = []
        with path.open(newline="") as file:
            rows = csv.reader(file)
            if tuple(next(rows, ())) != COLUMNS:
                raise InputError(f"{path}: not a run log (its first line is not the expected header)")
            for number, row in enumerate(rows, start=2):
                try:
                    visible, low, goal, state, owner = row[13:]
                    numbers = np.array(decimals([text or "nan" for text in row[1:13]]))
                    poses, (v, w, clearance) = map(SE2, numbers[:9].reshape(3, 3)), numbers[9:].tolist()
                    flags = bool(whole(visible)), bool(whole(low)), whole(goal)
                    values = whole(row[0]), *poses, Twist(v, w), clearance, *flags, state, owner
                    found.append(Row(*values))
                except ValueError:
                    raise InputError(f"{path}, line {number}: not a row of a run log") from None
        return RunLog.of(found)


def _poses(poses: Iterable[SE2]) -> SE2:
    return SE2.from_array(np.array([pose.xyt for pose in poses]).reshape(-1, 3))


def _texts(column: NDArray[Any]) -> list[Any]:
    """A column as written."""
    if column.dtype.kind == "f":
        return ["" if value != value else f"{value:.6f}" for value in column.tolist()]
    return (column.astype(np.int64) if column.dtype.kind == "b" else column).tolist()


def write_header(file: TextIO) -> None:
    """The first line of a run log."""
    csv.writer(file, lineterminator="\n").writerow(COLUMNS)
