"""Locks an output, so that one process at a time writes it.

An output grows in `OUT.partial`. That folder contains a marker file and is locked (flock on
the folder itself, so the lock survives the rename, and ends with the process that holds it).
The command's inputs must lie elsewhere, and must not change while it runs.
"""

from __future__ import annotations

import itertools
import logging
import os
import re
import secrets
import shutil
import signal
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.files import Signature, require_same, signatures
from turtlebag.datasets.locks import close, is_locked, is_same, open_locked
from turtlebag.datasets.output_rules import check_free, identity, is_output, lineage, place_of, require_apart

MARKER = ".turtlebag-unfinished"
"""File in every folder that grows. It never is part of a finished output, nor of its hashes."""
_MARK = "turtlebag: this output is unfinished; the same command removes it and starts over\n"
_HIDDEN = ".turtlebag-"
SESSION = "session.yaml"
WORTH_SAVING = ("bag/*.mcap", "bags/*/*.mcap", SESSION)
"""What cannot be made again by the same command."""
_held: dict[Path, OutputLock] = {}


class OutputLock:
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
        self._reading = open_locked(usual, out) if read else None
        self.partial = out.with_name(out.name + (".recovering" if read else ".partial"))
        self._made_parents = _missing_parents(self.partial)
        self._folder = self._acquired()
        try:
            check_free(out, force=force, inputs=inputs)
        except InputError:  # another process was quicker by a hair
            self.release()
            raise

    def watch(self, inputs: Iterable[Path]) -> None:
        """Inputs that must not change from now on, and that the output must not overlap."""
        for path in inputs:
            require_apart(self.out, self.place, path)
            if path not in self._inputs and os.path.exists(path):
                self._inputs[path] = signatures(path)

    def begin(self, *, save_bag: bool = False) -> Path:
        """The folder to write into, rid of what a killed process left.

        With `save_bag` bags that were left are not removed but set aside, to be recovered; so is a session.
        """
        if self.growing:
            raise InputError(f"{self.out}: is already being written")
        if save_bag and any(next(self.partial.glob(left), None) for left in WORTH_SAVING):
            self._set_aside()
        self.growing = True
        self.clear()
        return self.partial

    def clear(self) -> None:
        """Remove what has grown; the lock stays."""
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
        for path in _left_over(self.place):
            _discard(path)

    def require_unchanged(self) -> None:
        """InputError when a file of the inputs is not the one it was when the lock was taken."""
        for path, before in self._inputs.items():
            require_same(path, before)

    def release(self) -> None:
        """Release the lock, and remove the folder if it is empty."""
        with suppress(OSError):
            if not self._kept and is_same(self._folder, self.partial):
                left = [path.name for path in self.partial.iterdir()]
                if self.growing or left == [MARKER]:
                    hidden = _hidden(self.partial)
                    self.partial.rename(hidden)  # at once: a kill from here on leaves nothing in the way
                    _discard(hidden)
        with suppress(OSError):
            for parent in self._made_parents:
                parent.rmdir()
        close(self._folder)
        close(self._reading)

    def _acquired(self) -> int:
        """Descriptor of `partial`, which is ours alone now: a new one, or what a killed process left."""
        while True:
            if not os.path.lexists(self.partial):
                folder = _created(self.partial)
                if folder is not None:
                    return folder
                continue  # another process was quicker
            folder = open_locked(self.partial, self.out)
            if folder is None or not is_same(folder, self.partial):  # it was finished in this moment
                close(folder)
                continue
            if _is_marked(self.partial):
                return folder
            close(folder)
            raise InputError(
                f"{self.partial}: is in the way and is not an unfinished output of turtlebag; "
                "move it or choose another --out"
            )

    def _set_aside(self) -> None:
        """Move an unfinished recording out of the way, under a name that is free."""
        names = (f"{self.out.name}.unfinished{'' if n == 1 else f'-{n}'}" for n in itertools.count(1))
        aside = next(path for name in names if not os.path.lexists(path := self.out.with_name(name)))
        self.partial.rename(aside)
        (aside / MARKER).unlink()
        close(self._folder)
        self._folder = self._acquired()
        if (aside / SESSION).exists():
            what, how = "session", f"`turtlebag studio --replay {aside / SESSION} --out DIR` replays it"
        else:
            what, how = "recording", f"`turtlebag bag recover {aside} --out DIR` saves it"
        logging.getLogger("turtlebag").warning("an unfinished %s is now %s; %s", what, aside, how)

    def _old_set_aside(self) -> Path | None:
        """Move the output to be replaced to a name of its own; None when there is none, or an empty one."""
        if not self.place.is_dir() or not any(self.place.iterdir()):
            return None
        old = self.place.with_name(f"{self.place.name}.old-{secrets.token_hex(4)}")
        self.place.rename(old)
        (old / MARKER).write_text(_MARK)
        return old


