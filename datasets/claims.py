"""Who may write an output: one process at a time.

An output grows in `OUT.partial`. That folder bears a file by which we know it again, and is locked (flock on
the folder itself, so that the lock goes with it when it is renamed, and ends with the process that holds it).
What the command reads must lie apart from it and be the same at the end as at the beginning.
"""

from __future__ import annotations

import fcntl
import itertools
import logging
import os
import secrets
import shutil
import signal
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from datasets.errors import InputError
from datasets.files import Signature, require_same, signatures
from datasets.places import check_free, identity, lineage, place_of, require_apart

MARKER = ".turtlebag-unfinished"
"""File in every folder that grows. It never is part of a finished output, nor of its hashes."""
_MARK = "turtlebag: this output is unfinished; the same command removes it and begins anew\n"
_held: dict[Path, Claim] = {}


class Claim:
    """The right to write one output, held until `release`."""

    def __init__(self, out: Path, *, force: bool, inputs: Iterable[Path]) -> None:
        self.out, self.force = out, force
        self.place = place_of(out)
        self.growing = False
        self._inputs: dict[Path, dict[Path, Signature]] = {}
        self._kept = False
        inputs = list(inputs)
        check_free(out, force=force, inputs=inputs)
        self.watch(inputs)
        # An unfinished recording may be the input: then its folder is not ours to grow in, but locked too.
        usual = out.with_name(out.name + ".partial")
        read = any(identity(usual) in lineage(path) for path in inputs) if usual.is_dir() else False
        self._reading = _open_locked(usual, out) if read else None
        self.partial = out.with_name(out.name + (".recovering" if read else ".partial"))
        self._made_parents = _missing_parents(self.partial)
        self._folder = self._acquired()
        try:
            check_free(out, force=force, inputs=inputs)
        except InputError:  # another process was quicker by a hair
            self.release()
            raise

    def watch(self, inputs: Iterable[Path]) -> None:
        """From now on these must not change, and the output must lie apart from them."""
        for path in inputs:
            require_apart(self.out, self.place, path)
            if path not in self._inputs and os.path.exists(path):
                self._inputs[path] = signatures(path)

    def begin(self, *, save_bag: bool = False) -> Path:
        """The folder to write into, rid of what a killed process left.

        With `save_bag` a bag that was left is not removed but set aside, to be recovered.
        """
        if self.growing:
            raise InputError(f"{self.out}: is being written already")
        if save_bag and any((self.partial / "bag").glob("*.mcap")):
            self._set_aside()
        self.growing = True
        self.clear()
        return self.partial

    def clear(self) -> None:
        """Remove what has grown; the claim stays."""
        if self._kept:
            return
        for path in self.partial.iterdir():
            if path.name != MARKER:
                _remove(path)

    def finish(self, file: Path | None = None) -> None:
        """Put the folder, or a single file of it, in the output's place; InputError when that is not free.

        What stood there goes last, and no signal comes between.
        """
        self.require_unchanged()
        with uninterrupted():
            try:
                check_free(self.out, force=self.force, kind="folder" if file is None else "file")
            except InputError as error:
                (self.partial / MARKER).unlink()
                self._kept = True
                raise InputError(f"{error}; the result is kept in {self.partial}") from None
            if file is not None:
                file.replace(self.place)
                return
            old = self._old_set_aside()
            try:
                self.partial.rename(self.place)
            except OSError:
                if old is not None:
                    old.rename(self.place)
                raise
            (self.place / MARKER).unlink()
        for path in _replaced(self.place):
            shutil.rmtree(path, ignore_errors=True)

    def require_unchanged(self) -> None:
        """InputError when a file of the inputs is not the one it was when the claim was made."""
        for path, before in self._inputs.items():
            require_same(path, before)

    def release(self) -> None:
        """Give up the claim; a folder in which nothing grew goes with it."""
        with suppress(OSError):
            if not self._kept and _same(self._folder, self.partial):
                left = [path.name for path in self.partial.iterdir()]
                if self.growing or left == [MARKER]:
                    shutil.rmtree(self.partial, ignore_errors=True)
        with suppress(OSError):
            for parent in self._made_parents:
                parent.rmdir()
        _close(self._folder)
        _close(self._reading)

    def _acquired(self) -> int:
        """Descriptor of `partial`, which is ours alone now: a new one, or what a killed process left."""
        while True:
            if not os.path.lexists(self.partial):
                folder = _created(self.partial)
                if folder is not None:
                    return folder
                continue  # another process was quicker
            folder = _open_locked(self.partial, self.out)
            if folder is None or not _same(folder, self.partial):  # it was finished in this moment
                _close(folder)
                continue
            if _is_marked(self.partial):
                return folder
            _close(folder)
            raise InputError(
                f"{self.partial}: is in the way and no unfinished output of turtlebag; "
                "move it or choose another --out"
            )

    def _set_aside(self) -> None:
        """Move an unfinished recording out of the way, under a name that is free."""
        names = (f"{self.out.name}.unfinished{'' if n == 1 else f'-{n}'}" for n in itertools.count(1))
        aside = next(path for name in names if not os.path.lexists(path := self.out.with_name(name)))
        self.partial.rename(aside)
        (aside / MARKER).unlink()
        _close(self._folder)
        self._folder = self._acquired()
        logging.getLogger("turtlebag").warning(
            "an unfinished recording is now %s; `turtlebag bag recover %s --out DIR` saves it", aside, aside
        )

    def _old_set_aside(self) -> Path | None:
        """Move the output to be replaced to a name of its own; None when there is none, or an empty one."""
        if not self.place.is_dir() or not any(self.place.iterdir()):
            return None
        (self.place / MARKER).write_text(_MARK)
        old = self.place.with_name(f"{self.place.name}.old-{secrets.token_hex(4)}")
        self.place.rename(old)
        return old


