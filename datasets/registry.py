"""Public logs by name: their URLs and descriptions, and a verified local copy of each."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import sha256_file

MIRROR_VARIABLE = "TURTLEBAG_DATA"
"""Folder with files of the registry, searched (also below it) before anything is downloaded."""
CACHE_VARIABLE = "TURTLEBAG_CACHE"
"""Folder for downloads; the user's cache folder when it is not set."""

_MOLA = (
    "https://raw.githubusercontent.com/MOLAorg/mola_test_datasets/"
    "e3f9e14ee00a07edcb13cebf5a019bfdf0eff11b/datasets/radish/"
)
_RELATIONS = (
    "R. Kuemmerle, B. Steder, C. Dornhege, M. Ruhnke, G. Grisetti, C. Stachniss, A. Kleiner: "
    "On measuring the accuracy of SLAM algorithms. Autonomous Robots 27(4), 2009"
)
_SOURCE = "http://ais.informatik.uni-freiburg.de/slamevaluation/datasets.php"
_CC_BY = "CC BY 3.0"


@dataclass(frozen=True, slots=True)
class RemoteFile:
    """One file: its address and the sha256 of its bytes."""

    url: str
    sha256: str

    @property
    def name(self) -> str:
        """File name."""
        return self.url.rsplit("/", 1)[1]


@dataclass(frozen=True, slots=True)
class Dataset:
    """A public log, with everything needed to use and cite it.

    `laser_x_m` is how far the laser sits ahead of the robot's centre, `no_return_m` the reading that
    means "no return".
    """

    name: str
    title: str
    files: tuple[RemoteFile, ...]
    license: str
    citation: str
    source: str
    laser_x_m: float
    no_return_m: float
    beams: int
    scans: int


def _radish(
    name: str,
    title: str,
    author: str,
    sha256: tuple[str, str],
    lidar: tuple[float, float, int],
    scans: int,
) -> Dataset:
    """`sha256` of log and relations; `lidar`: metres ahead, its reading for no return, beams."""
    urls = (f"{_MOLA}{name}.clf.bz2", f"{_MOLA}{name}.relations")
    files = tuple(RemoteFile(url, digest) for url, digest in zip(urls, sha256, strict=True))
    citation = f"Log: {author}. Relations: {_RELATIONS}"
    return Dataset(name, title, files, _CC_BY, citation, _SOURCE, *lidar, scans)


_LOGS = (
    _radish(
        "intel",
        "Intel Research Lab, Seattle",
        "Dirk Haehnel",
        (
            "d9ce4addefc9405d5e78fd883d2214766552537d262009f8e6f0137885f9f72a",
            "330378f153eeae652d6756c1746f335801f66c3e097d90611548e6c4f593c359",
        ),
        (0.0, 81.83, 180),
        13631,
    ),
    _radish(
        "fr079",
        "Freiburg, building 079",
        "Cyrill Stachniss",
        (
            "9c3930e17957889c24986390dc7fe3eeddd3d7019a8172085dbed8a28a0e6b77",
            "7e7f06b4aca455cb68f1f23d04e7c7316c5e17773e872734c860ed7a274cdfc7",
        ),
        (-0.04, 81.91, 360),
        4934,
    ),
    _radish(
        "mit-csail",
        "MIT CSAIL building",
        "Cyrill Stachniss",
        (
            "e010703e450a20e71a97b0e8de88d9474040c8106e547ff894d885e67a309b47",
            "ffd7ebe97fa1738913931e39ca643ee0a1b67de80499b0197a3d01abad0f589d",
        ),
        (0.0, 81.91, 361),
        1988,
    ),
)
DATASETS: Mapping[str, Dataset] = {dataset.name: dataset for dataset in _LOGS}


def fetch(name: str) -> list[Path]:
    """Verified local files of a dataset: from the mirror folder, the cache, or downloaded into it.

    InputError when there is no such dataset, or a file is damaged or cannot be had.
    """
    if name not in DATASETS:
        raise InputError(f"no dataset named {name!r}; known: {', '.join(DATASETS)}")
    return [_in_mirror(file) or _downloaded(file) for file in DATASETS[name].files]


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
