"""Corrects a wrong laser yaw by comparing the direction of motion by scans and by odometry.

The scans alone show the motion in the laser's frame, however it is mounted; the
odometry shows it in the robot's frame.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2, wrap
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.odometry.calibration import gross
from turtlebag.pipeline.slam.scans.range_noise import RangeNoise, range_noise
from turtlebag.pipeline.slam.times.stretches import (
    straight,
    thinned_scans,
    tracked_alone,
)

# A stretch is usable if the robot drove at least this far [m], and scans and odometry agree on the distance
# to within a gross error; so many must be usable.
LEAST_WAY_M, FEWEST = 0.1, 8
# The stretches agree if their mean direction is at least this long: 0.94 to 1 in 34 logs with enough of them.
AGREEING = 0.9
# The correction is rounded to this [deg], so that all recordings of one robot get the same one and small
# errors none: in those logs the declared yaw is right to 2 degrees at worst.
STEP_DEG = 5.0


def facing(recording: Recording) -> Recording:
    """The recording with its laser turned so that scans and odometry agree on the direction of motion;
    unchanged if they agree already, or if there is too little to compare."""
    turned_deg = turned_by_deg(recording)
    if turned_deg == 0.0:
        return recording
    x, y, yaw = recording.T_base_lidar.xyt
    note = (
        f"the laser's yaw is {turned_deg:.0f} degrees from the recorded mounting (by the motion of scans "
        "and odometry); corrected"
    )
    T_base_lidar = SE2.from_xyt(x, y, yaw + np.deg2rad(turned_deg))
    return replace(recording, T_base_lidar=T_base_lidar, notes=(*recording.notes, note))


def turned_by_deg(recording: Recording) -> float:
    """Error of the laser's declared yaw [deg]; 0 also if unknown."""
    if recording.T_odom_base is None:
        return 0.0
    scans = thinned_scans(recording)
    noise = range_noise(scans, scans.lidar.range_max)
    return yaw_error_deg(np.array([ways_of(scans, one, noise) for one in straight(scans)]))


def yaw_error_deg(ways: NDArray[np.complex128]) -> float:
    """The yaw [deg] by which ways (n, 2) by scans and odometry differ, see `ways_of`; 0 also if unknown."""
    ways = ways.reshape(-1, 2)
    by_scans, by_odometry = ways[np.abs(ways[:, 1]) >= LEAST_WAY_M].T
    usable = ~gross(np.abs(by_scans) - np.abs(by_odometry), np.abs(by_odometry))
    if np.count_nonzero(usable) < FEWEST:
        return 0.0
    turns = by_odometry[usable] / by_scans[usable]
    mean = np.mean(turns / np.abs(turns))
    if np.abs(mean) < AGREEING:
        return 0.0
    # the median, because one stretch that is wrong by 60 degrees turns the mean of twenty by three
    middle_deg = np.angle(mean, deg=True) + np.median(np.angle(turns / mean, deg=True))
    turned_deg = STEP_DEG * float(np.round(middle_deg / STEP_DEG))
    return 180.0 - (180.0 - turned_deg) % 360.0


def ways_of(recording: Recording, rows: NDArray[np.int64], noise: RangeNoise) -> NDArray[np.complex128]:
    """The end of a stretch seen from its start, by the scans alone and by the odometry, x + iy [m].

    The direction to the end deviates from the initial heading by half of the turn. Half of the difference
    between the turns of scans and odometry is therefore not due to the mounting, and is taken off.
    """
    T_odom = recording.T_odom_base
    assert T_odom is not None
    track = tracked_alone(recording, rows, noise).track.T_track_base
    ends = (track[0].inverse() @ track[-1], T_odom[rows[0]].inverse() @ T_odom[rows[-1]])
    by_scans, by_odometry = (complex(*end.xy) for end in ends)
    aside = 0.5 * wrap(ends[0].yaw - ends[1].yaw)
    return np.array([by_scans * np.exp(-1j * aside), by_odometry])
