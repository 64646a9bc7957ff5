"""Where a campaign keeps what it makes: objects below a URL, each of them whole or absent.

A folder, `memory://` or a bucket, through fsspec. An object is put in one piece: who is killed meanwhile
leaves none.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.urls import filesystem, is_local, reason_of

UNFINISHED = ".unfinished"
"""Folder of a local store in which objects grow, to be moved to their names."""
_MANY = 1000


@contextmanager
def or_else(failure: str) -> Iterator[None]:
    """InputError, `failure` and why, for whatever a store's client raises: errors of its own libraries."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{failure} ({reason_of(error)})") from None


@dataclass(frozen=True)
class Store:
    """Objects by name, `part/of/name`, below `url`: a folder's path or what fsspec knows."""

    url: str

    @cached_property
    def _place(self) -> tuple[Any, str]:
        return filesystem(self.url)

    def __getstate__(self) -> dict[str, str]:
        return {"url": self.url}  # connections stay with the process that made them

    @property
    def files(self) -> Any:
        """The file system of fsspec."""
        return self._place[0]

    @property
    def is_local(self) -> bool:
        """Whether it is a folder of this machine."""
        return is_local(self.files)

    def at(self, name: str) -> str:
        """The path of an object in its file system."""
        return f"{self._place[1]}/{name}"

    def below(self, name: str) -> Store:
        """The part of the store whose names begin with `name/`."""
        return Store(f"{self.url.rstrip('/')}/{name}")

    def put(self, name: str, content: bytes) -> None:
        """Write an object, in the place of the one that may be there."""
        if self.is_local:
            growing = self._made(f"{UNFINISHED}/{secrets.token_hex(8)}")
            growing.write_bytes(content)
            growing.replace(self._made(name))
        else:
            self.files.pipe_file(self.at(name), content)

    def read(self, name: str) -> bytes | None:
        """Content of an object; None when there is none."""
        try:
            return bytes(self.files.cat_file(self.at(name)))
        except FileNotFoundError:
            return None

    def read_all(self, names: Iterable[str]) -> Iterator[bytes]:
        """Contents of objects that are there, in their order, many at a time."""
        left = iter(names)
        while chosen := [self.at(name) for name in islice(left, _MANY)]:
            found = self.files.cat(chosen)
            yield from (bytes(found[path]) for path in chosen)

    def has(self, name: str) -> bool:
        """Whether there is such an object."""
        return bool(self.files.exists(self.at(name)))

    def names(self, part: str) -> list[str]:
        """Names of all objects below `part`, sorted, beginning with it."""
        files, root = self._place
        try:
            found = files.find(self.at(part))
        except FileNotFoundError:
            return []
        return sorted(str(path)[len(root) + 1 :] for path in found)

    def delete(self, name: str) -> None:
        """Remove an object, if it is there."""
        with suppress(FileNotFoundError):
            self.files.rm_file(self.at(name))

    def delete_below(self, part: str) -> None:
        """Remove all objects whose names begin with `part/`."""
        with suppress(FileNotFoundError):
            self.files.rm(self.at(part), recursive=True)

    def _made(self, name: str) -> Path:
        path = Path(self.at(name))
        path.parent.mkdir(parents=True, exist_ok=True)
        return path
