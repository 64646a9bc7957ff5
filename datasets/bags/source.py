"""Open a bag of any kind: its files, and its messages in order."""

from __future__ import annotations

import re
import sqlite3
import tempfile
import weakref
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

import yaml

from turtlebag.datasets.bags.decode import Cursor, Ros1Cursor
from turtlebag.datasets.bags.mcap_index import MAGIC
from turtlebag.datasets.bags.mcap_sequential import McapReader
from turtlebag.datasets.bags.ros1_sequential import ROS1_MAGIC, Ros1Reader
from turtlebag.datasets.bags.topics import (
    CUSTOM_RECORD,
    METADATA_FILE,
    Message,
    Topic,
    Wanted,
    full_type,
    metadata_text,
    qos_profiles,
)
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.files import (
    chunk_bound,
    opened_plain,
    read_unpacked,
    require_same,
    signatures,
    unchanged,
    unpack_zstd,
    unpack_zstd_file,
)
from turtlebag.datasets.findings import Finding, lines_of
from turtlebag.datasets.yaml_files import plain_values

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

MAGICS = {MAGIC: "mcap", b"SQLite format 3\0": "sqlite3", ROS1_MAGIC: "ros1"}
_OLD_ROS1 = re.compile(rb"#ROS(?:RECORD|LOG) V(\d\.\d)")
SUFFIXES = {".mcap": "mcap", ".db3": "sqlite3", ".bag": "ros1"}
LOGS, PACKED = (".clf", ".log"), (".gz", ".bz2")
"""Endings of CARMEN logs, and what may follow the ending of a bag or log."""
_STOPPED = "read up to there; `turtlebag bag recover` also saves what follows"
TRUTH_PREFIX = "/ground_truth"


class Bag:
    """A bag: its files in order. `findings` grows while messages are read."""

    def __init__(
        self,
        path: Path,
        kind: str,
        files: list[Path],
        findings: list[Finding],
        custom: Mapping[str, str] | None = None,
        *,
        packed_messages: bool = False,
        keep: tempfile.TemporaryDirectory | None = None,
    ) -> None:
        self.path, self.kind, self.files, self.findings = path, kind, files, findings
        self._custom = dict(custom or {})
        self._packed = packed_messages
        if keep is not None:  # the folder of unpacked files lives as long as the bag
            weakref.finalize(self, keep.cleanup)
        self._before = {file: signatures(file) for file in files}

    def messages(self, wanted: Wanted | None = None, *, step_over: bool = False) -> Iterator[Message]:
        """Messages of the wanted topics (all without `wanted`), file after file.

        At damage reading ends, or with `step_over` goes on where the file is whole again. InputError when
        a file has changed since the bag was opened.
        """
        for file in self.files:
            messages = _messages_of(file, self.kind, wanted, self.findings, step_over=step_over)
            yield from self._unpacked(messages, file) if self._packed else messages
            require_same(file, self._before[file])

    @property
    def notes(self) -> list[str]:
        """The findings, a line each."""
        return list(lines_of(self.findings))

    def _unpacked(self, messages: Iterator[Message], file: Path) -> Iterator[Message]:
        """Messages that were compressed each by itself."""
        for count, message in enumerate(messages):
            try:
                data = unpack_zstd(message.data, chunk_bound(len(message.data)))
            except ValueError as error:
                what = f"damaged after {count} messages ({error})"
                self.findings.append(Finding("damaged file", file.name, what, remedy="read up to there"))
                return
            yield message._replace(data=data)

    def custom_data(self) -> dict[str, str]:
        """What the recorder noted of the recording (seed and the like), as far as it can be read."""
        if self.kind == "mcap":
            for file in self.files:
                found = McapReader(file).leading_metadata(CUSTOM_RECORD)
                if found:
                    return found
        return self._custom

    def cursor(self, data: bytes) -> Cursor:
        """A field reader for a message's bytes."""
        return Ros1Cursor(data) if self.kind == "ros1" else Cursor(data)


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
    with opened_plain(path) as file:
        head = file.read(16)
    if not head:
        raise InputError(f"{path}: the file is empty")
    return _kind_by(head, path)


