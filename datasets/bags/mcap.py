"""Writing MCAP files in small chunks: whatever was flushed survives a crash of the writer.

Layout: https://mcap.dev/spec. Chunks are zstd-compressed and carry a CRC; index, statistics and the
end magic come only with `close`, so an unfinished file can never pass for a whole one.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from pathlib import Path

import zstandard

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(11, 16)

CHUNK_BYTES = 128 * 1024
"""A chunk is closed when its content has this size ..."""
CHUNK_NS = 1_000_000_000
"""... or spans this time, whichever comes first."""

HEAD = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<BQHIQQ")
CHUNK_HEAD = struct.Struct("<QQQI")
FOOTER_BODY = struct.Struct("<QQI")


def _sized(data: bytes) -> bytes:
    return struct.pack("<I", len(data)) + data


def _text(value: str) -> bytes:
    return _sized(value.encode())


def _map(items: Mapping[str, str]) -> bytes:
    return _sized(b"".join(_text(key) + _text(value) for key, value in items.items()))


def packed_record(opcode: int, body: bytes) -> bytes:
    """A record with its opcode and length before it."""
    return HEAD.pack(opcode, len(body)) + body


class McapWriter:
    """One MCAP file being written. Log times are nanoseconds."""

    def __init__(self, path: Path, *, compression: str = "zstd") -> None:
        if compression not in ("", "zstd"):
            raise ValueError(f"chunk compression must be '' or 'zstd', not {compression!r}")
        self._file = path.open("xb", buffering=0)
        self._compression = compression
        self._compressor = zstandard.ZstdCompressor(level=1, write_content_size=True)
        self._position = 0
        self._crc = 0
        self._schemas: list[bytes] = []
        self._channels: list[bytes] = []
        self._chunk_indices: list[bytes] = []
        self._metadata_indices: list[bytes] = []
        self._counts: list[int] = []
        self._start_ns: int | None = None
        self._end_ns = 0
        self._first_ns: int | None = None
        self._new_chunk()
        self._append(MAGIC + packed_record(HEADER, _text("ros2") + _text("turtlebag")))

    @property
    def counts(self) -> list[int]:
        """Messages written so far, by channel in order of registration."""
        return list(self._counts)

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last log time; (0, 0) without messages."""
        return (0, 0) if self._start_ns is None else (self._start_ns, self._end_ns)

    def add_schema(self, name: str, text: str, encoding: str = "ros2msg") -> int:
        """Register a message definition; returns its id."""
        number = len(self._schemas) + 1
        body = struct.pack("<H", number) + _text(name) + _text(encoding) + _text(text)
        self._schemas.append(packed_record(SCHEMA, body))
        self._add_part(self._schemas[-1])
        return number

    def add_channel(self, topic: str, schema: int, metadata: Mapping[str, str], encoding: str = "cdr") -> int:
        """Register a topic; returns its id."""
        number = len(self._channels) + 1
        body = struct.pack("<HH", number, schema) + _text(topic) + _text(encoding) + _map(metadata)
        self._channels.append(packed_record(CHANNEL, body))
        self._counts.append(0)
        self._add_part(self._channels[-1])
        return number

    def write(self, channel: int, log_time_ns: int, data: bytes) -> None:
        """Append one message; the chunk goes to disk when it is full."""
        size = len(data)
        count = self._counts[channel - 1]
        self._parts.append(MESSAGE_HEAD.pack(MESSAGE, size + 22, channel, count, log_time_ns, log_time_ns))
        self._parts.append(data)
        index = self._index.get(channel)
        if index is None:
            index = self._index[channel] = []
            if self._first_ns is None:
                self._first_ns = log_time_ns
        index.append(log_time_ns)
        index.append(self._size)
        self._size += size + 31
        self._counts[channel - 1] = count + 1
        if self._size >= CHUNK_BYTES or abs(log_time_ns - (self._first_ns or 0)) >= CHUNK_NS:
            self.flush()

    def flush(self) -> None:
        """Hand the chunk in progress to the operating system."""
        if not self._parts:
            return
        records = b"".join(self._parts)
        packed = self._compressor.compress(records) if self._compression else records
        times = [time for index in self._index.values() for time in index[::2]]
        start, end = (min(times), max(times)) if times else (0, 0)
        body = CHUNK_HEAD.pack(start, end, len(records), zlib.crc32(records))
        body += _text(self._compression) + struct.pack("<Q", len(packed)) + packed
        chunk = packed_record(CHUNK, body)
        parts, offsets, position = [chunk], [], self._position + len(chunk)
        for channel, index in self._index.items():
            entries = struct.pack(f"<{len(index)}Q", *index)
            parts.append(packed_record(MESSAGE_INDEX, struct.pack("<H", channel) + _sized(entries)))
            offsets.append(struct.pack("<HQ", channel, position))
            position += len(parts[-1])
        index_size = position - self._position - len(chunk)
        self._chunk_indices.append(
            packed_record(
                CHUNK_INDEX,
                struct.pack("<QQQQ", start, end, self._position, len(chunk))
                + _sized(b"".join(offsets))
                + struct.pack("<Q", index_size)
                + _text(self._compression)
                + struct.pack("<QQ", len(packed), len(records)),
            )
        )
        self._append(b"".join(parts))
        if times:
            self._start_ns = start if self._start_ns is None else min(self._start_ns, start)
            self._end_ns = max(self._end_ns, end)
        self._new_chunk()

    def add_metadata(self, name: str, items: Mapping[str, str]) -> None:
        """Write a metadata record, after what was given so far."""
        self.flush()
        record = packed_record(METADATA, _text(name) + _map(items))
        place = struct.pack("<QQ", self._position, len(record))
        self._metadata_indices.append(packed_record(METADATA_INDEX, place + _text(name)))
        self._append(record)

    def close(self) -> None:
        """Write the index and the end magic, and close the file."""
        self.flush()
        self._append(packed_record(DATA_END, struct.pack("<I", self._crc)))
        self._append_summary()
        self._file.close()

    def abort(self) -> None:
        """Close the file as it is, unfinished: `bag recover` can read it, nothing takes it for whole."""
        self.flush()
        self._file.close()

    def _append_summary(self) -> None:
        start, end = self.span_ns
        counts = b"".join(struct.pack("<HQ", number, count) for number, count in enumerate(self._counts, 1))
        statistics = struct.pack(
            "<QHIIIIQQ",
            sum(self._counts),
            len(self._schemas),
            len(self._channels),
            0,
            len(self._metadata_indices),
            len(self._chunk_indices),
            start,
            end,
        )
        groups = (
            (SCHEMA, self._schemas),
            (CHANNEL, self._channels),
            (STATISTICS, [packed_record(STATISTICS, statistics + _sized(counts))]),
            (CHUNK_INDEX, self._chunk_indices),
            (METADATA_INDEX, self._metadata_indices),
        )
        summary_start, summary, offsets = self._position, b"", b""
        for opcode, records in groups:
            if records:
                group = b"".join(records)
                place = struct.pack("<BQQ", opcode, summary_start + len(summary), len(group))
                offsets += packed_record(SUMMARY_OFFSET, place)
                summary += group
        footer_head = HEAD.pack(FOOTER, 20) + struct.pack("<QQ", summary_start, summary_start + len(summary))
        crc = zlib.crc32(summary + offsets + footer_head)
        self._append(summary + offsets + footer_head + struct.pack("<I", crc) + MAGIC)

    def _new_chunk(self) -> None:
        self._parts: list[bytes] = []
        self._index: dict[int, list[int]] = {}
        self._size = 0
        self._first_ns = None

    def _add_part(self, record: bytes) -> None:
        self._parts.append(record)
        self._size += len(record)

    def _append(self, data: bytes) -> None:
        view = memoryview(data)
        while view:
            view = view[self._file.write(view) :]
        self._position += len(data)
        self._crc = zlib.crc32(data, self._crc)
