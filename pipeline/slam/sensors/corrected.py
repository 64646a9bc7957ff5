"""Corrections of a recording before it is mapped: each compares its sensors with each other."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.lidars import of_each_lidar
from turtlebag.datasets.own_body import without_own_body
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.sensors.gyro_slip import with_gyro
from turtlebag.pipeline.slam.sensors.mounting import facing
from turtlebag.pipeline.slam.sensors.repeated_scans import without_repeats
from turtlebag.pipeline.slam.sensors.turn_comparison import compared_turns, in_step


def with_sensors(recording: Recording, sensors: str, front_end: str, *, deskew: bool) -> Recording:
    """The recording reduced to the sensors asked for, `both`, `lidar` or `odometry`; its sweeps are instants
    unless they are to be deskewed. InputError if it has no scans, or not the odometry that is needed."""
    if len(recording) == 0:
        raise InputError(f"{recording.source}: no scans to map")
    if not deskew:
        recording = of_each_lidar(recording, _at_once)
    if sensors == "lidar":
        return replace(recording, T_odom_base=None, odometry=None)
    if recording.T_odom_base is None and (sensors == "odometry" or front_end == "wheels"):
        needs = "sensors=odometry" if sensors == "odometry" else "front_end=wheels"
        raise InputError(f"{recording.source}: no odometry, which {needs} needs")
    return recording


def corrected(recording: Recording, usable_m: float, *, gyro: bool, matched: bool) -> Recording:
    """The recording without the robot's own body and a stuck lidar's repeats, its odometry in step with its
    scans, its lidar facing where it does, and the turns in which the wheels slipped replaced by the gyro's,
    if there is one to be used.

    Odometry that does not turn when the scans do is left out if scans are `matched`.
    """
    recording = of_each_lidar(recording, partial(_compared, usable_m=usable_m, matched=matched))
    return with_gyro(recording) if gyro else recording


def _compared(recording: Recording, usable_m: float, matched: bool) -> Recording:
    if len(recording) == 0:
        return recording
    recording = without_repeats(without_own_body(recording), usable_m)
    turns = compared_turns(recording)
    if turns.alike:
        return facing(in_step(recording, turns))
    if matched:
        said = "the odometry does not turn when the scans do (is it from another drive?): not used"
        return replace(recording, T_odom_base=None, odometry=None, notes=(*recording.notes, said))
    return recording


def _at_once(recording: Recording) -> Recording:
    return replace(recording, lidar=replace(recording.lidar, time_increment=0.0))
