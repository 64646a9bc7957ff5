"""The front end's way along a log, once, or once more with the motion during the sweeps that it found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.slam.odometry.track import Track, TrackingConfig
from turtlebag.pipeline.slam.odometry.tracker import Maker, track_log
from turtlebag.pipeline.slam.odometry.trust import distrusted
from turtlebag.pipeline.slam.progress import Progress
from turtlebag.pipeline.slam.scans.clouds import sweep_motion_by_track
from turtlebag.pipeline.slam.scans.scans import Scans


def follow(scans: Scans, config: TrackingConfig, make: Maker, progress: Progress) -> tuple[Scans, Track]:
    """The front end's track, and the scans deskewed as it knows them.

    Where neither trusted odometry nor anything else gives the motion during a sweep, the scans do, once they
    are placed; then they are followed once more.
    """
    track = track_log(scans, config, make, progress)
    recording, motion = scans.recording, scans.motion
    if recording.lidar.time_increment == 0.0 or len(scans) < 2:
        return scans, track
    no_borders = np.zeros(0, dtype=np.int64)
    unknown = motion is None or distrusted(recording, track, config.odometry, no_borders)
    if not np.any(unknown):
        return scans, track
    by_track = sweep_motion_by_track(recording, track.T_track_base)
    known = by_track if motion is None else motion
    scans = replace(scans, motion=SE2(np.where(np.reshape(unknown, (-1, 1, 1)), by_track.xyt, known.xyt)))
    return scans, track_log(scans, config, make, progress)
