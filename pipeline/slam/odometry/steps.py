"""The steps of a pose graph: constraints between successive key scans, from the track."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind
from turtlebag.pipeline.slam.odometry.line_icp import STEADY_SHARE
from turtlebag.pipeline.slam.odometry.track import Track, TrackingConfig
from turtlebag.pipeline.slam.scans.align import match_information


def step_constraints(
    track: Track, config: TrackingConfig, distrusted: NDArray[np.bool_] | None = None
) -> list[Constraint]:
    """Constraints between successive key scans, from the scans and from the calibrated odometry.

    In a direction that scans cannot observe, only the odometry constrains; where both observe, the scans
    dominate. Without odometry, or where it was distrusted since the last key (`distrusted`, (n,)), the front
    end's own motion is used with a weak information.
    """
    T = track.T_track_base[track.keys]
    if distrusted is None:
        distrusted = np.zeros(len(track.T_track_base), dtype=bool)
    so_far = np.cumsum(distrusted)[track.keys]
    matched = T.steps()
    constraints = []
    for k, step in enumerate(matched):
        seen = match_information(track.information[track.keys[k + 1]])
        constraints.append(Constraint(k, k + 1, step, seen, Kind.STEP))
        if track.odometry_steps is None or so_far[k + 1] > so_far[k]:
            # the front end assumed a constant velocity there; without any constraint the graph falls apart
            steady = STEADY_SHARE * config.odometry.information(step)
            constraints.append(Constraint(k, k + 1, step, steady, Kind.STEADY))
        else:
            odometry = track.odometry_steps[k]
            information = track.calibration.information(odometry)
            constraints.append(Constraint(k, k + 1, odometry, information, Kind.WHEELS, Constraint.CAUCHY))
    return constraints
