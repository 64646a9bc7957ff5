"""`bag recover`: a complete bag from what is readable in a damaged or unfinished one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from turtlebag.datasets.bags.copying import into_mcap
from turtlebag.datasets.bags.folder import BagFolder
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.errors import InputError


@dataclass(frozen=True, slots=True)
class Recovered:
    """Number of recovered messages, log times of first and last [ns], and the defects of the source."""

    messages: int
    start_ns: int
    end_ns: int
    notes: tuple[str, ...]


def recover(path: Path, folder: Path) -> Recovered:
    """Copy every intact message of the bag at `path` into a new bag in `folder`.

    Damaged stretches are stepped over and named in the notes. InputError when nothing can be saved.
    """
    bag = open_bag(path)
    with BagFolder(folder, custom={**bag.custom_data(), "recovered": "true"}) as out:
        copier = into_mcap(out)
        for message in bag.messages(step_over=True):
            copier.write(message)
        if not copier.count:
            reason = "; ".join(bag.notes) or "it is empty"
            raise InputError(f"{path}: no message could be saved ({reason})")
    return Recovered(copier.count, *out.span_ns, (*bag.notes, *copier.notes()))
