"""Opening a bag of any kind: which files it has, and its messages one after the other."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import NamedTuple, Protocol

import yaml
from rosbags.interfaces import Connection, ConnectionExtRosbag2
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2
from rosbags.rosbag2.metadata import dump_qos_v9

from datasets.bags.decode import Cursor, Ros1Cursor
from datasets.bags.mcap import MAGIC
from datasets.bags.mcap_scan import McapChannel, McapScan
from datasets.bags.topics import METADATA_FILE, TOPICS, metadata_text
from datasets.errors import InputError
from datasets.files import read_unpacked

MAGICS = {MAGIC: "mcap", b"SQLite format 3\0": "sqlite3", b"#ROSBAG V2.0": "ros1"}
SUFFIXES = {".mcap": "mcap", ".db3": "sqlite3", ".bag": "ros1"}
TRUTH_PREFIX = "/ground_truth"


@dataclass(frozen=True, slots=True)
class Topic:
    """A recorded topic: ROS 2 type name and, where the file has them, definition and quality of service."""

    name: str
    msgtype: str
    definition: str = ""
    definition_format: str = ""
    qos: str = ""
    type_hash: str = ""
    encoding: str = "cdr"


class Message(NamedTuple):
    """One message: its topic, log time [ns] and serialised bytes."""

    topic: Topic
    log_time_ns: int
    data: bytes


Wanted = Callable[[Topic], bool]


class BagFile(Protocol):
    """One storage file."""

    def messages(self, wanted: Wanted | None, notes: list[str], *, step_over: bool) -> Iterator[Message]:
        """Messages of the wanted topics in file order; problems are appended to `notes`."""


class Bag:
    """A bag: its files in order. `notes` grows while messages are read."""

    def __init__(self, path: Path, kind: str, files: list[Path], notes: list[str]) -> None:
        self.path, self.kind, self.files, self.notes = path, kind, files, notes
        self._keep: list[tempfile.TemporaryDirectory] = []

    def messages(self, wanted: Wanted | None = None, *, step_over: bool = False) -> Iterator[Message]:
        """Messages of the wanted topics (all without `wanted`), file after file.

        At damage reading ends, or with `step_over` goes on where the file is whole again.
        """
        for file in self.files:
            source: BagFile = _McapFile(file) if self.kind == "mcap" else _RosbagsFile(file, self.kind)
            yield from source.messages(wanted, self.notes, step_over=step_over)

    def cursor(self, data: bytes) -> Cursor:
        """A field reader for a message's bytes."""
        return Ros1Cursor(data) if self.kind == "ros1" else Cursor(data)


class _McapFile:
    def __init__(self, path: Path) -> None:
        self.scan = McapScan(path)

    def messages(self, wanted: Wanted | None, notes: list[str], *, step_over: bool) -> Iterator[Message]:
        topics: dict[int, Topic] = {}

        def topic_of(channel: McapChannel) -> Topic:
            known = topics.get(id(channel))
            if known is None:
                schema, metadata = channel.schema, channel.metadata
                known = topics[id(channel)] = Topic(
                    channel.topic,
                    full_type(schema.name),
                    schema.text,
                    schema.encoding,
                    metadata.get("offered_qos_profiles", ""),
                    metadata.get("topic_type_hash", ""),
                    channel.encoding,
                )
            return known

        chosen = None if wanted is None else lambda channel: wanted(topic_of(channel))
        for channel, time, data in self.scan.messages(chosen, step_over=step_over):
            yield Message(topic_of(channel), time, data)
        name = self.scan.path.name
        notes.extend(f"{name}: {problem}" for problem in self.scan.state.problems)
        if self.scan.state.stopped and not step_over:
            notes.append(f"{name}: read up to there; `turtlebag bag recover` saves what comes after, too")


