"""Outputs that are whole or absent: grown beside, renamed into place, with a manifest of their making."""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
import shutil
import signal
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from datasets.errors import InputError

PACKAGES = (
    "turtlebag",
    "numpy",
    "scipy",
    "numba",
    "gtsam",
    "kiss-icp",
    "open3d-cpu",
    "rosbags",
    "mcap",
    "ompl",
    "pybullet",
    "matplotlib",
)


_growing: set[Path] = set()


@contextmanager
def staged_output(out: Path, *, force: bool = False, suffix: str = ".partial") -> Iterator[Path]:
    """Folder `OUT.partial` to write into; renamed to `out` on success, removed on any error.

    Raises InputError at once when `out` exists and `force` is not given, or cannot be written.
    """
    check_free(out, force=force)
    partial = out.with_name(out.name + suffix)
    try:
        if partial.exists():
            shutil.rmtree(partial)
        partial.mkdir(parents=True)
    except OSError as error:
        raise InputError(f"{partial}: cannot be created ({error.strerror})") from None
    _growing.add(partial)
    try:
        yield partial
        _put_in_place(partial, out)
    except BaseException as error:
        shutil.rmtree(partial, ignore_errors=True)
        if isinstance(error, OSError) and error.errno is not None:
            raise InputError(f"{error.filename or out}: {error.strerror}") from None
        raise
    finally:
        _growing.discard(partial)


@contextmanager
def staged_file(out: Path, *, force: bool = False) -> Iterator[Path]:
    """File `OUT.partial` to write; renamed to `out` on success, removed on any error, as `staged_output`."""
    check_free(out, force=force)
    partial = out.with_name(out.name + ".partial")
    _growing.add(partial)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        partial.unlink(missing_ok=True)
        yield partial
        partial.replace(out)
    except OSError as error:
        raise InputError(f"{out}: cannot be written ({error.strerror})") from None
    finally:
        partial.unlink(missing_ok=True)
        _growing.discard(partial)


def discard_unfinished() -> None:
    """Remove every output that is still growing: for a process that is about to end."""
    for partial in list(_growing):
        with suppress(OSError):
            partial.unlink() if partial.is_file() else shutil.rmtree(partial, ignore_errors=True)


def _put_in_place(partial: Path, out: Path) -> None:
    """Swap the finished folder in; what stood there before goes last, and no signal comes between."""
    old = out.with_name(out.name + ".old")
    stops = {signal.SIGINT, signal.SIGTERM}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, stops)
    try:
        if old.exists():
            _remove(old)
        if out.exists():
            out.rename(old)
        partial.rename(out)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    if old.exists():
        _remove(old)


OUTPUT_MARKS = ("manifest.json", "metadata.yaml")
"""A folder that holds one of these is an output (or a bag) of ours and may be replaced on demand."""


def check_free(out: Path, *, force: bool) -> None:
    """InputError when `out` cannot be an output, or exists already and may not be replaced."""
    if out.name in ("", ".."):
        raise InputError(f"--out {out}: give the folder to write a name")
    if not out.exists():
        return
    if not force:
        raise InputError(f"{out}: already exists; choose another --out or pass --force")
    if out.is_dir() and any(out.iterdir()) and not any((out / mark).exists() for mark in OUTPUT_MARKS):
        raise InputError(f"{out}: holds files that are no output of turtlebag; --force does not remove them")


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()


def sha256_file(path: Path) -> str:
    """Hex sha256 of a file's bytes."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def sha256_tree(path: Path) -> dict[str, str]:
    """sha256 of a file, or of every file below a folder, by path relative to it; manifests left out."""
    if path.is_file():
        return {path.name: sha256_file(path)}
    files = sorted(item for item in path.rglob("*") if item.is_file() and item.name != "manifest.json")
    return {item.relative_to(path).as_posix(): sha256_file(item) for item in files}


def sha256_text(text: str) -> str:
    """Hex sha256 of a text, UTF-8."""
    return hashlib.sha256(text.encode()).hexdigest()


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Strict JSON (non-finite numbers become null), stable key order as given, one newline at the end."""
    path.write_text(json.dumps(_plain(data), indent=2, allow_nan=False) + "\n")


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):  # NumPy scalars and arrays
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


class Stopwatch:
    """Measures wall time from when it was made."""

    def __init__(self) -> None:
        self._start = time.perf_counter()

    def seconds(self) -> float:
        """Wall time so far [s]."""
        return time.perf_counter() - self._start


def write_manifest(
    folder: Path,
    *,
    stage: str,
    command: Sequence[str],
    inputs: Mapping[str, Path],
    seed: int | None,
    wall_s: float,
    extra: Mapping[str, Any] | None = None,
) -> None:
    """Write `manifest.json`: the hashes of inputs and of all outputs in `folder`, and the volatile facts."""
    write_json(
        folder / "manifest.json",
        {
            "stage": stage,
            "command": list(command),
            "seed": seed,
            "inputs": {
                name: {"path": str(path), "sha256": sha256_tree(path)} for name, path in inputs.items()
            },
            "outputs": sha256_tree(folder),
            "packages": package_versions(),
            "python": platform.python_version(),
            "platform": platform.platform(),
            "cpus": os.cpu_count(),
            "finished_utc": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            "wall_s": round(wall_s, 3),
            **(extra or {}),
        },
    )


def package_versions() -> dict[str, str]:
    """Installed versions of the packages whose numerics shape the results."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found
