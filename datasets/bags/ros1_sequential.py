"""Read ROS 1 bags front to back, also unindexed and truncated ones (.bag.active).

Layout: http://wiki.ros.org/Bags/Format/2.0. It has no checksums, so a flipped byte inside a message is not
detected; one in the structure ends the reading or is skipped.

Writers of 2010 state a wrong length for the index records. rosbag does not read it: it goes by the number of
entries in their headers, and so does this reader.
"""

from __future__ import annotations

import struct
from collections.abc import Generator, Iterator
from contextlib import suppress
from dataclasses import dataclass, field

from turtlebag.datasets.bags.sequential import Damage, SequentialReader, State, unpacked_chunk
from turtlebag.datasets.bags.topics import TOPICS, Message, Topic, Wanted, full_type, metadata_text
from turtlebag.datasets.files import FileBytes, Unpacked, chunk_bound

ROS1_MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _HEADER, _CHUNK, _CONNECTION = 2, 3, 5, 7
_ENTRY_BYTES = {4: 12, 6: 8}
"""Bytes of an entry of the index records: of a chunk's messages, and of a chunk's topics."""
_OPERATIONS = range(2, 8)
_CHUNK_MARK = b"\x04\x00\x00\x00op=\x05"
_LONGEST_HEADER = 1 << 24


@dataclass(slots=True)
class Ros1State(State):
    """The state of a file after reading it."""

    connections: dict[int, Topic] = field(default_factory=dict)
    indexed: bool = False
    chunks: int = 0
    claimed_chunks: int = 0


class Ros1Reader(SequentialReader):
    """One ROS 1 bag."""

    MAGIC = ROS1_MAGIC
    KIND = "a ROS 1 bag of version 2.0"
    state: Ros1State

    def _begin(self, *, step_over: bool) -> None:
        self.state = Ros1State()

    def _record_messages(
        self, at: int, wanted: Wanted | None, unpacked: Unpacked
    ) -> Generator[Message, None, int]:
        header, start, size = _record(self._data, at, len(self._data))
        operation = header["op"][0]
        if operation in _ENTRY_BYTES:
            return self._after_index(header, start, size, _ENTRY_BYTES[operation])
        body = self._data[start : start + size]
        if len(body) < size and operation != _CHUNK:
            raise Damage("the file ends inside a record")
        if operation == _CHUNK:
            self.state.chunks += 1
            records = _unpacked(header, body, size)
            unpacked.add(len(records))
            yield from self._chunk(records, wanted)
            if len(body) < size:
                raise Damage("the file ends inside a chunk")
        elif operation == _CONNECTION:
            self._connection(header, body)
        elif operation == _HEADER:
            self.state.indexed = any(header.get("index_pos", b""))
            self.state.claimed_chunks = _number(header, "chunk_count")
        return start + size

    def _after_index(self, header: dict[str, bytes], start: int, size: int, entry_bytes: int) -> int:
        """Where the record after an index record begins; the stated size counts only where the entries do not
        lead to one."""
        end = len(self._data)
        if len(header.get("count", b"")) == 4:
            after = start + entry_bytes * _number(header, "count")
            with suppress(Damage):
                if after != end:
                    _record(self._data, after, end)
                return after
        if start + size > end:
            raise Damage("the file ends inside a record")
        return start + size

    def _end(self) -> None:
        state = self.state
        if not state.indexed:
            state.problems.append("the file has no index: recording was cut off (.bag.active)")
        elif state.chunks < state.claimed_chunks:
            state.problems.append(f"{state.claimed_chunks} chunks were written, {state.chunks} could be read")

    def _chunk(self, records: bytes, wanted: Wanted | None) -> Iterator[Message]:
        at, end = 0, len(records)
        connections = self.state.connections
        while at < end:
            header, start, size = _record(records, at, end)
            at = start + size
            if at > end:
                raise Damage("a chunk ends inside a record")
            operation = header["op"][0]
            if operation == _CONNECTION:
                self._connection(header, records[start:at])
            elif operation == _MESSAGE:
                connection = connections.get(_number(header, "conn"))
                if connection is None:
                    raise Damage("a message of an unknown topic")
                if wanted is None or wanted(connection):
                    time = _number(header, "time", "<Q")
                    seconds, nanoseconds = time & 0xFFFFFFFF, time >> 32
                    yield Message(connection, seconds * 1_000_000_000 + nanoseconds, records[start:at])

    def _connection(self, header: dict[str, bytes], body: bytes) -> None:
        number = _number(header, "conn")
        if number in self.state.connections:
            return
        details = _fields(body)
        topic, msgtype = _text(header, "topic"), full_type(_text(details, "type"))
        qos = metadata_text(TOPICS["/map"].qos()) if details.get("latching") == b"1" else ""
        text = _text(details, "message_definition")
        self.state.connections[number] = Topic(topic, msgtype, text, "ros1msg", qos, "", "ros1")

    def _next_chunk(self, at: int) -> int:
        end = len(self._data)
        while (mark := self._data.find(_CHUNK_MARK, at)) >= 0:
            for start in range(max(at, mark - 48), mark):
                try:
                    header, _, size = _record(self._data, start, end)
                except Damage:
                    continue
                if header.get("op") == bytes([_CHUNK]) and "compression" in header and size:
                    return start
            at = mark + 1
        return end


def _record(data: bytes | FileBytes, at: int, end: int) -> tuple[dict[str, bytes], int, int]:
    """Header fields, start and size of the data of a record."""
    if at + 4 > end:
        raise Damage("the file ends inside a record")
    length = int.from_bytes(data[at : at + 4], "little")
    start = at + 4 + length
    if length > _LONGEST_HEADER or start + 4 > end:
        raise Damage("the file ends inside a record, or its length is wrong")
    header = _fields(data[at + 4 : start])
    if len(header.get("op", b"")) != 1 or header["op"][0] not in _OPERATIONS:
        raise Damage("unknown kind of record")
    return header, start + 4, int.from_bytes(data[start : start + 4], "little")


def _fields(data: bytes) -> dict[str, bytes]:
    fields, at, end = {}, 0, len(data)
    while at < end:
        if at + 4 > end:
            raise Damage("a header is truncated")
        (size,) = struct.unpack_from("<I", data, at)
        name, mark, value = data[at + 4 : at + 4 + size].partition(b"=")
        if not mark or at + 4 + size > end:
            raise Damage("a header field without a value")
        fields[name.decode("ascii", "replace")] = value
        at += 4 + size
    return fields


def _number(header: dict[str, bytes], name: str, code: str = "<I") -> int:
    value = header.get(name, b"")
    if len(value) != struct.calcsize(code):
        raise Damage(f"no {name} in a header")
    return int(struct.unpack(code, value)[0])


def _text(header: dict[str, bytes], name: str) -> str:
    if name not in header:
        raise Damage(f"no {name} in a header")
    return header[name].decode("utf-8", "replace")


def _unpacked(header: dict[str, bytes], body: bytes, size: int) -> bytes:
    """Records of a chunk; of a cut, uncompressed one what is there."""
    compression = _text(header, "compression")
    if compression == "none":
        return body
    if len(body) < size:
        raise Damage("the file ends inside a compressed chunk")
    claimed = _number(header, "size")
    if claimed > chunk_bound(size):
        raise Damage("a chunk has an impossible size")
    return unpacked_chunk(compression, body, claimed)
