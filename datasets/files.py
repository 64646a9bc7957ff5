"""Read input files: plain files only, unchanged while they are read, decompressed within limits."""

from __future__ import annotations

import bz2
import hashlib
import os
import stat
import weakref
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import zstandard

from turtlebag.datasets.errors import InputError

HARMLESS_BYTES = 64 << 20
"""Files up to this unpacked size are always unpacked."""
GREATEST_RATIO = 100
"""What is larger may be this many times its packed size ..."""
GREATEST_BYTES = 2 << 30
"""... and this large at most: it lies in memory."""
CHUNK_RATIO = 1000
"""A chunk of a bag may be this many times its packed size where it is not harmless: empty pictures are."""
CHUNK_BYTES = 1 << 30
"""Most that one chunk may hold, and all chunks of a file too that is not a `CHUNK_RATIO`th of it."""
JUNK = (".DS_Store", "Thumbs.db")
"""Files that file managers leave in folders that somebody looks at: nobody's input and nobody's output."""
PIECE_BYTES = 1 << 20
MOST_FILES = 100_000


def sha256_file(path: Path) -> str:
    """Hex sha256 of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


Signature = tuple[int, int, int, int]
"""What changes when a file is written to or replaced: device, inode, size and time of change [ns]."""


def signatures(path: Path, most: int = MOST_FILES) -> dict[Path, Signature]:
    """Signature of a file, or of every file below a folder.

    InputError for a pipe or a device, which a reader would wait for, and for a folder of more than `most`
    files.
    """
    found = {}
    below = (Path(place, name) for place, _, names in os.walk(path) for name in names if name not in JUNK)
    for file in below if path.is_dir() else (path,):
        try:
            status = file.stat()
        except OSError:
            continue  # a link to nowhere; whoever reads it says so
        if stat.S_ISREG(status.st_mode):
            found[file] = status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns
        elif not (stat.S_ISDIR(status.st_mode) or stat.S_ISSOCK(status.st_mode)):
            raise InputError(f"{file}: is a pipe or a device; give a plain file")
        if len(found) > most:
            raise InputError(f"{path}: contains more than {most} files; name the right folder")
    return found


@contextmanager
def unchanged(path: Path) -> Iterator[None]:
    """InputError when a file, or one below a folder, is not the same at the end as at the beginning."""
    before = signatures(path)
    yield
    require_same(path, before)


def require_same(path: Path, before: dict[Path, Signature]) -> None:
    """InputError that names a file of `path` whose signature is not the one it had before."""
    now = signatures(path) if os.path.exists(path) else {}
    changed = sorted({file for file, _ in before.items() ^ now.items()})
    if changed:
        raise _changed(changed[0])


def _changed(path: Path) -> InputError:
    return InputError(f"{path}: changed while it was read; run the command again when nothing writes to it")


def opened_plain(path: Path) -> BinaryIO:
    """Open a plain file for reading; InputError for anything else. Never blocks, as a pipe would."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise InputError(f"{path}: is not a plain file")
    return os.fdopen(descriptor, "rb", buffering=0)


class FileBytes:
    """The bytes of a file, sliced as a `bytes` object is and read on demand, `piece` bytes or more at a time.
    Unlike with a memory map, a file that is truncated meanwhile is an InputError, not a crash. It is open as
    long as the object lives."""

    def __init__(self, path: Path, piece: int = PIECE_BYTES) -> None:
        self._path, self._piece = path, piece
        self._file = opened_plain(path)
        weakref.finalize(self, self._file.close)
        self._size = os.fstat(self._file.fileno()).st_size
        self._start, self._window = 0, b""
        if not self._size:
            raise InputError(f"{path}: the file is empty")

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, place: slice) -> bytes:
        start, stop, _ = place.indices(len(self))
        size, at = max(stop - start, 0), start - self._start
        if at < 0 or at + size > len(self._window):
            self._start, at = start, 0
            count = max(size, min(self._piece, len(self) - start))
            self._window = os.pread(self._file.fileno(), count, start)
        piece = self._window[at : at + size]
        while len(piece) < size:  # a read may give less than was asked for, but not nothing
            more = os.pread(self._file.fileno(), size - len(piece), start + len(piece))
            if not more:
                raise _changed(self._path)
            piece += more
        return piece

    def find(self, part: bytes, start: int) -> int:
        """Where `part` begins first, from `start` on; -1 when it does not."""
        while start < len(self):
            piece = self[start : start + self._piece + len(part) - 1]
            at = piece.find(part)
            if at >= 0:
                return start + at
            start += self._piece
        return -1

    def crc32(self, stop: int) -> int:
        """CRC-32 of the first `stop` bytes."""
        crc = 0
        for start in range(0, stop, self._piece):
            crc = zlib.crc32(self[start : min(start + self._piece, stop)], crc)
        return crc