def _kind_by(head: bytes, path: Path) -> str | None:
    if old := _OLD_ROS1.match(head):
        version = old[1].decode()
        way = (
            "ROS 1's `rosbag reindex` converts it to version 2.0"
            if version == "1.2"
            else ("ROS 1's own rosbag refuses it too; only a ROS release of its time can convert it")
        )
        raise InputError(
            f"{path}: a ROS 1 bag of version {version}, older than the 2.0 that is read here; {way}"
        )
    return next((kind for magic, kind in MAGICS.items() if head.startswith(magic)), None)


def is_bag(path: Path) -> bool:
    """Whether a file is a bag by its first bytes or by its name."""
    return _kind_of(path) is not None or PurePosixPath(path.name.lower()).suffix in SUFFIXES


def is_carmen_log(path: Path) -> bool:
    """Whether a file is a CARMEN log, by its name."""
    endings = path.name.lower().split(".")[1:]
    return path.is_file() and not is_bag(path) and bool({"clf", "log", "carmen"} & set(endings))


def _open_packed(path: Path) -> Bag:
    content, problem = read_unpacked(path)
    kind = _kind_by(content, path)
    if kind is None:
        if PurePosixPath(path.name.lower()).suffix in SUFFIXES:
            raise InputError(f"{path}: damaged bag, its first bytes are not those of any bag format")
        raise InputError(f"{path}: not a bag (.mcap, .db3, .bag or a rosbag2 folder)")
    folder = tempfile.TemporaryDirectory(prefix="turtlebag-")
    unpacked = Path(folder.name) / path.stem
    unpacked.write_bytes(content)
    findings = [Finding("damaged file", "", problem)] if problem else []
    return Bag(path, kind, [unpacked], findings, keep=folder)


def _open_folder(path: Path) -> Bag:
    findings: list[Finding] = []
    folder = path / "bag" if (path / "bag").is_dir() else path
    if (folder / METADATA_FILE).is_file():
        try:
            return _from_metadata(path, folder)
        except OSError as error:
            # Nothing is wrong with the bag: who may not read it is told so, once, before any work.
            raise InputError(f"{folder / METADATA_FILE}: cannot be read ({error.strerror})") from None
        except (KeyError, TypeError, ValueError, AttributeError, yaml.YAMLError) as error:
            what = f"{METADATA_FILE} cannot be used ({one_line(error)})"
            findings.append(Finding("missing metadata", "", what, remedy="the files beside it are read"))
    for suffix, kind in SUFFIXES.items():
        files = sorted(folder.glob("*" + suffix), key=lambda file: (len(file.name), file.name))
        if files:
            if not findings:
                what = f"{METADATA_FILE} is missing: the recording may be unfinished"
                findings.append(Finding("missing metadata", "", what))
            if kind == "ros1":
                for file in files:
                    _kind_of(file)  # which names an older version
            return Bag(path, kind, files, findings)
    raise InputError(f"{path}: no bag in this folder (no {METADATA_FILE}, .mcap, .db3 or .bag file)")


def _from_metadata(path: Path, folder: Path) -> Bag:
    content = plain_values((folder / METADATA_FILE).read_text())
    information = content["rosbag2_bagfile_information"]
    kind = str(information["storage_identifier"])
    if kind not in ("mcap", "sqlite3"):
        raise ValueError(f"unknown storage {kind!r}")
    custom = {str(key): str(value) for key, value in (information.get("custom_data") or {}).items()}
    files = [folder / PurePosixPath(str(name)).name for name in information["relative_file_paths"]]
    missing = [file.name for file in files if not file.is_file()]
    if missing or not files:
        raise ValueError(f"it names {', '.join(missing) or 'no file'}")
    mode = str(information.get("compression_mode") or "none").lower()
    if mode != "none" and information.get("compression_format") != "zstd":
        raise InputError(
            f"{folder}: its compression {information.get('compression_format')!r} is not supported"
        )
    if mode == "file":
        unpacked = tempfile.TemporaryDirectory(prefix="turtlebag-")
        files = [_unpacked_file(file, Path(unpacked.name)) for file in files]
        return Bag(path, kind, files, [], custom, keep=unpacked)
    return Bag(path, kind, files, [], custom, packed_messages=mode == "message")