class _RosbagsFile:
    def __init__(self, path: Path, kind: str) -> None:
        self.path, self.kind = path, kind

    def messages(self, wanted: Wanted | None, notes: list[str], *, step_over: bool) -> Iterator[Message]:
        try:
            with Reader1(self.path) if self.kind == "ros1" else Reader2(self.path) as reader:
                topics = {connection.id: self._topic(connection) for connection in reader.connections}
                chosen = [c for c in reader.connections if wanted is None or wanted(topics[c.id])]
                if chosen:
                    for connection, time, data in reader.messages(chosen):
                        yield Message(topics[connection.id], time, bytes(data))
        except (InputError, GeneratorExit):
            raise
        except Exception as error:
            # rosbags raises whatever its parsers stumble over: struct, key and type errors too.
            what = _one_line(error)
            raise InputError(f"{self.path}: damaged bag ({what}); fetch or record it again") from None

    def _topic(self, connection: Connection) -> Topic:
        if isinstance(connection.ext, ConnectionExtRosbag2):
            qos = metadata_text(dump_qos_v9(connection.ext.offered_qos_profiles))
        else:
            qos = metadata_text(TOPICS["/map"].qos()) if connection.ext.latching else ""
        return Topic(
            connection.topic,
            full_type(connection.msgtype),
            connection.msgdef.data,
            "ros1msg" if self.kind == "ros1" else "ros2" + connection.msgdef.format.name.lower(),
            qos if qos.strip() != "[]" else "",
            connection.digest if self.kind != "ros1" else "",
            "ros1" if self.kind == "ros1" else "cdr",
        )


def full_type(msgtype: str) -> str:
    """Type name with the middle part that ROS 1 leaves out."""
    parts = msgtype.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else msgtype


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:120] or type(error).__name__


def open_bag(path: Path) -> Bag:
    """The bag at a path: a record's folder, a rosbag2 folder or a single file, packed or not.

    InputError when there is no bag.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if path.is_dir():
        return _open_folder(path)
    kind = _kind_of(path)
    if kind is None:
        return _open_packed(path)
    return Bag(path, kind, [path], [])


def _kind_of(path: Path) -> str | None:
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    if not head:
        raise InputError(f"{path}: the file is empty")
    for magic, kind in MAGICS.items():
        if head.startswith(magic):
            return kind
    return None


def is_bag(path: Path) -> bool:
    """Whether a file is a bag by its first bytes or by its name."""
    return _kind_of(path) is not None or PurePosixPath(path.name.lower()).suffix in SUFFIXES


def _open_packed(path: Path) -> Bag:
    content, problem = read_unpacked(path)
    kind = next((kind for magic, kind in MAGICS.items() if content.startswith(magic)), None)
    if kind is None:
        if PurePosixPath(path.name.lower()).suffix in SUFFIXES:
            raise InputError(f"{path}: damaged bag, its first bytes are not those of any bag format")
        raise InputError(f"{path}: not a bag (.mcap, .db3, .bag or a rosbag2 folder)")
    folder = tempfile.TemporaryDirectory(prefix="turtlebag-")
    unpacked = Path(folder.name) / path.stem
    unpacked.write_bytes(content)
    bag = Bag(path, kind, [unpacked], [problem] if problem else [])
    bag._keep.append(folder)
    return bag


def _open_folder(path: Path) -> Bag:
    notes: list[str] = []
    folder = path / "bag" if (path / "bag").is_dir() else path
    if (folder / METADATA_FILE).is_file():
        try:
            return _from_metadata(path, folder)
        except (KeyError, TypeError, ValueError, AttributeError, OSError, yaml.YAMLError) as error:
            notes.append(f"{METADATA_FILE} cannot be used ({_one_line(error)}); reading the files beside it")
    for suffix, kind in SUFFIXES.items():
        files = sorted(folder.glob("*" + suffix), key=lambda file: (len(file.name), file.name))
        if files:
            if not notes:
                notes.append(f"{METADATA_FILE} is missing: the recording may be unfinished")
            return Bag(path, kind, files, notes)
    raise InputError(f"{path}: no bag in this folder (no {METADATA_FILE}, .mcap, .db3 or .bag file)")


def _from_metadata(path: Path, folder: Path) -> Bag:
    information = yaml.safe_load((folder / METADATA_FILE).read_text())["rosbag2_bagfile_information"]
    kind = str(information["storage_identifier"])
    if kind not in ("mcap", "sqlite3"):
        raise ValueError(f"unknown storage {kind!r}")
    if information.get("compression_mode", "").lower() not in ("", "none"):
        return Bag(path, "compressed", [folder], [])
    files = [folder / PurePosixPath(str(name)).name for name in information["relative_file_paths"]]
    missing = [file.name for file in files if not file.is_file()]
    if missing or not files:
        raise ValueError(f"it names {', '.join(missing) or 'no file'}")
    return Bag(path, kind, files, [])
