"""The bags of a campaign: what its patterns name, by URL."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

from turtlebag.datasets.bags.source import LOGS, PACKED, SUFFIXES
from turtlebag.datasets.bags.topics import METADATA_FILE
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import sha256_text
from turtlebag.datasets.urls import filesystem, is_local
from turtlebag.pipeline.campaign.store import or_else

RECORDED = tuple(kind + packed for kind in (*SUFFIXES, *LOGS) for packed in ("", *PACKED, ".zstd"))


def find_bags(patterns: Sequence[str]) -> dict[str, str]:
    """URL of each bag that the patterns name, sorted within a pattern, and what changes when it does.

    A pattern is the URL of a file or of a folder, or has * in it. A folder that holds metadata.yaml is one
    bag, and so is a record's; of any other each bag and log below it is one. InputError for a pattern that
    nothing fits; a file that is named and not there is a bag that cannot be read.
    """
    found: dict[str, str] = {}
    for pattern in patterns:
        with or_else(f"bags: {pattern}: cannot be listed"):
            bags = _of_pattern(pattern)
        if not bags:
            raise InputError(f"bags: {pattern}: no bag or log matches it; check the pattern")
        found |= dict(sorted(bags.items()))
    return found


def _of_pattern(pattern: str) -> dict[str, str]:
    files, path = filesystem(pattern)
    if "*" in path or "?" in path or "[" in path:
        entries = files.glob(path, detail=True)
    elif files.exists(path):
        entries = {path: files.info(path)}
    else:
        return {pattern: ""}
    bags: dict[str, str] = {}
    for name, info in entries.items():
        bags |= bags_below(files, name) if info["type"] == "directory" else {name: _version(info)}
    return {name if is_local(files) else files.unstrip_protocol(name): made for name, made in bags.items()}


def bags_below(files: Any, folder: str) -> dict[str, str]:
    """The bags in a folder of a file system of fsspec, and what changes when they do; "" is its top."""
    inside: Mapping[str, Any] = files.find(folder, detail=True)
    wholes = {_parent(path) for path in inside if path.rpartition("/")[2] == METADATA_FILE}
    wholes = {_parent(path) if path.endswith("/bag") else path for path in wholes}
    bags: dict[str, str] = {}
    parts: dict[str, list[str]] = defaultdict(list)
    for path, info in inside.items():
        whole = _parent(path)  # in the end the innermost bag that holds it, if one does
        while whole not in wholes and len(whole) > len(folder):
            whole = _parent(whole)
        if whole in wholes:
            parts[whole].append(_version(info))
        elif path.lower().endswith(RECORDED):
            bags[path] = _version(info)
    return bags | {whole: sha256_text(repr(versions)) for whole, versions in parts.items()}


def _parent(path: str) -> str:
    return path.rpartition("/")[0]


def _version(info: Mapping[str, Any]) -> str:
    """What a store says of a file that is another when its content is: its ETag, else its size and time."""
    return str(info.get("ETag") or (info["size"], info.get("mtime", info.get("created"))))