@contextmanager
def claimed(out: Path, *, force: bool = False, inputs: Iterable[Path] = ()) -> Iterator[Claim]:
    """The claim to an output, that of the surrounding command where there is one already.

    InputError at once when the output may not be written, or another process is writing it.
    """
    held = _held.get(place_of(out))
    if held is not None:
        held.watch(inputs)
        yield held
        return
    with uninterrupted():
        claim = Claim(out, force=force, inputs=inputs)
        _held[claim.place] = claim
    try:
        yield claim
    finally:
        with uninterrupted():
            del _held[claim.place]
            claim.release()


def watch_inputs(folder: Path, inputs: Iterable[Path]) -> None:
    """Hold the claim that grows in `folder`, if any, to inputs that were not known when it was made."""
    for claim in _held.values():
        if claim.partial == folder:
            claim.watch(inputs)


def release_all() -> None:
    """Give up every claim with what has grown in it: for a process that is about to end."""
    for claim in list(_held.values()):
        claim.release()


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Ctrl-C and termination wait until this is done."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _open_locked(folder: Path, out: Path) -> int | None:
    """Descriptor of a folder with its lock; None when there is none any more.

    InputError when another process has the lock, or what is there is no folder.
    """
    try:
        opened = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except FileNotFoundError:
        return None
    except NotADirectoryError:
        raise InputError(f"{folder}: is in the way and no folder; move it or choose another --out") from None
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({error.strerror})") from None
    try:
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        _close(opened)
        if not isinstance(error, BlockingIOError):
            raise InputError(f"{folder}: cannot be locked ({error.strerror})") from None
        raise InputError(
            f"{out}: another process is writing it (in {folder}); wait for it or choose another --out"
        ) from None
    return opened


def _created(partial: Path) -> int | None:
    """Descriptor of a new marked and locked folder; None when the name is taken meanwhile.

    It is complete before it gets its name: no other process sees it without its mark or its lock.
    """
    hidden = partial.with_name(f".turtlebag-{secrets.token_hex(8)}")
    folder = None
    try:
        hidden.mkdir(parents=True)
        (hidden / MARKER).write_text(_MARK)
        folder = _open_locked(hidden, partial)
        hidden.rename(partial)
        return folder
    except OSError as error:
        shutil.rmtree(hidden, ignore_errors=True)
        _close(folder)
        if folder is not None and os.path.lexists(partial):
            return None
        raise InputError(f"{partial}: cannot be created ({error.strerror})") from None


def _close(folder: int | None) -> None:
    """Close a descriptor, and with it give up its lock."""
    if folder is not None:
        with suppress(OSError):  # given up before, by a process that was told to end while it did so
            os.close(folder)


def _same(folder: int, path: Path) -> bool:
    status = os.fstat(folder)
    return (status.st_dev, status.st_ino) == identity(path)


def _is_marked(folder: Path) -> bool:
    path = folder / MARKER
    return path.is_file() and path.read_bytes().startswith(b"turtlebag")


def _missing_parents(path: Path) -> list[Path]:
    """Folders that have to be made for a path, the innermost first."""
    return [parent for parent in path.parents if not parent.exists()]


def _replaced(place: Path) -> list[Path]:
    """What outputs replaced that stood at a place, this time or by a process that was killed meanwhile."""
    named = (path for path in place.parent.iterdir() if path.name.startswith(f"{place.name}.old-"))
    return [path for path in named if path.is_dir() and not path.is_symlink() and _is_marked(path)]


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()
