"""Locks an output, so that one process at a time writes it.

An output grows in `OUT.partial`, which holds a marker file that is locked: the lock survives the renaming of
the folder, and ends with the process that holds it. The command's inputs must lie elsewhere, and must not
change while it runs.
"""

from __future__ import annotations

import fcntl
import glob
import itertools
import logging
import os
import secrets
import shutil
import signal
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from turtlebag.datasets.errors import InputError, Unfinished
from turtlebag.datasets.files import JUNK, Signature, require_same, signatures
from turtlebag.datasets.output_rules import (
    MANIFEST,
    MARKER,
    identity,
    lineage,
    place_of,
    require_apart,
    require_free,
    require_untouched,
    strangers,
)

SESSION = "session.yaml"
WORTH_SAVING = ("bag/*.mcap", "bags/*/*.mcap", SESSION)
"""Patterns of recordings and sessions, which cannot simply be made again."""
log = logging.getLogger("turtlebag")
_held: dict[Path, OutputLock] = {}


class OutputLock:
    """The right to write one output, held until `release`."""

    def __init__(self, out: Path, *, force: bool, inputs: Iterable[Path]) -> None:
        self.out, self.force, self.place = out, force, place_of(out)
        self._growing = self._kept = False
        self._inputs: dict[Path, dict[Path, Signature]] = {}
        inputs = list(inputs)
        self.watch(inputs)
        require_free(out, force=force)
        # An unfinished recording may be the input: then its folder is not ours to grow in, but locked too.
        usual = out.with_name(f"{out.name}.partial")
        read = usual.is_dir() and any(identity(usual) in lineage(path) for path in inputs)
        self._reading = _locked(usual / MARKER, out) if read and (usual / MARKER).exists() else None
        self.partial = out.with_name(f"{out.name}.recovering") if read else usual
        self._made_parents = [parent for parent in self.partial.parents if not parent.exists()]
        self._mark = self._acquired()
        try:
            require_free(out, force=force)  # another process may have been quicker
            require_untouched(out)
        except (InputError, OSError):
            self.release()
            raise

    def watch(self, inputs: Iterable[Path]) -> None:
        """Inputs that must not change from now on, and that the output must not overlap."""
        for path in inputs:
            require_apart(self.out, self.place, path)
            if path not in self._inputs and os.path.exists(path):
                self._inputs[path] = signatures(path)

    @contextmanager
    def growth(self, *, save_bag: bool = False) -> Iterator[Path]:
        """The folder to write into, rid of what a killed process left, and of what has grown when that fails.

        With `save_bag` a bag or session in it is set aside when the disk is full, the work fails or raises
        Unfinished; bad input and Ctrl-C leave nothing.
        """
        if self._growing:
            raise InputError(f"{self.out}: is already being written")
        self.spare()
        self._growing = True
        try:
            self._clear()
            yield self.partial
        except Exception as error:
            refused = isinstance(error, InputError) and not isinstance(error, Unfinished)
            kept = self._rescued() if save_bag and not refused else None
            if kept and isinstance(error, OSError):
                raise Unfinished(f"{error.filename or self.out}: {error.strerror or error}; {kept}") from None
            if kept and isinstance(error, Unfinished):
                raise Unfinished(f"{error}; {kept}", error.code) from None
            if kept:
                log.error(kept)  # where somebody's data went is said to -q too
            raise
        finally:
            with suppress(OSError):
                self._clear()
            self._growing = False

    def spare(self) -> None:
        """Set aside a bag or a session that a killed process left."""
        if self._worth_saving():
            log.error("what an unfinished command left is now in %s", _way_out(self._set_aside()))
            before, self._mark = self._mark, self._acquired()
            _close(before)

    def finish(self, file: Path | None = None) -> None:
        """Put the folder, or a single file of it, in the output's place; InputError when that cannot be done,
        which leaves there what is there, and what is finished where it is.

        What stood there goes last, and no signal comes between.
        """
        for path, before in self._inputs.items():
            require_same(path, before)
        try:
            require_free(self.out, force=self.force, kind="folder" if file is None else "file")
            require_untouched(self.out)
            with uninterrupted():
                old = self._swapped(file or self.partial)
        except (InputError, OSError) as error:
            self._kept = True
            with suppress(OSError):
                (self.partial / MARKER).unlink()
            said = error if isinstance(error, InputError) else f"{self.out}: {error.strerror}"
            raise InputError(f"{said}; the result is kept in {file or self.partial}") from None
        try:
            for path in _left_over(self.place, old):
                _empty(path, but=MANIFEST)  # last: what a kill leaves is known again
                shutil.rmtree(path)
        except OSError as error:
            if old is not None:
                log.warning("%s: what was replaced cannot be removed (%s)", old, error.strerror)

    def release(self) -> None:
        """Release the lock, and remove the folder if nothing is in it that a killed process left."""
        with suppress(OSError):
            if self._is_ours() and (self._growing or not _content(self.partial)):
                self._clear()
                shutil.rmtree(self.partial)
        self._remove_parents()
        _close(self._mark)
        _close(self._reading)

    def _remove_parents(self) -> None:
        with suppress(OSError):
            for parent in self._made_parents:
                parent.rmdir()

    def _acquired(self) -> int:
        """Descriptor of the mark in `partial`, ours alone now: a new one, or what a killed process left."""
        mark, opened = self.partial / MARKER, None
        try:
            while opened is None or not _is_same(opened, mark):  # else it was finished in this moment
                _close(opened)
                self.partial.mkdir(parents=True, exist_ok=True)
                if self.partial.is_symlink() or (_content(self.partial) and not mark.exists()):
                    raise FileExistsError
                opened = _locked(mark, self.out)
            return opened
        except FileExistsError:
            raise InputError(
                f"{self.partial}: is in the way and is not an unfinished output of turtlebag; "
                "move it or choose another --out"
            ) from None
        except OSError as error:
            with suppress(OSError):
                self.partial.rmdir()
            self._remove_parents()
            raise InputError(f"{self.partial}: cannot be created ({error.strerror})") from None

    def _clear(self) -> None:
        """Remove what has grown, if it is still there and shall not be kept."""
        if self._is_ours():
            _empty(self.partial, but=MARKER)

    def _is_ours(self) -> bool:
        return not self._kept and _is_same(self._mark, self.partial / MARKER)

    def _rescued(self) -> str | None:
        """Set aside a bag or a session that has grown, and say where it is; None where there is none."""
        if not self._worth_saving():
            return None
        try:
            aside = self._set_aside()
        except OSError:
            self._kept, aside = True, self.partial
        return f"what was recorded is kept in {_way_out(aside)}"

    def _worth_saving(self) -> bool:
        return self._is_ours() and any(next(self.partial.glob(kind), None) for kind in WORTH_SAVING)

    def _set_aside(self) -> Path:
        """Move what has grown to `OUT.unfinished`, or the first such name that is free."""
        names = (f"{self.out.name}.unfinished{'' if n == 1 else f'-{n}'}" for n in itertools.count(1))
        aside = next(path for name in names if not os.path.lexists(path := self.out.with_name(name)))
        self.partial.rename(aside)
        (aside / MARKER).unlink()
        return aside

    def _swapped(self, new: Path) -> Path | None:
        """Move it into the place; where to the folder went that stood there, if it was not empty."""
        old = None
        if self.place.is_dir() and any(self.place.iterdir()):
            old = self.place.with_name(f"{self.place.name}.old-{secrets.token_hex(4)}")
            self.place.rename(old)
        try:
            new.replace(self.place)
        except OSError:
            if old is not None:
                old.rename(self.place)
            raise
        if new is self.partial:
            with suppress(OSError):
                (self.place / MARKER).unlink()
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
    """Ctrl-C, termination and hang-up wait until this is done."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _way_out(aside: Path) -> str:
    """A folder that was set aside, and the command that makes a finished output of it."""
    session = aside / SESSION
    how = f"studio --replay {session}" if session.exists() else f"bag recover {aside}"
    return f"{aside} (`turtlebag {how} --out DIR` makes a finished output of it)"


def _locked(mark: Path, out: Path) -> int | None:
    """Descriptor of a mark, which is locked; None if its folder is gone.

    InputError when another process has the lock.
    """
    opened = None
    try:
        opened = os.open(mark, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except FileNotFoundError:
        return None
    except BlockingIOError:
        _close(opened)
        raise InputError(
            f"{out}: another process is writing it (in {mark.parent}); wait for it or choose another --out"
        ) from None
    return opened


def _close(mark: int | None) -> None:
    """Close a descriptor, and with it give up its lock."""
    if mark is not None:
        with suppress(OSError):  # given up before, by a process that was told to end while it did so
            os.close(mark)


def _is_same(opened: int, path: Path) -> bool:
    """Whether a descriptor is still that of the file at a path."""
    status = os.fstat(opened)
    return (status.st_dev, status.st_ino) == identity(path)


def _content(folder: Path) -> list[Path]:
    return [path for path in folder.iterdir() if path.name not in (MARKER, *JUNK)]


def _left_over(place: Path, old: Path | None) -> Iterator[Path]:
    """What was replaced, now and by processes that were killed before they removed it."""
    if old is not None:
        yield old
    for path in place.parent.glob(f"{glob.escape(place.name)}.old-{'[0-9a-f]' * 8}"):
        if path.is_dir() and not path.is_symlink() and not any(strangers(path)):
            yield path


def _empty(folder: Path, *, but: str) -> None:
    """Remove what is in a folder, but for the file of this name."""
    for path in folder.iterdir():
        if path.name != but:
            shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
