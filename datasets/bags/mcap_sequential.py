"""Read MCAP files front to back: a chunk's checksum is verified before any of its messages is returned."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Generator, Iterator
from contextlib import suppress
from dataclasses import dataclass, field

from mcap.opcode import Opcode
from mcap.records import Chunk, DataEnd, Header, Metadata

from turtlebag.datasets.bags.mcap_index import HEAD, MAGIC, Introduced, parsed, read_index
from turtlebag.datasets.bags.sequential import Damage, SequentialReader, State, unpacked_chunk
from turtlebag.datasets.bags.topics import Message, Wanted
from turtlebag.datasets.files import Unpacked, chunk_bound

_LAST_OPCODE = Opcode.DATA_END
_MESSAGE = struct.Struct("<BQHIQQ")
"""Head of a message: the record's, channel, sequence, log time, time of publishing."""


@dataclass(slots=True)
class McapState(State):
    """The state of a file after reading it."""

    introduced: Introduced = field(default_factory=Introduced)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    complete: bool = False
    ended: bool = False
    messages: int = 0
    claimed: int | None = None


class McapReader(SequentialReader):
    """One MCAP file."""

    MAGIC = MAGIC
    KIND = "an MCAP file"
    state: McapState

    def _begin(self, *, step_over: bool) -> None:
        self.state = McapState()
        if step_over:  # topics from the end of the file, should the chunk that introduced them be damaged
            with suppress(Damage):
                self.state.introduced = read_index(self._read, len(self._data)).introduced

    def _record_messages(
        self, at: int, wanted: Wanted | None, unpacked: Unpacked
    ) -> Generator[Message, None, int]:
        opcode, body, following = self._record(at)
        if opcode == Opcode.DATA_END:
            self._finish(at, body)
            return len(self._data)
        if opcode == Opcode.CHUNK:
            records = _unpack_chunk(body)
            unpacked.add(len(records))
            yield from self._chunk_messages(records, wanted)
        elif opcode == Opcode.MESSAGE:
            yield from self._chunk_messages(self._data[at:following], wanted)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self.state.introduced.add(opcode, body)
        elif opcode == Opcode.METADATA:
            metadata = parsed(Metadata.read, body)
            self.state.metadata[metadata.name] = metadata.metadata
        elif opcode == Opcode.HEADER:
            parsed(Header.read, body)
        return following

    def _end(self) -> None:
        if not self.state.ended:
            self.state.problems.append(
                f"the file ends without its index, after {len(self._data)} bytes: the recording was cut off; "
                "`turtlebag bag recover` makes it a complete bag"
            )

    def leading_metadata(self, name: str) -> dict[str, str]:
        """The metadata record before the messages; empty without one."""
        at = len(MAGIC)
        with suppress(Damage):
            while at < len(self._data):
                opcode, body, at = self._record(at)
                if opcode in (Opcode.CHUNK, Opcode.MESSAGE, Opcode.DATA_END):
                    break
                if opcode == Opcode.METADATA and (found := parsed(Metadata.read, body)).name == name:
                    return found.metadata
        return {}

    def _read(self, start: int, stop: int) -> bytes:
        return self._data[start:stop]

    def _record(self, at: int) -> tuple[int, bytes, int]:
        if at + HEAD.size > len(self._data):
            raise Damage("the file ends inside a record")
        opcode, size = HEAD.unpack(self._data[at : at + HEAD.size])
        start = at + HEAD.size
        if size > len(self._data) - start:
            raise Damage("the file ends inside a record, or its length is wrong")
        if opcode == 0 or _LAST_OPCODE < opcode < 0x80:
            raise Damage(f"unknown record type {opcode}")
        if opcode == Opcode.FOOTER:
            raise Damage("the end comes before the end of the data")
        return opcode, self._data[start : start + size], start + size

    def _next_chunk(self, at: int) -> int:
        while (at := self._data.find(bytes([Opcode.CHUNK]), at)) >= 0:
            # The length of the compression's name is a cheap first test: few bytes are copied in vain.
            name_size = self._data[at + 37 : at + 41]
            if name_size in (b"\0\0\0\0", b"\3\0\0\0", b"\4\0\0\0"):
                with suppress(Damage):
                    _unpack_chunk(self._record(at)[1])
                    return at
            at += 1
        return len(self._data)

    def _chunk_messages(self, records: bytes, wanted: Wanted | None) -> Iterator[Message]:
        state, channels = self.state, self.state.introduced.channels
        choice = {number: wanted is None or wanted(channel) for number, channel in channels.items()}
        at, end = 0, len(records)
        message, unpack = int(Opcode.MESSAGE), _MESSAGE.unpack_from
        while at < end:
            if records[at] == message and at + _MESSAGE.size <= end:
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
                if at > end or opcode not in (Opcode.SCHEMA, Opcode.CHANNEL):
                    raise Damage("an unexpected record in a chunk")
                state.introduced.add(opcode, records[start:at])
                for number, channel in channels.items():
                    if number not in choice:
                        choice[number] = wanted is None or wanted(channel)
            else:
                raise Damage("a chunk ends inside a record")

    def _finish(self, at: int, body: bytes) -> None:
        """Compare what was read with what the end of the file says of it."""
        state = self.state
        crc = parsed(DataEnd.read, body).data_section_crc
        state.ended = True
        if crc and crc != self._data.crc32(at):
            state.problems.append(
                "the file's checksum does not match: something outside the messages changed"
            )
        try:
            state.claimed = read_index(self._read, len(self._data)).messages
            state.complete = True
        except Damage:
            state.problems.append("the index at the end of the file is damaged")
            return
        if state.claimed is not None and state.claimed != state.messages:
            state.problems.append(f"{state.claimed} messages were written, {state.messages} could be read")


def _unpack_chunk(body: bytes) -> bytes:
    """Verified records of a chunk."""
    chunk = parsed(Chunk.read, body)
    start, end, size = chunk.message_start_time, chunk.message_end_time, chunk.uncompressed_size
    if start > end or size > chunk_bound(len(body)):
        raise Damage("a chunk with an invalid header")
    records = chunk.data if chunk.compression == "" else unpacked_chunk(chunk.compression, chunk.data, size)
    if len(records) != size:
        raise Damage("a chunk has the wrong size")
    if chunk.uncompressed_crc and chunk.uncompressed_crc != zlib.crc32(records):
        raise Damage("the checksum of a chunk does not match")
    return records
