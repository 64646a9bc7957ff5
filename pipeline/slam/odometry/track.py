"""The track, the front end's result: a pose and a quality for every scan, and the constraints of its steps.
Also the tracking settings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from turtlebag.datasets.se2 import SE2, Array, between
from turtlebag.datasets.settings import Settings
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind
from turtlebag.pipeline.slam.graph.pose_graph import WEAK
from turtlebag.pipeline.slam.odometry.calibration import ODOMETRY_SHARE, Calibration, baselines
from turtlebag.pipeline.slam.scans.align import match_information, possible

HYPOTHESES = ("odometry", "constant velocity", "kiss-icp", "recovery", "standstill")
# How far scans and odometry may differ about a motion [m]; [rad], and as a share of the motion.
AGREE_M, AGREE = 0.3, 0.15
# Without odometry a constant velocity is predicted, with this share of an odometry step's information.
STEADY_SHARE = 0.05
# A scan is blind if its information along one direction is at most this share of that along the other.
BLIND = 0.01


class OdometryNoise(Settings):
    """Standard deviations of an odometry step, along, across [m] and in turn [rad]."""

    floor: float = Field(default=0.005, gt=0.0, description="noise at rest [m], [rad]")
    share: float = Field(default=ODOMETRY_SHARE, ge=0.0, description="share of distance and turn")

    def information(self, delta: Array) -> Array:
        """Information (3, 3) of one step (3,), in the frame of its end."""
        distance, turn = float(np.hypot(delta[0], delta[1])), abs(float(delta[2]))
        sigma = self.floor + self.share * np.array([distance, distance, distance + turn])
        return np.diag(sigma**-2.0)


class TrackingConfig(Settings):
    """The front end."""

    key_distance_m: float = Field(default=0.3, ge=0.001, description="distance between key scans")
    key_turn_rad: float = Field(default=0.4, ge=0.001, description="turn between key scans")
    calibration: bool = Field(default=True, description="learn the odometry's systematic errors")
    odometry: OdometryNoise = OdometryNoise()


@dataclass(frozen=True, eq=False)
class Track:
    """Front-end result: a pose per scan, which scans are key scans, and the fit of each scan.

    `information` (n, 3, 3) is that of the scan alone, without blind directions; `source` names the hypothesis
    that won per scan (index into HYPOTHESES). `odometry_steps` (keys - 1, 3) are the calibrated odometry's
    motions between successive key scans, None without odometry. `usable` says which scans had points to
    align.
    """

    T_track_base: SE2
    keys: NDArray[np.int64]
    overlap: Array
    rmse: Array
    information: Array
    source: NDArray[np.int8]
    odometry_steps: Array | None
    calibration: Calibration
    usable: NDArray[np.bool_]

    @property
    def fits(self) -> NDArray[np.bool_]:
        """Which scans (n,) match others at all."""
        return possible(self.overlap)


def blind(information: Array) -> NDArray[np.bool_]:
    """Whether scans with information (..., 3, 3) observe only one direction when their yaw is unknown."""
    with_yaw, of_yaw = information[..., :2, 2:], np.maximum(information[..., 2:, 2:], WEAK)
    seen = np.linalg.eigvalsh(information[..., :2, :2] - with_yaw @ np.swapaxes(with_yaw, -1, -2) / of_yaw)
    return np.asarray(seen[..., 0] <= BLIND * np.maximum(seen[..., 1], WEAK))


def confirms(odometry: Array, motion: Array) -> bool:
    """Whether odometry and scans agree on a motion (3,)."""
    apart = between(odometry, motion)
    distance, turn = float(np.hypot(odometry[0], odometry[1])), abs(float(odometry[2]))
    return bool(
        np.hypot(apart[0], apart[1]) < AGREE_M + AGREE * distance and abs(apart[2]) < AGREE + AGREE * turn
    )


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
            # wheels that stand still or spin are no better than the longer way that either saw
            longer = max(odometry, step, key=baselines)
            information = track.calibration.information(longer)
            constraints.append(Constraint(k, k + 1, odometry, information, Kind.WHEELS, Constraint.CAUCHY))
    return constraints
