"""Read some topics of a remote mcap by byte ranges: the index first, then the chunks with these topics.

The result is an mcap of these chunks, unchanged, with all topics and metadata of the file. Damage is
raised if the index is insufficient; then the whole file has to be read.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import ChunkIndex, DataEnd, Footer, Header

from turtlebag.datasets.bags.mcap_index import HEAD, MAGIC, Read, read_index
from turtlebag.datasets.bags.sequential import Damage
from turtlebag.datasets.bags.topics import Topic

Choice = Callable[[Mapping[int, Topic]], Collection[int]]
"""Which of the channels, by their numbers, are asked for."""
_GAP = 32 << 10
"""Two chunks no further apart than this are read at once, with what is between them."""
_PIECE = 8 << 20


def partial_mcap(read: Read, size: int, choose: Choice) -> Iterator[bytes]:
    """The pieces of an mcap that holds all messages of the chosen channels; Damage before the first of them
    when the file of `size` bytes has no index that says where they are."""
    index = read_index(read, size)
    if not index.chunks or not index.introduced.channels:
        raise Damage("the index names no chunks or no topics")
    chosen = set(choose(index.introduced.channels))
    # A writer may leave out which channels a chunk holds.
    chunks = [
        chunk
        for chunk in sorted(index.chunks, key=lambda chunk: chunk.chunk_start_offset)
        if not chunk.message_index_offsets or chunk.message_index_offsets.keys() & chosen
    ]
    builder = RecordBuilder()
    Header("", "").write(builder)
    yield MAGIC + builder.end() + b"".join(index.records)
    for note in index.metadata:
        yield read(note.offset, note.offset + note.length)
    for group in _grouped(chunks):
        first = group[0].chunk_start_offset
        piece = read(first, group[-1].chunk_start_offset + group[-1].chunk_length)
        for span in group:
            at = span.chunk_start_offset - first
            chunk = piece[at : at + span.chunk_length]
            whole = len(chunk) == span.chunk_length > HEAD.size
            if not whole or HEAD.unpack_from(chunk) != (Opcode.CHUNK, span.chunk_length - HEAD.size):
                raise Damage("a chunk does not lie where the index says")
            yield chunk
    DataEnd(0).write(builder)
    Footer(0, 0, 0).write(builder)
    yield builder.end() + MAGIC


def _grouped(chunks: list[ChunkIndex]) -> Iterator[list[ChunkIndex]]:
    """Chunks in order, together where they are close."""
    group: list[ChunkIndex] = []
    for chunk in chunks:
        start, end = chunk.chunk_start_offset, chunk.chunk_start_offset + chunk.chunk_length
        if group:
            gap = start - group[-1].chunk_start_offset - group[-1].chunk_length
            if gap > _GAP or end - group[0].chunk_start_offset > _PIECE:
                yield group
                group = []
        group.append(chunk)
    if group:
        yield group
