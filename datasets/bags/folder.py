"""Write a rosbag2 folder: any topics, one MCAP file, metadata.yaml last."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from struct import Struct
from typing import IO, Any, Self, cast

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Message, MessageIndex
from mcap.writer import ChunkBuilder, Writer

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
_HEAD, _INDEX_HEAD = Struct("<BQHIQQ"), Struct("<BQHI")
"""Of a message: opcode, length of the rest, channel, sequence, log time, publish time; of an index: opcode,
length of the rest, channel, bytes of its rows."""
_PREFIX = 9
"""Opcode and length, which no record's length counts."""


class _Chunk(ChunkBuilder):
    """mcap's own chunk, but for messages and their indices, which are packed at once."""

    def add_message(self, message: Message) -> None:
        """Append one message."""
        channel, stamp, builder = message.channel_id, message.log_time, self.record_writer
        index = self.message_indices.get(channel)
        if index is None:
            index = self.message_indices[channel] = _Index(channel, [])
        index.records.append((stamp, builder.count))
        self.message_start_time = min(self.message_start_time, stamp) if self.num_messages else stamp
        self.message_end_time = max(self.message_end_time, stamp)
        self.num_messages += 1
        length = _HEAD.size - _PREFIX + len(message.data)
        head = Opcode.MESSAGE, length, channel, message.sequence, stamp, message.publish_time
        builder.write(_HEAD.pack(*head) + message.data)


class _Index(MessageIndex):
    """mcap's own index of a channel in a chunk, packed at once."""

    def write(self, stream: RecordBuilder) -> None:
        """Append the record."""
        rows = np.array(self.records, dtype="<u8").tobytes()
        head = _INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + len(rows), self.channel_id, len(rows))
        stream.write(head + rows)


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
        self._mcap = Writer(cast(IO[bytes], self._file), chunk_size=CHUNK_BYTES, enable_data_crcs=True)
        # the same bytes in a third of the time; an mcap without this attribute writes its own chunks
        cast(Any, self._mcap)._Writer__chunk_builder = _Chunk()
        self._mcap.start("ros2", "turtlebag")
        if custom:  # at the beginning, where a crash cannot take it away
            self._mcap.add_metadata(CUSTOM_RECORD, dict(custom))
        try:
            self._mcap.flush()
        except OSError as error:
            self._file.close()
            raise InputError(f"{folder}: cannot be written ({error.strerror})") from None
        self._folder = folder
        self._custom = dict(custom)
        self._begun = self._file.tell()
        self._topics: list[tuple[str, str, str, str]] = []
        self._counts: list[int] = []
        self._schemas: dict[tuple[str, str, str], int] = {}
        self._first_ns, self._last_ns = 1 << 64, 0
        self._flushed_ns: int | None = None
        self._closed = False

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
            self._schemas[key] = self._mcap.register_schema(msgtype, form, text.encode())
        self._topics.append((name, msgtype, qos, type_hash))
        self._counts.append(0)
        metadata = {"offered_qos_profiles": qos, "topic_type_hash": type_hash}
        return self._mcap.register_channel(name, encoding, self._schemas[key], metadata)

    def write(self, channel: int, log_time_ns: int, data: bytes) -> None:
        """Append one message; ValueError for a time that the format cannot hold."""
        if not 0 <= log_time_ns < 1 << 64:
            raise ValueError(f"{log_time_ns} ns is not a valid message time")
        if log_time_ns < self._first_ns:
            self._first_ns = log_time_ns
        if log_time_ns > self._last_ns:
            self._last_ns = log_time_ns
        if self._flushed_ns is None:
            self._flushed_ns = log_time_ns
        self._mcap.add_message(channel, log_time_ns, data, log_time_ns, self._counts[channel - 1])
        self._counts[channel - 1] += 1
        if abs(log_time_ns - self._flushed_ns) >= CHUNK_NS:
            self._mcap.flush()
            self._flushed_ns = None
        elif self._file.tell() > self._file.size:
            self._file.flush()

    @property
    def span_ns(self) -> tuple[int, int]:
        """Log times of the first and the last message in time; zeros without messages."""
        return (self._first_ns, self._last_ns) if any(self._counts) else (0, 0)

    def close(self) -> None:
        """Finish the file, then write metadata.yaml; OSError when there is no room, once for all."""
        if self._closed:
            return
        self._closed = True
        unfinished = self._folder / (METADATA_FILE + ".tmp")
        try:
            self._mcap.flush()
            information = bag_metadata(self._topics, self._counts, self.span_ns, self._custom)
            self._mcap.add_metadata("rosbag2", {"serialized_metadata": metadata_text(information)})
            self._mcap.finish()
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
