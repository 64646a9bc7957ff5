"""Reading MCAP front to back, trusting nothing: damage ends the data or is stepped over, and is named.

The index at the end of a file is not used for reading, so unfinished files read as far as they go. Chunk
checksums are verified before a single message of the chunk is given out.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import lz4.frame
import zstandard

from turtlebag.datasets.bags.mcap import (
    CHANNEL,
    CHUNK,
    CHUNK_HEAD,
    DATA_END,
    FOOTER,
    FOOTER_BODY,
    HEAD,
    HEADER,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    METADATA,
    SCHEMA,
    STATISTICS,
)
from turtlebag.datasets.bags.messages import Message, Topic, Wanted, full_type
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.files import FileBytes, Unpacked, chunk_bound

_LAST_OPCODE = DATA_END


class Damage(Exception):
    """A record that cannot be what was written."""


@dataclass(slots=True)
class McapState:
    """What is known of a file after reading it: its parts, and what was wrong."""

    channels: dict[int, Topic] = field(default_factory=dict)
    schemas: dict[int, tuple[str, str, str]] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    stopped: bool = False
    complete: bool = False
    messages: int = 0
    claimed: int | None = None


class Fields:
    """Cursor over the body of a record; running over its end is Damage."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def take(self, size: int) -> bytes:
        """The next bytes."""
        piece = self.data[self.at : self.at + size]
        if len(piece) != size:
            raise Damage("a record ends too early")
        self.at += size
        return piece

    def number(self, code: str) -> int:
        """A number of the kind that `struct` calls so."""
        return int(struct.unpack("<" + code, self.take(struct.calcsize("<" + code)))[0])

    def text(self) -> str:
        """A text with its length before it."""
        try:
            return self.take(self.number("I")).decode()
        except UnicodeDecodeError:
            raise Damage("a text is not UTF-8") from None

    def map(self) -> dict[str, str]:
        """Texts by text."""
        inner = Fields(self.take(self.number("I")))
        items = {}
        while inner.at < len(inner.data):
            key = inner.text()
            items[key] = inner.text()
        return items

    def end(self) -> None:
        """Damage unless everything was taken."""
        if self.at != len(self.data):
            raise Damage("a record is longer than its content")


def register(state: McapState, opcode: int, body: bytes) -> None:
    """Take note of a schema, a channel or metadata; check the form of the others."""
    fields = Fields(body)
    if opcode == SCHEMA:
        number = fields.number("H")
        name, encoding = fields.text(), fields.text()
        state.schemas[number] = (full_type(name), fields.text(), encoding)
    elif opcode == CHANNEL:
        number, schema = fields.number("H"), fields.number("H")
        topic, encoding, metadata = fields.text(), fields.text(), fields.map()
        qos, type_hash = (metadata.get(key, "") for key in ("offered_qos_profiles", "topic_type_hash"))
        known = state.schemas.get(schema, ("", "", ""))
        state.channels.setdefault(number, Topic(topic, *known, qos, type_hash, encoding))
    elif opcode == METADATA:
        name = fields.text()
        state.metadata[name] = fields.map()
    elif opcode == MESSAGE_INDEX:
        fields.number("H")
        fields.take(fields.number("I"))
    elif opcode == HEADER:
        fields.text()
        fields.text()
    else:
        return
    fields.end()