def _unpacked_file(file: Path, folder: Path) -> Path:
    """A storage file that was compressed as a whole, unpacked into `folder`."""
    target = folder / file.stem
    with unchanged(file):
        unpack_zstd_file(file, target)
    return target


def _messages_of(
    path: Path, kind: str, wanted: Wanted | None, findings: list[Finding], *, step_over: bool
) -> Iterator[Message]:
    """Messages of the wanted topics of a file of that kind, in its order.

    Problems are appended to `findings`; damage ends the reading or, where that can be, is stepped over.
    """
    if kind == "sqlite3":
        yield from _sqlite3_messages(path, wanted, findings)
        return
    file = McapReader(path) if kind == "mcap" else Ros1Reader(path)
    yield from file.messages(wanted, step_over=step_over)
    findings += _damage(path, file.state.problems, stopped=file.state.stopped)


def _sqlite3_messages(path: Path, wanted: Wanted | None, findings: list[Finding]) -> Iterator[Message]:
    """sqlite3 storage, read by rosbags."""
    from rosbags.rosbag2 import Reader  # slow to import, and most bags are mcap

    count = 0
    try:
        _require_readable_qos(path)
        with Reader(path) as reader:
            topics = {connection.id: _sqlite3_topic(connection) for connection in reader.connections}
            chosen = [c for c in reader.connections if wanted is None or wanted(topics[c.id])]
            for connection, time, data in reader.messages(chosen) if chosen else ():
                yield Message(topics[connection.id], time, bytes(data))
                count += 1
    except (InputError, GeneratorExit):
        raise
    except Exception as error:
        # rosbags raises whatever its parsers stumble over: struct, key and type errors too.
        if not count:
            raise InputError(f"{path}: damaged bag ({one_line(error)}); fetch or record it again") from None
        findings += _damage(path, [f"damaged after {count} messages ({one_line(error)})"], stopped=True)
    else:
        with path.open("rb") as file:
            page = int.from_bytes(file.read(18)[16:], "big")
        if path.stat().st_size % (page if page > 1 else 1 << 16):  # SQLite takes what is missing for zeros
            what = "cut off inside its last page: messages may be missing or damaged"
            findings.append(Finding("damaged file", path.name, what))


def _require_readable_qos(path: Path) -> None:
    """yaml.YAMLError or ValueError unless rosbags, which reads it without a bound, can read what the topics
    offer."""
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?immutable=1", uri=True)) as file:
        if any(column[1] == "offered_qos_profiles" for column in file.execute("PRAGMA table_info(topics)")):
            for (qos,) in file.execute("SELECT offered_qos_profiles FROM topics"):
                qos_profiles(qos)


def one_line(error: Exception) -> str:
    """An error's message in one line, for a note."""
    return " ".join(str(error).split())[:120] or type(error).__name__


def _sqlite3_topic(connection: Connection) -> Topic:
    from rosbags.interfaces import ConnectionExtRosbag2
    from rosbags.rosbag2.metadata import dump_qos_v9

    qos = ""
    if isinstance(connection.ext, ConnectionExtRosbag2) and connection.ext.offered_qos_profiles:
        qos = metadata_text(dump_qos_v9(connection.ext.offered_qos_profiles))
    form, text = connection.msgdef.format.name.lower(), connection.msgdef.data
    return Topic(connection.topic, full_type(connection.msgtype), text, "ros2" + form, qos, connection.digest)


def _damage(path: Path, problems: list[str], *, stopped: bool) -> list[Finding]:
    """The problems of a file; reading stopped at the last one or went on."""
    findings = [Finding("damaged file", path.name, problem) for problem in problems]
    if stopped:
        findings[-1] = replace(findings[-1], remedy=_STOPPED)
    return findings
