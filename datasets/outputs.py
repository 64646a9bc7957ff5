"""Atomic outputs: written to `OUT.partial`, renamed when finished, with a manifest."""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from turtlebag.datasets.files import JUNK, sha256_file
from turtlebag.datasets.output_lock import lock_output, watch_inputs
from turtlebag.datasets.output_rules import MANIFEST, MARKER, require_free

PACKAGES = (
    "turtlebag",
    "numpy",
    "scipy",
    "numba",
    "gtsam",
    "kiss-icp",
    "open3d-cpu" if sys.platform == "linux" and platform.machine() == "x86_64" else "open3d",
    "rosbags",
    "mcap",
    "ompl",
    "pybullet",
    "matplotlib",
)


@contextmanager
def staged_output(
    out: Path, *, force: bool = False, inputs: Iterable[Path] = (), save_bag: bool = False
) -> Iterator[Path]:
    """Folder `OUT.partial` to write into; renamed to `out` on success, removed on any error.

    Raises InputError at once when `out` exists and may not be replaced, or cannot be written, or another
    process is writing it; and at the end when an input is not what it was. `save_bag` is for recordings: see
    `OutputLock.growth`.
    """
    with lock_output(out, force=force, inputs=inputs) as lock, lock.growth(save_bag=save_bag) as partial:
        require_free(out, force=force, kind="folder")
        yield partial
        lock.finish()


@contextmanager
def staged_file(out: Path, *, force: bool = False) -> Iterator[Path]:
    """A file in `OUT.partial` to write; moved to `out` on success, else removed, as `staged_output`."""
    with lock_output(out, force=force) as lock, lock.growth() as partial:
        require_free(out, force=force, kind="file")
        yield partial / out.name
        lock.finish(partial / out.name)


class Stopwatch:
    """Measures wall time from when it was made."""

    def __init__(self) -> None:
        self._start = time.perf_counter()

    def seconds(self) -> float:
        """Wall time so far [s]."""
        return time.perf_counter() - self._start


@dataclass(frozen=True)
class Output:
    """The folder that a stage writes, and how: `force` replaces an earlier output; `command` and `request`,
    what was asked for, go into the manifest. InputError when the folder exists and may not be replaced."""

    folder: Path
    force: bool = False
    command: Sequence[str] = ()
    request: Mapping[str, Any] = field(default_factory=dict)
    _watch: Stopwatch = field(default_factory=Stopwatch, init=False, compare=False)

    def __post_init__(self) -> None:
        require_free(self.folder, force=self.force, kind="folder")

    def staged(self, inputs: Iterable[Path] = (), *, save_bag: bool = False) -> AbstractContextManager[Path]:
        """The folder to write into, put in place at the end (`staged_output`)."""
        return staged_output(self.folder, force=self.force, inputs=inputs, save_bag=save_bag)

    @property
    def wall_s(self) -> float:
        """Wall time since it was asked for [s]."""
        return self._watch.seconds()

    def finish(
        self,
        partial: Path,
        stage: str,
        inputs: Mapping[str, Path],
        *,
        metrics: Mapping[str, Any] | None = None,
        config: str | None = None,
        seed: int | None = None,
        extra: Mapping[str, Any] | None = None,
    ) -> None:
        """Write what comes last into the staged folder: metrics.json and config.yaml, where a stage has them,
        and the manifest (`write_manifest`)."""
        if metrics is not None:
            write_json(partial / "metrics.json", metrics)
        if config is not None:
            (partial / "config.yaml").write_text(config)
        more = {**({"request": self.request} if self.request else {}), **(extra or {})}
        write_manifest(partial, stage, self.command, inputs, wall_s=self.wall_s, seed=seed, extra=more)


NO_CONTENT = (MANIFEST, MARKER, *JUNK)
"""Files in an output that are not hashed: our manifest and mark, and what file managers leave behind."""


def sha256_tree(path: Path) -> dict[str, str]:
    """sha256 of a file, or of every file below a folder, by path relative to it; no manifests and marks."""
    if path.is_file():
        return {path.name: sha256_file(path)}
    files = sorted(item for item in path.rglob("*") if item.is_file() and item.name not in NO_CONTENT)
    return {item.relative_to(path).as_posix(): sha256_file(item) for item in files}


def sha256_text(text: str) -> str:
    """Hex sha256 of a text, UTF-8."""
    return hashlib.sha256(text.encode()).hexdigest()


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Strict JSON (non-finite numbers become null), stable key order as given, one newline at the end."""
    path.write_text(json.dumps(plain(data), indent=2, allow_nan=False) + "\n")


def plain(value: Any) -> Any:
    """A value as strict JSON has it: no NumPy, and null for a number that is not finite."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # NumPy scalars and arrays
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def write_manifest(
    folder: Path,
    stage: str,
    command: Sequence[str],
    inputs: Mapping[str, Path],
    *,
    wall_s: float,
    seed: int | None = None,
    extra: Mapping[str, Any] | None = None,
) -> None:
    """Write `manifest.json`: the hashes of inputs and of all outputs in `folder`, and the volatile facts.

    InputError when `folder` grows to replace one of the inputs, to lie in one or to hold one.
    """
    watch_inputs(folder, inputs.values())
    write_json(
        folder / "manifest.json",
        {
            "stage": stage,
            "command": list(command),
            "started_in": os.path.relpath(Path.cwd(), folder.resolve()),
            "seed": seed,
            "inputs": {
                name: {"path": str(path), "sha256": sha256_tree(path)} for name, path in inputs.items()
            },
            "outputs": sha256_tree(folder),
            "packages": package_versions(),
            "python": platform.python_version(),
            "platform": platform.platform(),
            "cpu": cpu_name(),
            "cpus": os.cpu_count(),
            "finished_utc": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            "wall_s": round(wall_s, 3),
            **(extra or {}),
        },
    )


@cache
def cpu_name() -> str:
    """What processor this is, as far as the system says: another one may round otherwise."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith(("model name", "CPU part")):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


@cache
def package_versions() -> dict[str, str]:
    """Installed versions of the packages whose numerics shape the results."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found
