"""Input files as bytes: mapped whole, or .gz and .bz2 unpacked on the way, as far as they are intact."""

from __future__ import annotations

import bz2
import mmap
import zlib
from pathlib import Path
from typing import Any

from datasets.errors import InputError


def read_unpacked(path: Path) -> tuple[bytes, str | None]:
    """Content of a plain, gzip or bzip2 file and, when it is damaged or cut, one line that says so.

    What could be unpacked before the damage is returned; nothing at all is an InputError.
    """
    try:
        packed = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    if not packed:
        raise InputError(f"{path}: the file is empty")
    if packed[:2] == b"\x1f\x8b":
        return _unpack(path, packed, "gzip")
    if packed[:3] == b"BZh":
        return _unpack(path, packed, "bzip2")
    return packed, None


def mapped(path: Path) -> mmap.mmap:
    """The bytes of a file without reading it whole; InputError when there are none."""
    try:
        with path.open("rb") as file:
            return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except ValueError:
        raise InputError(f"{path}: the file is empty") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None


def _unpack(path: Path, packed: bytes, kind: str) -> tuple[bytes, str | None]:
    parts: list[bytes] = []
    problem = None
    while packed and problem is None:
        unpacker: Any = bz2.BZ2Decompressor() if kind == "bzip2" else zlib.decompressobj(wbits=31)
        try:
            # Small pieces, so that what precedes a flipped bit is not lost with it.
            for start in range(0, len(packed), 1 << 16):
                parts.append(unpacker.decompress(packed[start : start + (1 << 16)]))
                if unpacker.eof:
                    break
        except (OSError, zlib.error):
            problem = f"{path.name}: damaged {kind} data; read up to the damage"
            break
        if not unpacker.eof:
            problem = f"{path.name}: {kind} data ends early; read up to there"
            break
        packed = unpacker.unused_data + packed[start + (1 << 16) :]
        if not packed.startswith((b"\x1f\x8b", b"BZh")):
            break  # padding after the last stream
    content = b"".join(parts)
    if not content:
        raise InputError(f"{path}: damaged {kind} file, nothing could be unpacked; fetch it again")
    return content, problem
