"""Cache files: results stored under a hash of their inputs.

A file contains the hash of its bytes: a truncated, altered or renamed one is ignored.
Files are written under a temporary name and renamed, so any number of processes may share a folder and be
killed at any moment. Trouble with the folder (full, read-only) never ends a run: results are computed again.
"""

from __future__ import annotations

import hashlib
import os
import re
from contextlib import suppress
from pathlib import Path
from threading import get_ident

MAGIC = b"turtlebag kept 1\n"


def read_cached(path: Path) -> bytes | None:
    """What `write_cached` was given, which counts as a use; None when the file is not there or not that."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    payload = content[len(MAGIC) + 32 :]
    if content[: len(MAGIC) + 32] != MAGIC + _seal(path.name, payload):
        return None
    with suppress(OSError):
        os.utime(path)
    return payload


def write_cached(path: Path, payload: bytes) -> bool:
    """Keep the bytes under the name; whether that was possible."""
    partial = path.with_name(f"{path.name}.{os.getpid()}.{get_ident()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_bytes(MAGIC + _seal(path.name, payload) + payload)
        partial.replace(path)
    except OSError:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        return False
    return True


def trim_cached(folder: Path, names: re.Pattern[str], limit_bytes: int, limit_files: int) -> None:
    """Remove the least recently used files beyond the limits, and what killed processes left. `names` match
    the files of the cache; any other file stays."""
    files = []
    for path in folder.glob("*"):
        if not names.fullmatch(re.sub(r"\.\d+\.\d+$", "", path.name)):
            continue
        with suppress(OSError):  # another process was quicker
            status = path.stat()
            files.append((status.st_mtime_ns, status.st_size, path))
    total = sum(size for _, size, _ in files)
    for oldest, (_, size, path) in enumerate(sorted(files)):
        if total <= limit_bytes and len(files) - oldest <= limit_files:
            return
        with suppress(OSError):
            path.unlink(missing_ok=True)
        total -= size


def user_cache() -> Path | None:
    """The user's cache folder; None without a home folder."""
    place = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(place) / "turtlebag" if os.path.isabs(place) else None


def _seal(name: str, payload: bytes) -> bytes:
    digest = hashlib.sha256(name.encode())
    digest.update(payload)
    return digest.digest()
