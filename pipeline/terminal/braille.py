"""Small drawings in a terminal: braille dots on a window of the plane, x to the right, y up."""

from __future__ import annotations

import os
import sys

import numpy as np

from turtlebag.datasets.se2 import Array

Size = tuple[int, int]
"""Columns and rows of a terminal."""

_BLANK = 0x2800
_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]], dtype=np.uint8)
_ARROWS = "→↗↑↖←↙↓↘"


class Canvas:
    """`columns` x `rows` characters (2 x 4 dots each) around `centre`, `height_m` metres high."""

    def __init__(self, columns: int, rows: int, centre: tuple[float, float], height_m: float) -> None:
        if columns < 1 or rows < 1 or not height_m > 0.0:
            raise ValueError(f"a canvas of {columns} x {rows} characters, {height_m} m high")
        self._dots = np.zeros((rows * 4, columns * 2), dtype=bool)
        self._marks: dict[tuple[int, int], str] = {}
        self._centre = np.array(centre)
        self._metres_per_dot = height_m / (rows * 4)

    def _places(self, points: Array) -> Array:
        """(row, column) of the dots under points (n, 2); those outside are dropped."""
        height, width = self._dots.shape
        offset = (np.asarray(points, dtype=np.float64) - self._centre) / self._metres_per_dot
        offset = offset[np.isfinite(offset).all(axis=1)]
        places = np.floor(np.stack([height / 2 - offset[:, 1], width / 2 + offset[:, 0]], axis=1)).astype(int)
        inside = np.all((places >= 0) & (places < (height, width)), axis=1)
        return places[inside]

    def dots(self, points: Array) -> None:
        """Draw points (n, 2) [m]."""
        places = self._places(points)
        self._dots[places[:, 0], places[:, 1]] = True

    def mark(self, x: float, y: float, character: str) -> None:
        """Put one character over the dots."""
        for row, column in self._places(np.array([[x, y]])):
            self._marks[int(row) // 4, int(column) // 2] = character

    def robot(self, x: float, y: float, yaw: float) -> None:
        """An arrow that shows a pose."""
        self.mark(x, y, _ARROWS[round(yaw / (np.pi / 4)) % 8])

    def text(self) -> str:
        """The drawing, one line a row."""
        rows, columns = self._dots.shape[0] // 4, self._dots.shape[1] // 2
        blocks = self._dots.reshape(rows, 4, columns, 2).transpose(0, 2, 1, 3)
        codes = _BLANK + (blocks * _BITS).sum(axis=(2, 3))
        lines = [[chr(code) for code in row] for row in codes.tolist()]
        for (row, column), character in self._marks.items():
            lines[row][column] = character
        return "\n".join("".join(line) for line in lines)


def terminal_size() -> Size:
    """Columns and rows of the terminal on stderr or stdout; 80 x 24 if neither is one."""
    for stream in (sys.stderr, sys.stdout):
        try:
            columns, rows = os.get_terminal_size(stream.fileno())
        except (OSError, ValueError):
            continue
        if columns > 0 and rows > 0:
            return columns, rows
    return 80, 24
