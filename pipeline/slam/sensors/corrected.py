"""Corrections of a recording before it is mapped: each compares its sensors with each other."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from turtlebag.datasets.durations import nanoseconds
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.lidars import of_each_lidar
from turtlebag.datasets.own_body import without_own_body
from turtlebag.datasets.types import LidarSpec, Recording, Recording3D, Trajectory
from turtlebag.pipeline.slam.sensors.gyro_slip import turns_with, with_gyro
from turtlebag.pipeline.slam.sensors.mounting import facing
from turtlebag.pipeline.slam.sensors.repeated_scans import without_repeats
from turtlebag.pipeline.slam.times.stretches import odometry_stream
from turtlebag.pipeline.slam.times.timing import Timing, compared_times


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


def corrected(recording: Recording, usable_m: float, *, gyro: bool, matched: bool, deskew: bool) -> Recording:
    """The recording without the robot's own body and a stuck lidar's repeats, its odometry in step with its
    scans, its lidar facing where it does, and the turns in which the wheels slipped replaced by the gyro's,
    if there is one to be used.

    Odometry that does not turn when the scans do is left out if scans are `matched`. The times of the beams
    are compared if these are to be deskewed.
    """
    compared = partial(_compared, usable_m=usable_m, matched=matched, deskew=deskew)
    recording = of_each_lidar(recording, compared)
    return with_gyro(recording) if gyro else recording


def _compared(recording: Recording, usable_m: float, matched: bool, deskew: bool) -> Recording:
    if len(recording) == 0:
        return recording
    recording = without_repeats(without_own_body(recording), usable_m)
    alike = in_agreement(recording, deskew=deskew)
    if alike is not None:
        return alike
    if matched:
        said = "the odometry does not turn when the scans do (is it from another drive?): not used"
        return replace(recording, T_odom_base=None, odometry=None, notes=(*recording.notes, said))
    return recording


def in_agreement(recording: Recording, *, deskew: bool = True) -> Recording | None:
    """The recording with scans and odometry of the same time, its lidar facing where it does; None if the two
    do not turn together."""
    timing = compared_times(recording, deskew=deskew)
    return facing(in_step(recording, timing)) if timing.alike else None


def in_step(recording: Recording, timing: Timing) -> Recording:
    """The recording with its odometry shifted to the time of its scans, its lidar flipped and its sweeps
    timed as the comparison says; unchanged if there is nothing to correct."""
    late_s, over, lidar, _, times = timing
    recording = replace(recording, times=times) if times != recording.times else recording
    if lidar is not None:
        said = _sweep_note(lidar, recording)
        recording = replace(recording, lidar=lidar, notes=(*recording.notes, said))
    elif over:
        recording = replace(recording, lidar=recording.lidar.turned_over())
    if over:
        said = (
            "scans and odometry turn in opposite directions: assuming the laser is mounted the other way up"
        )
        recording = replace(recording, notes=(*recording.notes, said))
    recording = _shifted(recording, late_s) if late_s != 0.0 else recording
    return replace(recording, turned_over=not turns_with(recording)) if over else recording


def _sweep_note(lidar: LidarSpec, recording: Recording) -> str:
    said = recording.lidar
    order = "in the order of the array" if lidar.time_increment > 0.0 else "against the order of the array"
    begins = "" if lidar.first_beam == said.first_beam else f", from reading {lidar.first_beam} on"
    return (
        f"the lidar takes {lidar.sweep_s:.3f} s for a scan, {order}{begins}, where the log says "
        f"{said.sweep_s:.3f} s (judged by scans that turn differently); corrected"
    )


def _shifted(recording: Recording, late_s: float) -> Recording:
    stream, late_ns = odometry_stream(recording), nanoseconds(late_s)
    shifted = Trajectory(stream.stamps_ns - late_ns, stream.poses)
    said = f"{abs(late_s):.2f} s {'behind' if late_s > 0.0 else 'ahead of'} the scans"
    return replace(
        recording,
        T_odom_base=stream.at(recording.stamps_ns + late_ns),
        odometry=None if recording.odometry is None else shifted,
        odometry_late_s=late_s,
        notes=(*recording.notes, f"the odometry runs {said} (judged by the turns of both); corrected"),
    )


def delay_metrics(recording: Recording | Recording3D) -> dict[str, float]:
    """`odometry_late_s` [s] of a recording with corrected odometry, else empty."""
    late_s = recording.odometry_late_s if isinstance(recording, Recording) else 0.0
    return {"odometry_late_s": late_s} if late_s else {}


def _at_once(recording: Recording) -> Recording:
    return replace(recording, lidar=replace(recording.lidar, time_increment=0.0))
