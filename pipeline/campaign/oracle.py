"""Truth put in the place of one part of the mapping: for the study of who is to blame, and nothing else.

This is the one exception to the rule that truth stays out of estimators. Only the command `blame` may
import it; a test reads every import of the project to make sure.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from datasets.bags.reader import read_poses
from datasets.errors import InputError
from datasets.recordings import load_recording
from datasets.types import Recording
from pipeline.slam.slam import SlamConfig
from reports.stages import Stage

PARTS = {
    "odometry": "the pose that predicts each scan's place is the true one",
    "deskew": "the motion during a sweep is the true one",
    "poses": "every scan is put where it truly was: only the grid is left to err",
}


def with_truth(record: Stage, parts: Collection[str]) -> Recording:
    """The recording of a `record` output with the named parts replaced by the truth of its bag."""
    recording = load_recording(record.folder)
    truth = read_poses(record.folder / "bag", "/ground_truth/odom")
    if record.truth is None or len(record.truth) != len(recording):
        raise InputError(f"{record.folder}: its truth has not one pose for each scan")
    if "odometry" in parts or "poses" in parts:
        recording = replace(recording, T_odom_base=record.truth.poses)
    if "deskew" in parts or "poses" in parts:
        recording = replace(recording, odometry=truth)
    return recording


def with_sensors(config: SlamConfig, parts: Collection[str]) -> SlamConfig:
    """The settings under which replaced poses are taken as they are."""
    return config.model_copy(update={"sensors": "odometry"}) if "poses" in parts else config
