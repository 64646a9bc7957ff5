"""Base of the defensive front-to-back readers of mcap and ROS 1 files.

Damage ends the data or is skipped, and is reported. Indices are not used, so unfinished files are read as far
as they go.
"""

from __future__ import annotations

import bz2
from abc import ABC, abstractmethod
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import lz4.frame
import zstandard

from turtlebag.datasets.bags.topics import Message, Wanted
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.files import FileBytes, Unpacked


class Damage(Exception):
    """A record that is not as it was written."""


@dataclass(slots=True)
class State:
    """The damage found in a file, and whether reading stopped there."""

    problems: list[str] = field(default_factory=list)
    stopped: bool = False


class SequentialReader(ABC):
    """One file, read sequentially; `state` fills while messages are drawn."""

    MAGIC: ClassVar[bytes]
    KIND: ClassVar[str]
    state: State

    def __init__(self, path: Path) -> None:
        self.path = path
        self._data = FileBytes(path)
        if self._data[: len(self.MAGIC)] != self.MAGIC:
            raise InputError(f"{path}: not {self.KIND} (its first bytes are damaged or of another format)")
        self._begin(step_over=False)

    def messages(self, wanted: Wanted | None = None, *, step_over: bool = False) -> Iterator[Message]:
        """Messages of the wanted topics in file order.

        At the first damage reading stops, or with `step_over` goes on at the next chunk that is whole.
        """
        self._begin(step_over=step_over)
        at, end = len(self.MAGIC), len(self._data)
        unpacked = Unpacked(self.path, end)
        while at < end:
            try:
                at = yield from self._record_messages(at, wanted, unpacked)
            except Damage as damage:
                self.state.problems.append(f"damaged at byte {at} of {end}: {damage}")
                self.state.stopped = not step_over
                if not step_over:
                    return
                at = self._next_chunk(at + 1)
        self._end()

    @abstractmethod
    def _begin(self, *, step_over: bool) -> None:
        """Forget what was read."""

    @abstractmethod
    def _record_messages(
        self, at: int, wanted: Wanted | None, unpacked: Unpacked
    ) -> Generator[Message, None, int]:
        """The messages of the record at a place, and the place of the next; Damage when it is none."""

    @abstractmethod
    def _next_chunk(self, at: int) -> int:
        """Where the next chunk with a plausible head begins; the end of the file if none does."""

    @abstractmethod
    def _end(self) -> None:
        """Compare what was read with what the file says of it."""


def unpacked_chunk(compression: str, packed: bytes, size: int) -> bytes:
    """The `size` bytes of a chunk; Damage when it unpacks to anything else."""
    try:
        if compression == "zstd":
            if zstandard.frame_content_size(packed) not in (size, -1):
                raise Damage("a chunk has the wrong size")
            records = zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
        elif compression == "lz4":
            records = bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1))
        elif compression == "bz2":
            records = bz2.BZ2Decompressor().decompress(packed, max_length=size + 1)
        else:
            raise Damage(f"unknown compression {compression[:20]!r}")
    except (zstandard.ZstdError, OSError, RuntimeError, ValueError, EOFError, MemoryError) as error:
        raise Damage(f"a chunk cannot be unpacked ({' '.join(str(error).split())[:80]})") from None
    if len(records) != size:
        raise Damage("a chunk has the wrong size")
    return records
