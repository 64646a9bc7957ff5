"""The part of an mcap that holds some of its topics, read by ranges: its index, then the chunks that matter.

What comes out is an mcap of these chunks, as they are, with all topics and metadata of the file. Damage is
raised where the index does not say enough; then the file has to be read whole.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from turtlebag.datasets.bags.mcap import (
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    FOOTER_BODY,
    HEAD,
    HEADER,
    MAGIC,
    METADATA_INDEX,
    SCHEMA,
    packed_record,
)
from turtlebag.datasets.bags.mcap_scan import Damage, Fields, McapState, register
from turtlebag.datasets.bags.messages import Topic

Read = Callable[[int, int], bytes]
"""Bytes of the file from the first offset up to the second."""
Choice = Callable[[Mapping[int, Topic]], Collection[int]]
"""Which of the channels, by their numbers, are asked for."""
_TAIL = 256 << 10
"""The index of most files is within the last bytes."""
_GAP = 32 << 10
"""Two chunks no further apart than this are read at once, with what is between them."""
_PIECE = 8 << 20


class _Span(NamedTuple):
    start: int
    size: int


@dataclass
class _Index:
    """The end of an mcap: records of schemas and channels as they are, and where everything lies."""

    introduced: list[bytes] = field(default_factory=list)
    state: McapState = field(default_factory=McapState)
    chunks: list[tuple[_Span, set[int]]] = field(default_factory=list)
    metadata: list[_Span] = field(default_factory=list)


def partial_mcap(read: Read, size: int, choose: Choice) -> Iterator[bytes]:
    """The pieces of an mcap that holds all messages of the chosen channels; Damage before the first of them
    when the file of `size` bytes has no index that says where they are."""
    index = _read_index(read, size)
    if not index.chunks or not index.state.channels:
        raise Damage("the index names no chunks or no topics")
    chosen = set(choose(index.state.channels))
    # A writer may leave out which channels a chunk holds.
    chunks = [span for span, channels in index.chunks if not channels or channels & chosen]
    yield MAGIC + packed_record(HEADER, struct.pack("<II", 0, 0)) + b"".join(index.introduced)
    for span in index.metadata:
        yield read(span.start, span.start + span.size)
    for spans in _grouped(sorted(chunks)):
        first, last = spans[0], spans[-1]
        piece = read(first.start, last.start + last.size)
        for span in spans:
            at = span.start - first.start
            chunk = piece[at : at + span.size]
            if len(chunk) != span.size or HEAD.unpack_from(chunk) != (CHUNK, span.size - HEAD.size):
                raise Damage("a chunk does not lie where the index says")
            yield chunk
    yield packed_record(DATA_END, bytes(4)) + packed_record(FOOTER, bytes(20)) + MAGIC


def _grouped(spans: list[_Span]) -> Iterator[list[_Span]]:
    """Spans in order, together where they are close."""
    group: list[_Span] = []
    for span in spans:
        end = group[-1].start + group[-1].size if group else span.start
        if group and (span.start - end > _GAP or span.start + span.size - group[0].start > _PIECE):
            yield group
            group = []
        group.append(span)
    if group:
        yield group


def _read_index(read: Read, size: int) -> _Index:
    begin = max(0, size - _TAIL)
    tail = read(begin, size)
    footer = len(tail) - len(MAGIC) - FOOTER_BODY.size - HEAD.size
    if footer < 0 or not tail.endswith(MAGIC) or tail[footer] != FOOTER:
        raise Damage("the file does not end as an mcap does")
    start, _, crc = FOOTER_BODY.unpack_from(tail, footer + HEAD.size)
    if not len(MAGIC) < start <= begin + footer:
        raise Damage("the file has no index")
    if start < begin:
        tail, begin, footer = read(start, begin) + tail, start, footer + begin - start
    if crc and crc != zlib.crc32(tail[start - begin : footer + HEAD.size + 16]):
        raise Damage("the index is damaged")
    index, at = _Index(), start - begin
    try:
        while at < footer:
            opcode, length = HEAD.unpack_from(tail, at)
            following = at + HEAD.size + length
            _note(index, opcode, tail[at:following])
            at = following
    except struct.error:
        raise Damage("the index is damaged") from None
    return index


def _note(index: _Index, opcode: int, record: bytes) -> None:
    body = record[HEAD.size :]
    if opcode in (SCHEMA, CHANNEL):
        register(index.state, opcode, body)
        index.introduced.append(record)
    elif opcode == CHUNK_INDEX:
        fields = Fields(body)
        fields.take(16)
        span = _Span(fields.number("Q"), fields.number("Q"))
        offsets = fields.take(fields.number("I"))
        index.chunks.append((span, {number for number, _ in struct.iter_unpack("<HQ", offsets)}))
    elif opcode == METADATA_INDEX:
        fields = Fields(body)
        index.metadata.append(_Span(fields.number("Q"), fields.number("Q")))
