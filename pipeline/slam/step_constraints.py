"""The steps of a pose graph: constraints between successive key scans, from the track."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from turtlebag.pipeline.slam.align import CAUCHY, STEP_INFLATION
from turtlebag.pipeline.slam.factors import Constraint
from turtlebag.pipeline.slam.icp_odometry import STEADY_SHARE
from turtlebag.pipeline.slam.track import Track, TrackingConfig


def step_constraints(
    track: Track, config: TrackingConfig, disbelieved: NDArray[np.bool_] | None = None
) -> list[Constraint]:
    """Constraints between successive key scans, from the scans and from the calibrated odometry.

    In a direction the scans are blind in only the odometry holds; where both see, the scans do. Without
    odometry, or where it was not to be believed on the way (`disbelieved`, (n,)), a weak belief in the front
    end's own motion takes its place.
    """
    T = track.T_track_base[track.keys]
    lies = np.zeros(len(track.T_track_base), dtype=bool) if disbelieved is None else disbelieved
    so_far = np.cumsum(lies)[track.keys]
    matched = T.steps()
    constraints = []
    for k, step in enumerate(matched):
        seen = track.information[track.keys[k + 1]] / STEP_INFLATION
        constraints.append(Constraint(k, k + 1, step, seen, "step"))
        if track.odometry_steps is None or so_far[k + 1] > so_far[k]:
            # without it the front end took the motion for steady there; nothing at all would tear the graph
            steady = STEADY_SHARE * config.odometry.information(step)
            constraints.append(Constraint(k, k + 1, step, steady, "steady"))
        else:
            odometry = track.odometry_steps[k]
            information = track.calibration.information(odometry)
            constraints.append(Constraint(k, k + 1, odometry, information, "odometry", CAUCHY))
    return constraints
