"""Public logs and worlds by name: their URLs and descriptions, and a verified local copy of each."""

from __future__ import annotations

import os
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import sha256_file
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.yaml_files import plain_values

MIRROR_VARIABLE = "TURTLEBAG_DATA"
"""Folder with files of the registry, searched (also below it) before anything is downloaded."""
CACHE_VARIABLE = "TURTLEBAG_CACHE"
"""Folder for downloads; the user's cache folder when it is not set."""


class RemoteFile(NamedTuple):
    """One file: its address, name and the sha256 of its bytes."""

    url: str
    name: str
    sha256: str


class Dataset(Settings):
    """A public log, or worlds, with everything needed to use and cite it, as registry.yaml describes it."""

    name: str
    title: str
    author: str
    license: str
    source: str
    folder: str
    relations: str = ""
    laser_x_m: float = 0.0
    no_return_m: float = 0.0
    beams: int = 0
    scans: int = 0
    sha256: dict[str, str]

    @property
    def files(self) -> list[RemoteFile]:
        """Log and relations, or the worlds; a file of a folder below is kept by its name alone."""
        return [
            RemoteFile(f"{self.folder}/{name}", name.rpartition("/")[2], digest)
            for name, digest in self.sha256.items()
        ]


_told = plain_values((files("turtlebag.datasets") / "registry.yaml").read_text())
DATASETS = {name: Dataset(name=name, **entry) for name, entry in _told.items()}


def fetch(name: str) -> list[Path]:
    """Verified local files of a dataset: from the mirror folder, the cache, or downloaded into it.

    InputError when there is no such dataset, or a file is damaged or cannot be had.
    """
    if name not in DATASETS:
        raise InputError(f"no dataset named {name!r}; known: {', '.join(DATASETS)}")
    return local_files(DATASETS[name])


def local_files(dataset: Dataset) -> list[Path]:
    """As `fetch`, of a dataset that need not be in the registry."""
    return [_in_mirror(file) or _downloaded(file) for file in dataset.files]


def _in_mirror(file: RemoteFile) -> Path | None:
    folder = os.environ.get(MIRROR_VARIABLE)
    if not folder:
        return None
    if not Path(folder).is_dir():
        raise InputError(f"{MIRROR_VARIABLE}={folder}: no such folder")
    for path in sorted(Path(folder).rglob(file.name)):
        if sha256_file(path) != file.sha256:
            raise InputError(f"{path}: does not match the registry (sha256 differs); replace or remove it")
        return path
    return None


def _downloaded(file: RemoteFile) -> Path:
    import pooch

    pooch.get_logger().setLevel("ERROR")
    folder = Path(os.environ.get(CACHE_VARIABLE) or pooch.os_cache("turtlebag"))
    try:
        path = pooch.retrieve(
            file.url, known_hash=f"sha256:{file.sha256}", fname=file.name, path=folder, progressbar=False
        )
    except ValueError:
        raise InputError(
            f"{file.url}: the downloaded file does not match the registry (sha256 differs)"
        ) from None
    except Exception as error:
        # requests, urllib3 and the file system each have their own families of errors.
        reason = type(error).__name__
        hint = f"set {MIRROR_VARIABLE} to a folder that holds {file.name}"
        raise InputError(f"{file.url}: cannot be downloaded ({reason}); {hint}") from None
    return Path(path)