@contextmanager
def lock_output(out: Path, *, force: bool = False, inputs: Iterable[Path] = ()) -> Iterator[OutputLock]:
    """The lock of an output, or the surrounding command's, if it has one.

    InputError at once when the output may not be written, or another process is writing it.
    """
    held = _held.get(place_of(out))
    if held is not None:
        held.watch(inputs)
        yield held
        return
    with uninterrupted():
        lock = OutputLock(out, force=force, inputs=inputs)
        _held[lock.place] = lock
    try:
        yield lock
    finally:
        with uninterrupted():
            del _held[lock.place]
            lock.release()


def watch_inputs(folder: Path, inputs: Iterable[Path]) -> None:
    """Watch inputs, too, that were unknown when the lock of what grows in `folder`, if any, was taken."""
    for lock in _held.values():
        if lock.partial == folder:
            lock.watch(inputs)


def release_all() -> None:
    """Release every lock with what has grown in it: for a process that is about to end."""
    for lock in list(_held.values()):
        lock.release()


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Ctrl-C and termination wait until this is done."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _created(partial: Path) -> int | None:
    """Descriptor of a new marked and locked folder; None when the name is taken meanwhile.

    It is complete before it gets its name: no other process sees it without its mark or its lock.
    """
    hidden = _hidden(partial)
    folder = None
    try:
        hidden.mkdir(parents=True)
        folder = open_locked(hidden, partial)
        (hidden / MARKER).write_text(_MARK)
        hidden.rename(partial)
        return folder
    except OSError as error:
        _discard(hidden)
        close(folder)
        if folder is not None and os.path.lexists(partial):
            return None
        raise InputError(f"{partial}: cannot be created ({error.strerror})") from None


def _is_marked(folder: Path) -> bool:
    path = folder / MARKER
    return path.is_file() and path.read_bytes().startswith(b"turtlebag")


def _missing_parents(path: Path) -> list[Path]:
    """Folders that have to be made for a path, the innermost first."""
    return [parent for parent in path.parents if not parent.exists()]


def _hidden(path: Path) -> Path:
    """A name of its own beside a path, for what is coming or going."""
    return path.with_name(f"{_HIDDEN}{secrets.token_hex(8)}")


def _left_over(place: Path) -> list[Path]:
    """What an output replaced, and what killed processes left beside it: files of ours that no process
    uses."""
    found = []
    for path in place.parent.iterdir():
        old = re.fullmatch(re.escape(place.name) + r"\.old-[0-9a-f]{8}", path.name) is not None
        if not (old or path.name.startswith(_HIDDEN)) or path.is_symlink() or not path.is_dir():
            continue
        if (_is_marked(path) or (old and is_output(path))) and not is_locked(path):
            found.append(path)
    return found


def _discard(folder: Path) -> None:
    """Remove a folder as far as that goes, its mark last: what a kill leaves of it is known again."""
    with suppress(OSError):
        for path in folder.iterdir():
            if path.name != MARKER:
                _remove(path)
        shutil.rmtree(folder)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()
