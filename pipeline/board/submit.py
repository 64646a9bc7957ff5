"""Somebody's result on an input of the board, measured as the board's own rows are."""

from __future__ import annotations

import shlex
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.files import sha256_file
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.trajectories import load_tum
from turtlebag.datasets.types import Trajectory
from turtlebag.pipeline.board.inputs import BAG, find_drive
from turtlebag.pipeline.stages.run import run
from turtlebag.reports.metrics.references import References

SPARE_S = 1.0
"""By so much poses may begin before the truth does, or end after it."""


def submit(poses: Path, name: str, out: Output) -> dict[str, Any]:
    """Measure poses in the TUM format against the truth of the input `name`; gives what is in metrics.json.

    The input is made again by its request. `same_input` says whether its bag has the stated hash: elsewhere
    than on the machine that made the hashes a drive may differ in its last digits. `covered` is the share of
    the drive's time that the poses span. InputError for an unknown input, for poses of another recording, and
    where they are less than two or their stamps do not rise.
    """
    drive, trajectory = find_drive(name), _rising(poses)
    with out.staged([poses]) as folder, tempfile.TemporaryDirectory(prefix="turtlebag-") as place:
        record = Path(place, "record")
        run(drive.request, Output(record, command=shlex.split(drive.command)))
        digest = sha256_file(record / BAG)
        covered = _covered(poses, trajectory, load_tum(record / "truth" / "trajectory.tum"))
        metrics = {
            "input": name,
            "input_sha256": digest,
            "same_input": digest == drive.sha256,
            "poses": len(trajectory),
            "covered": covered,
            **References.load(record).errors(trajectory, None, odometry=False),
        }
        extra = {"input_command": drive.command}
        out.finish(folder, "board submit", {"poses": poses}, metrics=metrics, extra=extra)
    return metrics


def _rising(poses: Path) -> Trajectory:
    """Poses that an error can be told of: each stamp once, in order; InputError otherwise."""
    trajectory = load_tum(poses)
    if len(trajectory) < 2:
        raise InputError(f"{poses}: one pose; a trajectory has two or more")
    if len(back := np.flatnonzero(np.diff(trajectory.stamps_ns) <= 0)):
        raise InputError(
            f"{poses}: stamps must rise, but pose {int(back[0]) + 2} is not later than the one before"
        )
    return trajectory


def _covered(poses: Path, trajectory: Trajectory, truth: Trajectory) -> float:
    """The share of the drive's time that the poses span; InputError where they span more than all of it."""
    span_s, whole_s = trajectory.duration(), truth.duration()
    if span_s > whole_s + SPARE_S:
        raise InputError(
            f"{poses}: spans {span_s:.1f} s, but the drive takes {whole_s:.1f} s: another recording?"
        )
    return min(span_s / whole_s, 1.0)
