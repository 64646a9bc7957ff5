"""What an output may replace: only an earlier output of ours, and never an input."""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

from turtlebag.datasets.errors import InputError

MAGICS = {".png": b"\x89PNG\r\n\x1a\n", ".bag": b"#ROSBAG V2.0\n"}
"""How the single files begin that we write, by their suffix; no other file is ever replaced."""

Kind = Literal["folder", "file"]


def place_of(out: Path) -> Path:
    """Where an output goes, absolute and without links but for its own name; InputError without a name."""
    if out.name in ("", ".."):
        raise InputError(f"--out {out}: name the folder to write")
    return Path(os.path.realpath(out.parent)) / out.name


def check_free(out: Path, *, force: bool, inputs: Iterable[Path] = (), kind: Kind | None = None) -> None:
    """InputError when `out` cannot be an output, or exists and may not be replaced.

    `kind` is what shall stand there; without it what exists may be either.
    """
    place = place_of(out)
    for path in inputs:
        require_apart(out, place, path)
    if not os.path.lexists(place):
        return
    if not force:
        raise InputError(f"{out}: already exists; choose another --out or pass --force")
    mode = place.lstat().st_mode
    if stat.S_ISLNK(mode):
        raise InputError(f"{out}: is a link, which --force does not replace; give its target instead")
    if stat.S_ISDIR(mode):
        _require_our_folder(out, place)
    elif not (stat.S_ISREG(mode) and _is_our_file(place)):
        raise InputError(f"{out}: is not an output of turtlebag; --force does not replace it")
    if kind is not None and (kind == "folder") != stat.S_ISDIR(mode):
        raise InputError(f"{out}: exists and is not a {kind}; choose another --out")


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
    if any(place.iterdir()) and not is_output(place):
        raise InputError(
            f"{out}: contains files that are not an output of turtlebag (no manifest.json of ours); "
            "--force does not remove them"
        )


def is_output(folder: Path) -> bool:
    """Whether a folder bears a manifest that we wrote."""
    path = folder / "manifest.json"
    try:
        manifest: Any = json.loads(path.read_bytes()) if path.is_file() and not path.is_symlink() else {}
        return "stage" in manifest and "outputs" in manifest and "turtlebag" in manifest["packages"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return False


def _is_our_file(path: Path) -> bool:
    magic = MAGICS.get(path.suffix.lower())
    with path.open("rb") as file:
        return magic is not None and file.read(len(magic)) == magic
