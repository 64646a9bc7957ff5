"""A rosbag2 folder being written: any topics, one MCAP file, metadata.yaml at the very end."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from turtlebag.datasets.bags.mcap import McapWriter
from turtlebag.datasets.bags.topics import (
    CUSTOM_RECORD,
    DATA_FILE,
    METADATA_FILE,
    bag_metadata,
    metadata_text,
)
from turtlebag.datasets.errors import InputError


class BagFolder:
    """A context manager. Ctrl-C closes properly; any other error leaves the bag visibly unfinished."""

    def __init__(self, folder: Path, *, custom: Mapping[str, str]) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if (folder / METADATA_FILE).exists():
                raise FileExistsError
            self._mcap = McapWriter(folder / DATA_FILE)
        except FileExistsError:
            raise InputError(f"{folder}: already holds a bag; choose another folder") from None
        except OSError as error:
            raise InputError(f"{folder}: cannot be written ({error.strerror})") from None
        self._folder = folder
        self._custom = dict(custom)
        if custom:  # at the beginning, where a crash cannot take it away
            self._mcap.add_metadata(CUSTOM_RECORD, custom)
        self._topics: list[tuple[str, str, str, str]] = []
        self._schemas: dict[tuple[str, str, str], int] = {}
        self._closed = False
        self.write = self._mcap.write  # (channel, log time [ns], data); bound once, it is called often

    def __enter__(self) -> BagFolder:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.leave(kind)

    def leave(self, kind: type[BaseException] | None) -> None:
        """End as a context manager does: close, or abort after an error."""
        if kind is None or issubclass(kind, KeyboardInterrupt):
            self.close()
        elif not self._closed:
            self._closed = True
            self._mcap.abort()

    def add_topic(
        self,
        name: str,
        msgtype: str,
        text: str,
        *,
        form: str = "ros2msg",
        qos: str = "",
        type_hash: str = "",
        encoding: str = "cdr",
    ) -> int:
        """Register a topic with its message definition; returns the channel to write to."""
        key = msgtype, form, text
        if key not in self._schemas:
            self._schemas[key] = self._mcap.add_schema(msgtype, text, form)
        self._topics.append((name, msgtype, qos, type_hash))
        metadata = {"offered_qos_profiles": qos, "topic_type_hash": type_hash}
        return self._mcap.add_channel(name, self._schemas[key], metadata, encoding)

    def close(self) -> None:
        """Finish the file, then write metadata.yaml."""
        if self._closed:
            return
        self._closed = True
        self._mcap.flush()
        information = bag_metadata(self._topics, self._mcap.counts, self._mcap.span_ns, self._custom)
        self._mcap.add_metadata("rosbag2", {"serialized_metadata": metadata_text(information)})
        self._mcap.close()
        unfinished = self._folder / (METADATA_FILE + ".tmp")
        unfinished.write_text(metadata_text({"rosbag2_bagfile_information": information}))
        unfinished.rename(self._folder / METADATA_FILE)
