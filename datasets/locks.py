"""Locks on folders: they survive a rename, and end with the process that holds them."""

from __future__ import annotations

import fcntl
import os
from contextlib import suppress
from pathlib import Path

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.output_rules import identity


def open_locked(folder: Path, out: Path) -> int | None:
    """Descriptor of a locked folder; None if the folder is gone.

    InputError when another process has the lock, or what is there is no folder.
    """
    try:
        opened = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except FileNotFoundError:
        return None
    except NotADirectoryError:
        raise InputError(
            f"{folder}: is in the way and is not a folder; move it or choose another --out"
        ) from None
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({error.strerror})") from None
    try:
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        close(opened)
        if not isinstance(error, BlockingIOError):
            raise InputError(f"{folder}: cannot be locked ({error.strerror})") from None
        raise InputError(
            f"{out}: another process is writing it (in {folder}); wait for it or choose another --out"
        ) from None
    return opened


def close(folder: int | None) -> None:
    """Close a descriptor, and with it give up its lock."""
    if folder is not None:
        with suppress(OSError):  # given up before, by a process that was told to end while it did so
            os.close(folder)


def is_same(folder: int, path: Path) -> bool:
    """Whether a descriptor is still that of the folder at a path."""
    status = os.fstat(folder)
    return (status.st_dev, status.st_ino) == identity(path)


def is_locked(folder: Path) -> bool:
    """Whether a process holds the lock of a folder."""
    try:
        close(open_locked(folder, folder))
    except InputError:
        return True
    return False
