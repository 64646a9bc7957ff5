"""What an output may replace: only an earlier output of ours, as we wrote it, and never an input."""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.files import JUNK, sha256_file

MANIFEST = "manifest.json"
MARKER = ".turtlebag-unfinished"
"""File in every folder that grows. It never is part of a finished output, nor of its hashes."""
PICTURE_MARK = "turtlebag"
"""The software that a PNG of ours, a single file, names: no other file is ever replaced."""
_PNG, _MARKED_BYTES = b"\x89PNG\r\n\x1a\n", 512

Kind = Literal["folder", "file"]


def place_of(out: Path) -> Path:
    """Where an output goes, absolute and without links but for its own name; InputError without a name."""
    if out.name in ("", ".."):
        raise InputError(f"--out {out}: name the folder to write")
    return Path(os.path.realpath(out.parent)) / out.name


def require_free(out: Path, *, force: bool, kind: Kind | None = None) -> None:
    """InputError when `out` exists and is nothing that may be replaced; `require_untouched` looks into it.

    `kind` is what shall stand there; without it what exists may be either.
    """
    place = place_of(out)
    if not os.path.lexists(place):
        return
    if not force:
        raise InputError(f"{out}: already exists; choose another --out or pass --force")
    mode = place.lstat().st_mode
    if stat.S_ISLNK(mode):
        raise InputError(f"{out}: is a link, which --force does not replace; give its target instead")
    if stat.S_ISDIR(mode):
        _require_our_folder(out, place)
    elif not (stat.S_ISREG(mode) and _is_our_picture(place)):
        raise InputError(f"{out}: is not marked as an output of turtlebag; --force does not replace it")
    if kind is not None and (kind == "folder") != stat.S_ISDIR(mode):
        raise InputError(f"{out}: exists and is not a {kind}; choose another --out")


def require_untouched(out: Path) -> None:
    """InputError that names what in the folder `out`, if it is one, is not as turtlebag wrote it."""
    found = list(strangers(out)) if out.is_dir() else []
    if found:
        more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
        raise InputError(
            f"{out}: {found[0]}{more}; --force does not remove it: move it away or choose another --out"
        )


def strangers(folder: Path) -> Iterator[str]:
    """What in an output is not ours to remove, or cannot be removed, a few words each; OSError where a folder
    cannot be read."""
    outputs = outputs_of(folder) or {}
    effective = os.access in os.supports_effective_ids
    for place, folders, files in os.walk(folder, onerror=_unreadable):
        inside = Path(place)
        within = "" if inside == folder else f"{inside.relative_to(folder).as_posix()}/"
        if (folders or files) and not os.access(inside, os.W_OK | os.X_OK, effective_ids=effective):
            yield f"{within or 'the folder'} cannot be changed (Permission denied)"
        for name in sorted([*files, *(name for name in folders if (inside / name).is_symlink())]):
            path = inside / name
            if name in JUNK or path == folder / MARKER or (name == MANIFEST and is_output(inside)):
                continue
            if within + name not in outputs:
                yield f"{within}{name} is not part of this output"
            elif not _has_hash(path, outputs[within + name]):
                yield f"{within}{name} was changed since turtlebag wrote it"


def _unreadable(error: OSError) -> None:
    raise error


def _has_hash(path: Path, digest: str) -> bool:
    try:
        return stat.S_ISREG(path.lstat().st_mode) and sha256_file(path) == digest
    except OSError:
        return False


def outputs_of(folder: Path) -> dict[str, str] | None:
    """Hashes by path that a manifest of ours in a folder lists; None where there is none of ours."""
    path = folder / MANIFEST
    try:
        manifest: Any = json.loads(path.read_bytes()) if path.is_file() and not path.is_symlink() else {}
        if "stage" in manifest and "turtlebag" in manifest["packages"]:
            return dict(manifest["outputs"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        pass
    return None


def is_output(folder: Path) -> bool:
    """Whether a folder bears a manifest that we wrote."""
    return outputs_of(folder) is not None


def require_apart(out: Path, place: Path, path: Path) -> None:
    """InputError if an input is the output, contains it or is inside it."""
    if not os.path.exists(path):
        return
    reads = identity(path)
    if reads in lineage(place):
        where = "is" if identity(place) == reads else "lies in"
        raise InputError(f"--out {out}: {where} the input {path}; choose another --out")
    writes = identity(place)
    if writes and writes in lineage(path):
        raise InputError(f"--out {out}: contains the input {path}; choose another --out")


def lineage(path: Path) -> list[tuple[int, int] | None]:
    """Identities of a path and of all that hold it."""
    real = Path(os.path.realpath(path))
    return [identity(parent) for parent in (real, *real.parents)]


def identity(path: Path) -> tuple[int, int] | None:
    """Device and inode; None for what does not exist."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino


def _require_our_folder(out: Path, place: Path) -> None:
    home = Path(os.path.expanduser("~"))
    for special, name in ((home, "your home"), (Path.cwd(), "the current folder")):
        if identity(place) in lineage(special):
            raise InputError(f"{out}: is or contains {name}; --force does not replace it")
    if os.path.ismount(place):
        raise InputError(f"{out}: is a mount point; --force does not replace it")
    if any(path.name not in JUNK for path in place.iterdir()) and not is_output(place):
        raise InputError(
            f"{out}: contains files that are not an output of turtlebag (no manifest.json of ours); "
            "--force does not remove them"
        )


def _is_our_picture(path: Path) -> bool:
    """Whether it is a PNG whose first text, before the pixels, names `PICTURE_MARK` as its software."""
    with path.open("rb") as file:
        head = file.read(_MARKED_BYTES)
    return head.startswith(_PNG) and b"tEXtSoftware\0" + PICTURE_MARK.encode() in head.split(b"IDAT")[0]
