"""The stages that make a bag of another: `bag convert` and `bag recover`."""

from __future__ import annotations

import math
from pathlib import Path

from turtlebag.datasets.bags import convert
from turtlebag.datasets.bags.recover import recover
from turtlebag.datasets.bags.selection import Selection
from turtlebag.datasets.bags.source import is_carmen_log
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.plurals import counted
from turtlebag.datasets.recordings import load_recording
from turtlebag.pipeline.stages.command_line import flag_of_field
from turtlebag.pipeline.stages.requests.bags import ConvertRequest, RecoverRequest
from turtlebag.pipeline.terminal.messages import log, log_notes


def recover_bag(request: RecoverRequest, out: Output) -> int:
    """Write a bag of every intact message; InputError where there is none."""
    with out.staged() as folder:
        saved = recover(request.bag, folder / "bag")
        out.finish(folder, "bag recover", {"bag": request.bag})
    log_notes(saved.notes)
    span = (saved.end_ns - saved.start_ns) * 1e-9
    log.info(f"saved {counted(saved.messages, 'message')} over {span:.2f} s -> {out.folder}")
    return 0


def convert_bag(request: ConvertRequest, out: Output) -> int:
    """Write a rosbag2 bag; InputError for what cannot be converted, or not like this."""
    selection = _selection(request)
    with out.staged() as folder:
        count, notes = _into_folder(request, folder / "bag", selection)
        convert.require_messages(request.bag, count, notes)
        out.finish(folder, "bag convert", {"bag": request.bag})
    _tell(count, notes, out.folder)
    return 0


def _selection(request: ConvertRequest) -> Selection:
    if not request.bag.exists():
        raise InputError(f"{request.bag}: no such file or folder")
    for name in ("exclude", "exclude_frame", "start", "end"):
        if is_carmen_log(request.bag) and getattr(request, name) not in (None, ()):
            why = "a CARMEN log is converted whole; convert it, then the bag that it becomes"
            raise InputError(f"{flag_of_field(request, name)}: {why}")
    start_s, end_s = request.start or 0.0, math.inf if request.end is None else request.end
    if end_s <= start_s:
        raise InputError(f"--to {end_s:g}: must be later than --from {start_s:g}")
    return Selection(request.exclude, request.exclude_frame, start_s, end_s)


def _into_folder(request: ConvertRequest, folder: Path, selection: Selection) -> tuple[int, list[str]]:
    if request.storage == "sqlite3":
        return convert.to_sqlite3(_a_bag(request.bag), folder, selection)
    if is_carmen_log(request.bag):
        return convert.carmen_to_mcap(load_recording(request.bag), folder)
    return convert.to_mcap(request.bag, folder, selection)


def _a_bag(path: Path) -> Path:
    if is_carmen_log(path):
        raise InputError(f"{path}: a CARMEN log can only be converted to rosbag2 with mcap storage")
    return path


def _tell(count: int, notes: list[str], place: Path) -> None:
    log_notes(notes)
    log.info(f"{counted(count, 'message')} -> {place}")
