"""The front end's way along a log, once, or once more with the motion during the sweeps that it found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from turtlebag.datasets.motion import sweep_motion_by_track, sweeps
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.slam.odometry.evidence import Evidence, evidence_of
from turtlebag.pipeline.slam.odometry.track import Track, TrackingConfig
from turtlebag.pipeline.slam.odometry.tracker import Maker, track_log
from turtlebag.pipeline.slam.progress import Progress
from turtlebag.pipeline.slam.scans.scans import Scans


def follow(
    scans: Scans, config: TrackingConfig, make: Maker, progress: Progress
) -> tuple[Scans, Track, Evidence]:
    """The scans with the motion during their sweeps, the front end's track, and the evidence for its steps.

    Where neither trusted odometry nor anything else gives the motion during a sweep, the scans do, once they
    are placed; then they are followed once more.
    """
    track, recording, motion = track_log(scans, config, make, progress), scans.recording, scans.motion
    evidence = evidence_of(recording, track, config.odometry)
    unknown = evidence.distrusted | (motion is None)
    if not sweeps(recording) or len(scans) < 2 or not unknown.any():
        return scans, track, evidence
    by_track = sweep_motion_by_track(recording, track.T_track_base)
    known = (by_track if motion is None else motion).xyt
    scans = replace(scans, motion=SE2(np.where(unknown[:, None, None], by_track.xyt, known)))
    track = track_log(scans, config, make, progress)
    return scans, track, evidence_of(recording, track, config.odometry)
