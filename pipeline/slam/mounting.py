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
from turtlebag.pipeline.slam.clouds import USABLE_M
from turtlebag.pipeline.slam.range_noise import RangeNoise, range_noise
from turtlebag.pipeline.slam.turn_comparison import PERIOD_S, tracked_alone, usual_period

# So many stretches of so many scans, PERIOD_S apart at least, are asked; so many must answer.
STRETCHES, SCANS, ANSWERS = 24, 6, 8
# A stretch answers where this much was driven at least [m], by scans and odometry alike but for such a share.
LEAST_WAY_M, SHARE = 0.1, 0.2
# Answers agree when their mean direction is as long as this: 0.94 to 1 in 34 logs that tell.
AGREEING = 0.9
# Angles are told in such steps [deg], so that several recordings of one robot get the same, and smaller ones
# not at all: in those logs the laser faces as said, to 2 degrees at worst.
STEP_DEG = 5.0


def facing(recording: Recording) -> Recording:
    """The recording with its laser turned so that scans and odometry agree on the way; as it is where they
    do, or where nothing tells."""
    turned_deg = turned_by_deg(recording)
    if turned_deg == 0.0:
        return recording
    x, y, yaw = recording.T_base_lidar.xyt
    said = (
        f"the laser's yaw is {turned_deg:.0f} degrees from the recorded mounting (by the motion of scans "
        "and odometry); corrected"
    )
    T_base_lidar = SE2.from_xyt(x, y, yaw + np.deg2rad(turned_deg))
    return replace(recording, T_base_lidar=T_base_lidar, notes=(*recording.notes, said))


def turned_by_deg(recording: Recording) -> float:
    """Error of the laser's declared yaw [deg]; 0 also if unknown."""
    if recording.T_odom_base is None or len(recording) <= SCANS:
        return 0.0
    noise = range_noise(recording, USABLE_M)
    ways = np.array([_ways(recording, stretch, noise) for stretch in _stretches(recording)]).reshape(-1, 2)
    seen, told = ways[np.abs(ways[:, 1]) >= LEAST_WAY_M].T
    answers = np.abs(np.abs(seen) - np.abs(told)) <= SHARE * np.abs(told)
    if np.count_nonzero(answers) < ANSWERS:
        return 0.0
    turns = told[answers] / seen[answers]
    mean = np.mean(turns / np.abs(turns))
    if np.abs(mean) < AGREEING:
        return 0.0
    # the median: one stretch that went wrong by 60 degrees turns the mean of twenty by three
    middle_deg = np.angle(mean, deg=True) + np.median(np.angle(turns / mean, deg=True))
    turned_deg = STEP_DEG * float(np.round(middle_deg / STEP_DEG))
    return 180.0 - (180.0 - turned_deg) % 360.0


def _stretches(recording: Recording) -> list[NDArray[np.int64]]:
    """Rows of the scans of each stretch in which the robot goes farthest and turns least by its odometry."""
    T = recording.T_odom_base
    assert T is not None
    apart = max(1, round(PERIOD_S / usual_period(recording)))
    starts = np.arange(0, len(recording) - apart * SCANS, apart * SCANS)
    x, y, turn = (T[starts].inverse() @ T[starts + apart * (SCANS - 1)]).xyt.T
    straight = np.hypot(x, y) * np.cos(np.clip(2.0 * turn, -np.pi, np.pi))
    chosen = np.sort(np.argsort(-straight, kind="stable")[:STRETCHES])
    return [start + apart * np.arange(SCANS) for start in starts[chosen]]


def _ways(recording: Recording, rows: NDArray[np.int64], noise: RangeNoise) -> NDArray[np.complex128]:
    """Where a stretch ends seen from its begin, by the scans alone and by the odometry, x + iy [m].

    The way lies aside by half of what the robot turns: where scans and odometry differ in that, half of the
    difference is no matter of how the laser is mounted, and taken off.
    """
    T_odom = recording.T_odom_base
    assert T_odom is not None
    track = tracked_alone(recording, rows, noise).T_track_base
    ends = (track[0].inverse() @ track[-1], T_odom[rows[0]].inverse() @ T_odom[rows[-1]])
    seen, told = (complex(*end.xy) for end in ends)
    aside = 0.5 * wrap(ends[0].yaw - ends[1].yaw)
    return np.array([seen * np.exp(-1j * aside), told])
