"""An MCAP file that grows by whole chunks, in records of the mcap package."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from struct import Struct
from zlib import crc32

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from turtlebag.datasets.bags.mcap_index import MAGIC
from turtlebag.datasets.growing_file import GrowingFile

_MESSAGE = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("times", "<u8", 2)]
)
"""What stands before a message's data; log and publish time are one."""
_PREFIX = 9
"""Opcode and length, which no record's length counts."""
_INDEX, _SUMMARY = Struct("<BQHI"), Struct("<BQQQ")
"""Head of a channel's index in a chunk: opcode, length of the rest, channel, bytes of its rows; and the start
of a footer, over which the summary's checksum goes on."""
MESSAGE_HEAD_BYTES = _MESSAGE.itemsize


def packed(*records: McapRecord) -> bytes:
    """Records one after the other."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()


class McapFile:
    """Writes chunks, then a summary by which readers find them; a new file begins with its header."""

    def __init__(self, file: GrowingFile) -> None:
        self._file = file
        self._crc = 0
        self._compressor = zstandard.ZstdCompressor()
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._write(MAGIC + packed(Header("ros2", "turtlebag")))

    def _write(self, data: bytes) -> None:
        self._crc = crc32(data, self._crc)
        self._file.write(data)

    def metadata(self, name: str, texts: Mapping[str, str]) -> None:
        """Texts under a name."""
        at, record = self._file.tell(), packed(Metadata(name, dict(texts)))
        self._metadata.append(MetadataIndex(at, len(record), name))
        self._write(record)

    def chunk(self, front: bytes, heads: Sequence[tuple[int, int, int]], data: Sequence[bytes]) -> None:
        """Messages, each with its (channel, sequence, time [ns]), behind records that introduce channels."""
        n = len(data)
        told = np.array(heads, dtype=np.uint64)
        head = np.empty(n, _MESSAGE)
        head["opcode"], head["channel"], head["sequence"] = Opcode.MESSAGE, told[:, 0], told[:, 1]
        head["times"] = told[:, 2:]
        head["length"] = np.fromiter(map(len, data), np.uint64, n) + (_MESSAGE.itemsize - _PREFIX)
        ends = (head["length"] + _PREFIX).cumsum()
        starts = (ends - head["length"] - _PREFIX + len(front)).astype(np.uint64)
        step, all_heads = _MESSAGE.itemsize, head.tobytes()
        pieces = [front] * (2 * n + 1)
        pieces[1::2] = [all_heads[k : k + step] for k in range(0, n * step, step)]
        pieces[2::2] = data
        content = b"".join(pieces)
        compressed = self._compressor.compress(content)
        start, end = int(told[:, 2].min()), int(told[:, 2].max())
        begun = self._file.tell()
        self._write(packed(Chunk("zstd", compressed, end, start, crc32(content), len(content))))
        indexed = self._file.tell()
        offsets = {}
        for channel in dict.fromkeys(told[:, 0].tolist()):
            own = told[:, 0] == channel
            rows = np.column_stack([told[own, 2], starts[own]]).astype("<u8").tobytes()
            offsets[channel] = self._file.tell()
            self._write(_INDEX.pack(Opcode.MESSAGE_INDEX, 6 + len(rows), channel, len(rows)) + rows)
        self._chunks.append(
            ChunkIndex(
                chunk_length=indexed - begun,
                chunk_start_offset=begun,
                compression="zstd",
                compressed_size=len(compressed),
                message_end_time=end,
                message_index_length=self._file.tell() - indexed,
                message_index_offsets=offsets,
                message_start_time=start,
                uncompressed_size=len(content),
            )
        )

    def finish(
        self, schemas: Sequence[Schema], channels: Sequence[Channel], counts: Mapping[int, int]
    ) -> None:
        """The summary; `counts` are the messages of each channel."""
        self._write(packed(DataEnd(self._crc)))
        begun = self._file.tell()
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(channels),
            channel_message_counts={channel: count for channel, count in counts.items() if count},
            chunk_count=len(self._chunks),
            message_count=sum(counts.values()),
            message_end_time=max((chunk.message_end_time for chunk in self._chunks), default=0),
            message_start_time=min((chunk.message_start_time for chunk in self._chunks), default=0),
            metadata_count=len(self._metadata),
            schema_count=len(schemas),
        )
        groups: dict[Opcode, Sequence[McapRecord]] = {
            Opcode.SCHEMA: schemas,
            Opcode.CHANNEL: channels,
            Opcode.STATISTICS: [statistics],
            Opcode.CHUNK_INDEX: self._chunks,
            Opcode.METADATA_INDEX: self._metadata,
        }
        summary, offsets = b"", []
        for opcode, records in groups.items():
            group = packed(*records)
            offsets.append(SummaryOffset(opcode, begun + len(summary), len(group)))
            summary += group
        behind = begun + len(summary)
        summary += packed(*offsets)
        crc = crc32(_SUMMARY.pack(Opcode.FOOTER, 20, begun, behind), crc32(summary))
        self._file.write(summary + packed(Footer(begun, behind, crc)) + MAGIC)
