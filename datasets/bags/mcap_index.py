"""Records of MCAP files, and the index at the end of one. Layout: https://mcap.dev/spec."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from io import BytesIO
from typing import TypeVar

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, MetadataIndex, Schema, Statistics

from turtlebag.datasets.bags.sequential import Damage
from turtlebag.datasets.bags.topics import Topic, full_type

Read = Callable[[int, int], bytes]
"""Bytes of a file from the first offset up to the second."""
MAGIC = b"\x89MCAP0\r\n"
"""First and last bytes of a file; the library has it too, in modules that are slow to import."""
HEAD = struct.Struct("<BQ")
"""What a record begins with: its kind, and the size of its body."""
FOOTER_SIZE = HEAD.size + 20
TAIL = 256 << 10
"""The index of most files is within the last bytes."""
Record = TypeVar("Record")


class _Body(ReadDataStream):
    """The body of a record; running over its end is Damage, where the library gives less than asked for."""

    def __init__(self, body: bytes) -> None:
        super().__init__(BytesIO(body))
        self._size = len(body)

    def read(self, length: int) -> bytes:
        if length > self._size - self._count:
            raise Damage("a record ends too early")
        self._count += length
        return self._stream.read(length)


def parsed(kind: Callable[[ReadDataStream], Record], body: bytes) -> Record:
    """The record that a body is, by the `read` of its kind; Damage when it is not exactly one."""
    stream = _Body(body)
    try:
        record = kind(stream)
    except UnicodeDecodeError:
        raise Damage("a text is not UTF-8") from None
    if stream.count != len(body):
        raise Damage("a record is longer than its content")
    return record


@dataclass(slots=True)
class Introduced:
    """Schemas - type, definition, format - and topics by the numbers that a file gives them."""

    schemas: dict[int, tuple[str, str, str]] = field(default_factory=dict)
    channels: dict[int, Topic] = field(default_factory=dict)

    def add(self, opcode: int, body: bytes) -> None:
        """Add a schema or channel record; Damage if it is neither."""
        if opcode == Opcode.SCHEMA:
            number, schema = parsed(_schema, body)
            self.schemas[number] = schema
            return
        channel = parsed(Channel.read, body)
        qos, type_hash = (
            channel.metadata.get(key, "") for key in ("offered_qos_profiles", "topic_type_hash")
        )
        known = self.schemas.get(channel.schema_id, ("", "", ""))
        topic = Topic(channel.topic, *known, qos, type_hash, channel.message_encoding)
        self.channels.setdefault(channel.id, topic)


def _schema(stream: ReadDataStream) -> tuple[int, tuple[str, str, str]]:
    schema = Schema.read(stream)
    return schema.id, (full_type(schema.name), schema.data.decode(), schema.encoding)


@dataclass(slots=True)
class Index:
    """The index at the end of an MCAP file: schemas and channels, their records as bytes, and all offsets."""

    introduced: Introduced = field(default_factory=Introduced)
    records: list[bytes] = field(default_factory=list)
    chunks: list[ChunkIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    messages: int | None = None


def read_index(read: Read, size: int) -> Index:
    """The index of a file of `size` bytes, empty where it has none; Damage when its end is damaged."""
    begin = max(0, size - TAIL)
    tail = read(begin, size)
    footer = len(tail) - len(MAGIC) - FOOTER_SIZE
    if footer < 0 or not tail.endswith(MAGIC) or tail[footer] != Opcode.FOOTER:
        raise Damage("the file does not end as an mcap does")
    said = parsed(Footer.read, tail[footer + HEAD.size : -len(MAGIC)])
    start = said.summary_start
    if not start:
        return Index()
    if not len(MAGIC) < start <= begin + footer:
        raise Damage("the file has no index")
    if start < begin:
        tail, begin, footer = read(start, begin) + tail, start, footer + begin - start
    if said.summary_crc and said.summary_crc != zlib.crc32(tail[start - begin : -len(MAGIC) - 4]):
        raise Damage("the index is damaged")
    index, at = Index(), start - begin
    while at + HEAD.size <= footer:
        opcode, length = HEAD.unpack_from(tail, at)
        following = at + HEAD.size + length
        _note(index, opcode, tail[at:following])
        at = following
    return index


def _note(index: Index, opcode: int, record: bytes) -> None:
    body = record[HEAD.size :]
    if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
        index.introduced.add(opcode, body)
        index.records.append(record)
    elif opcode == Opcode.CHUNK_INDEX:
        index.chunks.append(parsed(ChunkIndex.read, body))
    elif opcode == Opcode.METADATA_INDEX:
        index.metadata.append(parsed(MetadataIndex.read, body))
    elif opcode == Opcode.STATISTICS:
        index.messages = parsed(Statistics.read, body).message_count
