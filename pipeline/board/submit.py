"""Somebody's result on an input of the board, measured as the board's own rows are."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from turtlebag.datasets.files import sha256_file
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.trajectories import load_tum
from turtlebag.pipeline.board.inputs import BAG, find_drive
from turtlebag.pipeline.stages.run import run
from turtlebag.reports.metrics.references import References


def submit(poses: Path, name: str, out: Output) -> dict[str, Any]:
    """Measure poses in the TUM format against the truth of the input `name`; gives what is in metrics.json.

    The input is made again by its request. `same_input` says whether its bag has the stated hash: elsewhere
    than on the machine that made the hashes a drive may differ in its last digits. `covered` is the share of
    the drive's time that the poses span. InputError for an unknown
    input and for poses of another recording.
    """
    drive, trajectory = find_drive(name), load_tum(poses)
    with out.staged([poses]) as folder, tempfile.TemporaryDirectory(prefix="turtlebag-") as place:
        record = Path(place, "record")
        run(drive.request, Output(record, command=drive.command.split()))
        digest = sha256_file(record / BAG)
        references = References.load(record)
        errors = references.errors(trajectory, None, odometry=False)
        whole = references.truth.duration() if references.truth is not None else 0.0
        metrics = {
            "input": name,
            "input_sha256": digest,
            "same_input": digest == drive.sha256,
            "poses": len(trajectory),
            "covered": min(trajectory.duration() / whole, 1.0),
            **errors,
        }
        extra = {"input_command": drive.command}
        out.finish(folder, "board submit", {"poses": poses}, metrics=metrics, extra=extra)
    return metrics
