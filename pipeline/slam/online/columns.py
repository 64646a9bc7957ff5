"""Growing arrays of one length; rows are appended to and removed from all of them together."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


class Columns:
    """Named arrays of one length that grow along their first axis; capacity doubles, so appending is cheap.
    `columns[name]` are the rows so far, not copied; the first rows appended define the columns."""

    def __init__(self) -> None:
        self._room: dict[str, NDArray[Any]] = {}
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def __contains__(self, name: str) -> bool:
        return name in self._room

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self._room[name][: self._count]

    def append(self, **rows: NDArray[Any]) -> None:
        """Append rows to every column; ValueError if columns are missing or new."""
        if self._room and rows.keys() != self._room.keys():
            raise ValueError(f"rows of {', '.join(rows)}; those before were of {', '.join(self._room)}")
        count = self._count + len(next(iter(rows.values())))
        for name, new in rows.items():
            room = self._room.get(name)
            if room is None or count > len(room):
                grown = np.empty((max(1024, 2 * count), *new.shape[1:]), dtype=new.dtype)
                if room is not None:
                    grown[: self._count] = room[: self._count]
                self._room[name] = room = grown
            room[self._count : count] = new
        self._count = count

    def keep(self, stays: NDArray[np.bool_]) -> None:
        """Keep only these rows (n,); arrays handed out earlier stay as they are."""
        kept = {name: self[name][stays] for name in self._room}
        self._room, self._count = {}, 0
        if kept:
            self.append(**kept)