class McapScan:
    """One file, read sequentially; `state` fills while messages are drawn."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.state = McapState()
        self._data = FileBytes(path)
        if self._data[: len(MAGIC)] != MAGIC:
            raise InputError(f"{path}: not an MCAP file (its first bytes are damaged or of another format)")

    def messages(self, wanted: Wanted | None = None, *, step_over: bool = False) -> Iterator[Message]:
        """Messages of the wanted topics in file order.

        At the first damage reading stops, or with `step_over` goes on at the next record that is whole.
        """
        self.state = state = McapState()
        if step_over:
            self._register_from_summary()
        at, end = len(MAGIC), len(self._data)
        unpacked = Unpacked(self.path, end)
        while at < end:
            try:
                opcode, body, following = self._record(at)
                if opcode == DATA_END:
                    self._finish(at, body, following)
                    return
                if opcode == CHUNK:
                    records = _unpack_chunk(body)
                    unpacked.add(len(records))
                    yield from self._chunk_messages(records, wanted)
                elif opcode == MESSAGE:
                    yield from self._chunk_messages(self._data[at:following], wanted)
                else:
                    register(state, opcode, body)
                at = following
            except Damage as damage:
                state.problems.append(f"damaged at byte {at} of {end}: {damage}")
                state.stopped = not step_over
                if not step_over:
                    return
                at = self._next_chunk(at + 1)
        state.problems.append(
            f"the file ends without its index, after {end} bytes: the recording was cut off; "
            "`turtlebag bag recover` makes a complete bag of it"
        )

    def leading_metadata(self, name: str) -> dict[str, str]:
        """A metadata record that precedes the messages; empty when there is none."""
        at = len(MAGIC)
        try:
            while at < len(self._data):
                opcode, body, at = self._record(at)
                if opcode in (CHUNK, MESSAGE, DATA_END):
                    break
                fields = Fields(body)
                if opcode == METADATA and fields.text() == name:
                    return fields.map()
        except Damage:
            pass
        return {}

    def _record(self, at: int) -> tuple[int, bytes, int]:
        if at + HEAD.size > len(self._data):
            raise Damage("the file ends inside a record")
        opcode, size = HEAD.unpack(self._data[at : at + HEAD.size])
        start = at + HEAD.size
        if size > len(self._data) - start:
            raise Damage("the file ends inside a record, or its length is wrong")
        if opcode == 0 or _LAST_OPCODE < opcode < 0x80:
            raise Damage(f"unknown record type {opcode}")
        if opcode == FOOTER:
            raise Damage("the end comes before the end of the data")
        return opcode, self._data[start : start + size], start + size

    def _next_chunk(self, at: int) -> int:
        """Where the next chunk with a plausible head begins; the end of the file if none does."""
        while (at := self._data.find(bytes([CHUNK]), at)) >= 0:
            # The length of the compression's name is a cheap first test: few bytes are copied in vain.
            name_size = self._data[at + 37 : at + 41]
            if name_size in (b"\0\0\0\0", b"\3\0\0\0", b"\4\0\0\0"):
                try:
                    _unpack_chunk(self._record(at)[1])
                    return at
                except Damage:
                    pass
            at += 1
        return len(self._data)

    def _register_from_summary(self) -> None:
        """Topics from the end of the file, should the chunk that introduced them be the damaged one."""
        footer = len(self._data) - len(MAGIC) - HEAD.size - 20
        if footer < 0 or self._data[-len(MAGIC) :] != MAGIC or self._data[footer] != FOOTER:
            return
        try:
            at = self._index_start(footer)
            while 0 < at < footer:
                opcode, body, at = self._record(at)
                if opcode in (SCHEMA, CHANNEL):
                    register(self.state, opcode, body)
        except Damage:
            self.state.channels.clear()

    def _index_start(self, footer: int) -> int:
        """Where the footer at a place says the index lies, 0 for nowhere; Damage when that has changed."""
        body = footer + HEAD.size
        start, _, crc = FOOTER_BODY.unpack(self._data[body : body + FOOTER_BODY.size])
        if start and crc and crc != zlib.crc32(self._data[start : body + 16]):
            raise Damage("the index is damaged")
        return int(start)

    def _chunk_messages(self, records: bytes, wanted: Wanted | None) -> Iterator[Message]:
        state, channels = self.state, self.state.channels
        choice = {number: wanted is None or wanted(channel) for number, channel in channels.items()}
        at, end = 0, len(records)
        unpack = MESSAGE_HEAD.unpack_from
        while at < end:
            if records[at] == MESSAGE and at + MESSAGE_HEAD.size <= end:
                _, size, number, _, log_time, _ = unpack(records, at)
                start, at = at + 31, at + 9 + size
                channel = channels.get(number)
                if channel is None or at > end or size < 22:
                    raise Damage("a message of an unknown topic, or too long")
                state.messages += 1
                if choice[number]:
                    yield Message(channel, log_time, records[start:at])
            elif at + HEAD.size <= end:
                opcode, size = HEAD.unpack_from(records, at)
                start, at = at + HEAD.size, at + HEAD.size + size
                if at > end or opcode not in (SCHEMA, CHANNEL):
                    raise Damage("an unexpected record in a chunk")
                register(state, opcode, records[start:at])
                for number, channel in channels.items():
                    if number not in choice:
                        choice[number] = wanted is None or wanted(channel)
            else:
                raise Damage("a chunk ends inside a record")

    def _finish(self, at: int, body: bytes, following: int) -> None:
        """Compare what was read with what the end of the file says of it."""
        state = self.state
        fields = Fields(body)
        crc = fields.number("I")
        if crc and crc != self._data.crc32(at):
            state.problems.append(
                "the file's checksum does not match: something outside the messages changed"
            )
        state.complete = self._data[-len(MAGIC) :] == MAGIC
        try:
            while state.complete and self._data[following] != FOOTER:
                opcode, record, following = self._record(following)
                if opcode == STATISTICS:
                    state.claimed = Fields(record).number("Q")
            self._index_start(following)
        except (Damage, IndexError, struct.error):
            state.complete = False
        if not state.complete:
            state.problems.append("the index at the end of the file is damaged")
        elif state.claimed is not None and state.claimed != state.messages:
            state.problems.append(f"{state.claimed} messages were written, {state.messages} could be read")


def _unpack_chunk(body: bytes) -> bytes:
    """Verified records of a chunk."""
    if len(body) < CHUNK_HEAD.size:
        raise Damage("a chunk without a head")
    start, end, size, crc = CHUNK_HEAD.unpack_from(body)
    if start > end or size > chunk_bound(len(body)):
        raise Damage("a chunk with an impossible head")
    fields = Fields(body)
    fields.at = CHUNK_HEAD.size
    compression = fields.text()
    packed = fields.take(fields.number("Q"))
    fields.end()
    records = _decompress(compression, packed, size)
    if len(records) != size:
        raise Damage("a chunk of the wrong size")
    if crc and crc != zlib.crc32(records):
        raise Damage("the checksum of a chunk does not match")
    return records


def _decompress(compression: str, packed: bytes, size: int) -> bytes:
    try:
        if compression == "":
            return packed
        if compression == "zstd":
            if zstandard.frame_content_size(packed) not in (size, -1):
                raise Damage("a chunk of the wrong size")
            return zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
        if compression == "lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1))
    except (zstandard.ZstdError, RuntimeError, MemoryError, ValueError) as error:
        raise Damage(f"a chunk cannot be unpacked ({' '.join(str(error).split())[:80]})") from None
    raise Damage(f"unknown compression {compression[:20]!r}")
