"""Remote bags and logs by URL: download what mapping needs to a local folder.

An mcap is read by ranges (`mcap_ranges`); any other file, and an mcap without an index, is downloaded whole.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from turtlebag.datasets.bags.mcap_ranges import partial_mcap
from turtlebag.datasets.bags.sequential import Damage
from turtlebag.datasets.bags.source import SUFFIXES, TRUTH_PREFIX
from turtlebag.datasets.bags.topics import CLOUD, MAPPED, METADATA_FILE, SCAN, Topic
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.urls import filesystem, is_local, reason_of


def brought(url: str, folder: Path, topics: Collection[str] = ()) -> Path:
    """Local path of the bag or log at `url`, downloaded to `folder` if it is remote.

    Of an mcap come the topics that mapping reads: point clouds only where there is no LaserScan, or their
    topic is one of `topics`. A folder comes with its metadata and its storage files. InputError when there
    is nothing at the URL or it cannot be read.
    """
    files, path = filesystem(url)
    if is_local(files):
        return Path(path)
    place = folder / path.rpartition("/")[2]
    try:
        if not files.exists(path):
            raise InputError(f"{url}: no such file or folder")
        if not files.isdir(path):
            _bring(files, path, place, topics)
            return place
        place.mkdir(parents=True)
        inner = f"{path}/bag" if files.isdir(f"{path}/bag") else path
        for name in (str(found).rpartition("/")[2] for found in files.ls(inner, detail=False)):
            if name == METADATA_FILE or any(suffix in name for suffix in SUFFIXES):
                _bring(files, f"{inner}/{name}", place / name, topics)
        return place
    except InputError:
        raise
    except Exception as error:  # a store's client raises whatever its own libraries do
        raise InputError(f"{url}: cannot be read ({reason_of(error)})") from None


def _bring(files: Any, path: str, place: Path, topics: Collection[str]) -> None:
    place.parent.mkdir(parents=True, exist_ok=True)
    if path.endswith(".mcap"):
        pieces = partial_mcap(
            lambda start, end: files.cat_file(path, start=start, end=end),
            files.info(path)["size"],
            lambda channels: _asked_for(channels, topics),
        )
        with suppress(Damage), place.open("wb") as out:  # whoever reads it whole says what is wrong
            out.writelines(pieces)
            return
    files.get_file(path, str(place))


def _asked_for(channels: Mapping[int, Topic], topics: Collection[str]) -> list[int]:
    planar = any(channel.msgtype == SCAN for channel in channels.values())

    def needed(channel: Topic) -> bool:
        if channel.msgtype == CLOUD:
            return not planar or channel.name in topics
        return channel.msgtype in MAPPED and not channel.name.startswith(TRUTH_PREFIX)

    return [number for number, channel in channels.items() if needed(channel)]
