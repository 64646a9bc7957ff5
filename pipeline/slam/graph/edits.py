"""Edits by the user: pairs of scans that did, or did not, see the same place, and walls drawn or erased."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.yaml_files import load_model

ScanNumber = Annotated[int, Field(strict=True, ge=0)]
Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Coordinate = Annotated[float, Field(strict=True, ge=-1e5, le=1e5, allow_inf_nan=False)]
Points = Annotated[tuple[tuple[Coordinate, Coordinate], ...], Field(min_length=1, max_length=1000)]

# An edit of a pair of key scans also applies to this many keys before and after each.
BESIDE = 6


class RejectedLoop(Settings):
    """Scans, numbered from 0 in file order, that did not see the same place."""

    scan: ScanNumber
    place: ScanNumber

    @model_validator(mode="after")
    def _of_two(self) -> RejectedLoop:
        if self.scan == self.place:
            raise ValueError("scan and place are the same scan")
        return self


class AddedLoop(RejectedLoop):
    """Two scans of the same place; `pose` is roughly that of `scan` relative to `place` [m, rad]."""

    pose: tuple[Finite, Finite, Finite]


class WallEdit(Settings):
    """A stroke on the finished map: occupied where it is drawn, free where it is erased.

    `points` are its corners and `width` its width, in the map frame [m]; at 0 it is a line of cells. `pose`
    is where `scan` was in that map: the stroke moves with the scan. Without both it stays where it is.
    """

    do: Literal["draw", "erase"]
    points: Points
    width: Annotated[float, Field(strict=True, ge=0.0, le=100.0)] = 0.0
    scan: ScanNumber | None = None
    pose: tuple[Finite, Finite, Finite] | None = None

    @model_validator(mode="after")
    def _of_a_scan(self) -> WallEdit:
        if (self.scan is None) != (self.pose is None):
            raise ValueError("scan and pose belong together")
        return self

    def xy_map(self, T_map_base: SE2) -> Array:
        """Its corners (n, 2) in a map whose scans were taken at `T_map_base` (scans,)."""
        points = np.array(self.points)
        if self.scan is None or self.pose is None:
            return points
        return T_map_base[self.scan] @ SE2(np.array(self.pose)).inverse() @ points


class Edits(Settings):
    """The content of an edits file."""

    version: Literal[1] = 1
    reject: tuple[RejectedLoop, ...] = ()
    add: tuple[AddedLoop, ...] = ()
    walls: tuple[WallEdit, ...] = ()

    @property
    def loops(self) -> Edits:
        """Those of loops, which move scans."""
        return self.model_copy(update={"walls": ()})

    def require_scans(self, n_scans: int, source: str) -> None:
        """InputError if it names a scan that the log does not have."""
        for kind in ("reject", "add", "walls"):
            for number, edit in enumerate(getattr(self, kind), start=1):
                last = edit.scan or 0 if isinstance(edit, WallEdit) else max(edit.scan, edit.place)
                if last >= n_scans:
                    raise InputError(
                        f"--edits: {kind} {number}: {source} has no scan {last}; "
                        f"its scans are numbered 0 to {n_scans - 1}"
                    )


@dataclass(frozen=True, eq=False)
class KeyEdits:
    """The edits by key number: pairs (n, 2) that are no loops, the newer one first, and loops (i, j, T_j_i)
    to be tried."""

    rejected: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    added: tuple[tuple[int, int, Array], ...] = ()

    @staticmethod
    def of(edits: Edits, keys: NDArray[np.int64], n_scans: int) -> KeyEdits:
        """The edits by key number: each scan is replaced by the last key scan up to it; `keys` (k,) are the
        scans of the key scans. Loops with scans from `n_scans` on are left for when their log is joined.
        InputError if two scans are so close in the log that there is nothing to join or separate."""
        pairs, added = [], []
        for loop in (*edits.reject, *edits.add):
            if max(loop.scan, loop.place) >= n_scans:
                continue
            i, j = (max(int(np.searchsorted(keys, k, side="right")) - 1, 0) for k in (loop.scan, loop.place))
            if abs(i - j) <= 2 * BESIDE:
                raise InputError(
                    f"--edits: scans {loop.scan} and {loop.place} were taken shortly after each other; name "
                    "scans of different visits"
                )
            if not isinstance(loop, AddedLoop):
                pairs.append((max(i, j), min(i, j)))
            elif i > j:
                added.append((i, j, np.array(loop.pose)))
            else:
                added.append((j, i, SE2(np.array(loop.pose)).inverse().xyt))
        return KeyEdits(np.array(pairs, dtype=np.int64).reshape(-1, 2), tuple(added))

    def rejects(self, i: int | NDArray[np.int64], j: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether the user rejected loops between key(s) i and keys j (n,)."""
        newer, older = np.maximum(i, j)[:, None], np.minimum(i, j)[:, None]
        near = np.maximum(np.abs(newer - self.rejected[:, 0]), np.abs(older - self.rejected[:, 1]))
        return np.asarray((near <= BESIDE).any(axis=1))


def load_edits(path: Path) -> Edits:
    """Read an edits file; InputError if it is invalid."""
    return load_model(Edits, path)
