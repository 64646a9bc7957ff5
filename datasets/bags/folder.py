"""Write a rosbag2 folder: any topics, one MCAP file, metadata.yaml last."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Self

from mcap.records import Channel, Schema

from turtlebag.datasets.bags.cdr import Layout, Row
from turtlebag.datasets.bags.mcap_file import MESSAGE_HEAD_BYTES, McapFile, packed
from turtlebag.datasets.bags.topics import (
    CUSTOM_RECORD,
    DATA_FILE,
    METADATA_FILE,
    bag_metadata,
    metadata_text,
)
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.growing_file import GrowingFile

CHUNK_BYTES = 128 * 1024
"""A chunk is handed to the operating system when its content has this size ..."""
CHUNK_NS = 1_000_000_000
"""... or spans this time, whichever comes first: so much is lost at the most when the writer is killed."""


class BagFolder:
    """A context manager. Whatever ends it, the bag is closed properly where there is room; else its file has
    all chunks for which there was, for `bag recover`, and no file is left where there was none for any."""

    def __init__(self, folder: Path, *, custom: Mapping[str, str]) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if (folder / METADATA_FILE).exists():
                raise FileExistsError
            self._file = GrowingFile(folder / DATA_FILE)
        except FileExistsError:
            raise InputError(f"{folder}: already holds a bag; choose another folder") from None
        except OSError as error:
            raise InputError(f"{folder}: cannot be written ({error.strerror})") from None
        self._mcap = McapFile(self._file)
        if custom:  # at the beginning, where a crash cannot take it away
            self._mcap.metadata(CUSTOM_RECORD, custom)
        try:
            self._file.flush()
        except OSError as error:
            self._file.close()
            raise InputError(f"{folder}: cannot be written ({error.strerror})") from None
        self._folder = folder
        self._custom = dict(custom)
        self._begun = self._file.tell()
        self._topics: list[tuple[str, str, str, str]] = []
        self._counts: list[int] = []
        self._channels: list[Channel] = []
        self._schemas: dict[tuple[str, str, str], Schema] = {}
        self._first_ns, self._last_ns = 1 << 64, 0
        self._closed = False
        self._front = b""
        self._begin_chunk()

    def _begin_chunk(self) -> None:
        """The chunk under way: heads and data of messages, and the rows of those that are packed later."""
        self._heads: list[tuple[int, int, int]] = []
        self._data: list[bytes] = []
        self._rows: dict[Layout, list[tuple[int, Row]]] = {}
        self._size = len(self._front)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None and not self._closed and not any(self._counts):
            self._closed = True
            self._file.close()
            (self._folder / DATA_FILE).unlink()
        try:
            self.close()
        except OSError:
            if kind is None:
                raise  # else the error told of the full disk

    def add_topic(
        self,
        name: str,
        msgtype: str,
        text: str,
        *,
        form: str = "ros2msg",
        qos: str = "",
        type_hash: str = "",
        encoding: str = "cdr",
    ) -> int:
        """Register a topic with its message definition; returns the channel to write to."""
        key = msgtype, form, text
        if key not in self._schemas:
            schema = Schema(len(self._schemas) + 1, text.encode(), form, msgtype)
            self._schemas[key] = schema
            self._front += packed(schema)
        self._topics.append((name, msgtype, qos, type_hash))
        self._counts.append(0)
        metadata = {"offered_qos_profiles": qos, "topic_type_hash": type_hash}
        channel = Channel(len(self._counts), name, encoding, metadata, self._schemas[key].id)
        self._channels.append(channel)
        self._front += packed(channel)
        return channel.id

    def write(self, channel: int, log_time_ns: int, data: bytes) -> None:
        """Append one message; ValueError for a time that the format cannot hold."""
        self._append(channel, log_time_ns, data, len(data))

    def write_row(self, channel: int, log_time_ns: int, layout: Layout, row: Row) -> None:
        """Append a message of which only the row is told; it is packed with all others of its layout."""
        self._rows.setdefault(layout, []).append((len(self._data), row))
        self._append(channel, log_time_ns, b"", layout.size)

    def _append(self, channel: int, log_time_ns: int, data: bytes, size: int) -> None:
        if not 0 <= log_time_ns < 1 << 64:
            raise ValueError(f"{log_time_ns} ns is not a valid message time")
        self._data.append(data)
        count = self._counts[channel - 1]
        self._heads.append((channel, count, log_time_ns))
        self._counts[channel - 1] = count + 1
        self._size += MESSAGE_HEAD_BYTES + size
        if self._size > CHUNK_BYTES or abs(log_time_ns - self._heads[0][2]) >= CHUNK_NS:
            self._end_chunk()
            self._file.flush()

    def _end_chunk(self) -> None:
        if not self._heads:
            return
        for layout, rows in self._rows.items():
            for (place, _), message in zip(rows, layout.messages([row for _, row in rows]), strict=True):
                self._data[place] = message
        times = [time for _, _, time in self._heads]
        self._first_ns, self._last_ns = min(self._first_ns, *times), max(self._last_ns, *times)
        front, heads, data, self._front = self._front, self._heads, self._data, b""
        self._begin_chunk()
        self._mcap.chunk(front, heads, data)

    @property
    def span_ns(self) -> tuple[int, int]:
        """Log times of the first and the last message in time, once closed; zeros without messages."""
        return (self._first_ns, self._last_ns) if any(self._counts) else (0, 0)

    def close(self) -> None:
        """Finish the file, then write metadata.yaml; OSError when there is no room, once for all."""
        if self._closed:
            return
        self._closed = True
        unfinished = self._folder / (METADATA_FILE + ".tmp")
        try:
            self._end_chunk()
            self._file.flush()
            information = bag_metadata(self._topics, self._counts, self.span_ns, self._custom)
            self._mcap.metadata("rosbag2", {"serialized_metadata": metadata_text(information)})
            self._mcap.finish(list(self._schemas.values()), self._channels, dict(enumerate(self._counts, 1)))
            self._file.flush()
            unfinished.write_text(metadata_text({"rosbag2_bagfile_information": information}))
            unfinished.rename(self._folder / METADATA_FILE)
        except OSError:
            unfinished.unlink(missing_ok=True)
            raise
        finally:
            self._file.close()
            if self._file.size <= self._begun:
                (self._folder / DATA_FILE).unlink()