def read_whole(path: Path) -> bytes:
    """Content of a plain file; InputError if it is not plain, empty, or changes meanwhile."""
    file = FileBytes(path)
    with unchanged(path):
        return file[:]


def read_unpacked(path: Path) -> tuple[bytes, str | None]:
    """Content of a plain, gzip or bzip2 file and, if it is damaged or truncated, a line that says so.

    What could be unpacked before the damage is returned; nothing at all is an InputError, and so is
    content beyond all measure.
    """
    packed = read_whole(path)
    if packed[:2] == b"\x1f\x8b":
        return _unpack(path, packed, "gzip")
    if packed[:3] == b"BZh":
        return _unpack(path, packed, "bzip2")
    return packed, None


def bound_of(packed: int) -> int:
    """Most bytes that something of `packed` bytes is unpacked to."""
    return min(max(HARMLESS_BYTES, GREATEST_RATIO * packed), GREATEST_BYTES)


def _beyond(path: Path, bound: int) -> InputError:
    return InputError(
        f"{path}: unpacks to more than {bound >> 20} MiB; if that is intended, unpack it yourself "
        "and give the result"
    )


def require_bounded_zip(path: Path) -> None:
    """InputError when a zip file (NumPy's .npz is one) unpacks beyond its bound."""
    bound = bound_of(path.stat().st_size)
    with zipfile.ZipFile(path) as archive:
        if sum(member.file_size for member in archive.infolist()) > bound:
            raise _beyond(path, bound)


def chunk_bound(packed: int) -> int:
    """Most bytes that a chunk of `packed` bytes is unpacked to."""
    return min(max(HARMLESS_BYTES, CHUNK_RATIO * packed), CHUNK_BYTES)


class Unpacked:
    """Counts what the chunks of a file unpack to, all together."""

    def __init__(self, path: Path, packed: int) -> None:
        self._path, self._left = path, max(CHUNK_BYTES, CHUNK_RATIO * packed)

    def add(self, size: int) -> None:
        """Count a chunk; InputError when that is too much."""
        self._left -= size
        if self._left < 0:
            raise InputError(
                f"{self._path}: its chunks unpack to more than {CHUNK_RATIO} times the file; not read further"
            )


def _unpack(path: Path, packed: bytes, kind: str) -> tuple[bytes, str | None]:
    content, bound, problem = bytearray(), bound_of(len(packed)), None
    # Small pieces: what precedes a flipped bit is not lost with it, and none unpacks to very much. A byte of
    # gzip is at most 1 KiB; a block of bzip2 is 37 bytes or more, and at most 46 MB.
    start, size = 0, 1 << 10 if kind == "gzip" else 1 << 5
    while problem is None:
        unpacker: Any = bz2.BZ2Decompressor() if kind == "bzip2" else zlib.decompressobj(wbits=31)
        try:
            while start < len(packed) and not unpacker.eof:
                content += unpacker.decompress(packed[start : start + size])
                start += size
                if len(content) > bound:
                    raise _beyond(path, bound)
        except (OSError, zlib.error):
            problem = f"{path.name}: damaged {kind} data; read up to the damage"
            break
        if not unpacker.eof:
            problem = f"{path.name}: {kind} data ends early; read up to there"
            break
        start = min(start, len(packed)) - len(unpacker.unused_data)
        if not packed.startswith((b"\x1f\x8b", b"BZh"), start):
            break  # the end, or padding after the last stream
    if not content:
        raise InputError(f"{path}: damaged {kind} file, nothing could be unpacked; download it again")
    return bytes(content), problem


def unpack_zstd(packed: bytes, bound: int) -> bytes:
    """Content of one zstd frame; ValueError when it is damaged, cut or larger than `bound` bytes."""
    content = bytearray()
    try:
        claimed = zstandard.frame_content_size(packed)
        with zstandard.ZstdDecompressor().stream_reader(packed) as reader:
            while piece := reader.read(1 << 16):
                content += piece
                if len(content) > bound:
                    raise ValueError(f"unpacks to more than {bound} bytes")
    except zstandard.ZstdError as error:
        raise ValueError(f"damaged zstd data ({error})") from None
    if claimed not in (-1, len(content)):  # a cut frame ends without an error
        raise ValueError(f"damaged zstd data ({len(content)} of {claimed} bytes)")
    return bytes(content)


def unpack_zstd_file(path: Path, target: Path) -> None:
    """Unpack a zstd file into another; InputError when it is damaged or unpacks beyond all measure."""
    with opened_plain(path) as packed, target.open("wb") as out:
        bound = max(HARMLESS_BYTES, GREATEST_RATIO * os.fstat(packed.fileno()).st_size)
        try:
            for piece in zstandard.ZstdDecompressor().read_to_iter(packed):
                bound -= out.write(piece)
                if bound < 0:
                    raise _beyond(path, out.tell())
        except zstandard.ZstdError as error:
            raise InputError(f"{path}: damaged zstd data ({error}); fetch or record it again") from None
