"""Offline SLAM from end to end: a recording in, a pose for every scan and a grid out."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache as once
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.motion import sweep_motion, sweep_motion_by_track
from turtlebag.datasets.own_body import without_own_body
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.types import LidarSpec, Recording, Trajectory
from turtlebag.pipeline.slam.check.selfcheck import SelfCheck, check_map
from turtlebag.pipeline.slam.graph.back_end import BackEndName, make_back_end
from turtlebag.pipeline.slam.graph.edits import Edits, KeyEdits
from turtlebag.pipeline.slam.graph.factors import Constraint, Graph, Loop
from turtlebag.pipeline.slam.graph.refinement import RefineConfig, refine
from turtlebag.pipeline.slam.grid import OccupancyConfig, make_checked_grid
from turtlebag.pipeline.slam.loops.by_appearance import PlaceRecognitionConfig
from turtlebag.pipeline.slam.loops.by_distance import LoopClosing, LoopConfig
from turtlebag.pipeline.slam.loops.closure import Progress, close_graph
from turtlebag.pipeline.slam.odometry.breaks import TrackBreaks, joined_breaks, track_breaks_of
from turtlebag.pipeline.slam.odometry.front_ends import FrontEndName, front_end_maker
from turtlebag.pipeline.slam.odometry.steps import step_constraints
from turtlebag.pipeline.slam.odometry.track import Track, TrackingConfig, carried_poses
from turtlebag.pipeline.slam.odometry.tracker import track_log
from turtlebag.pipeline.slam.odometry.trust import distrusted, jumps
from turtlebag.pipeline.slam.scans.clouds import USABLE_M, Clouds, KeyScans
from turtlebag.pipeline.slam.scans.parts import among, clouds_maker, joined_clouds
from turtlebag.pipeline.slam.sensors.gyro_slip import with_gyro
from turtlebag.pipeline.slam.sensors.mounting import facing
from turtlebag.pipeline.slam.sensors.range_calibration import (
    TRIANGULATES_M,
    RangeCalibration,
    calibrate_ranges,
)
from turtlebag.pipeline.slam.sensors.repeated_scans import without_repeats
from turtlebag.pipeline.slam.sensors.turn_comparison import compared_turns, in_step
from turtlebag.pipeline.slam.sessions import (
    Session,
    border_constraint,
    joined_recording,
    joined_track,
    place_of,
)

# Settings that the front end does not read; a change of any other one starts it anew.
LATER = {"back_end", "loops", "place_recognition", "refine", "grid"}


CloudsOf = Callable[[NDArray[np.int64] | None], Clouds]

Sensors = Annotated[
    Literal["both", "lidar", "odometry"],
    Field(description="which sensors to use; with odometry alone, the map follows the wheels"),
]


class SlamConfig(Settings):
    """Everything that shapes a map."""

    RENAMED: ClassVar = {"recall": "place_recognition"}
    REMOVED: ClassVar = dict.fromkeys(
        ("reregistration", "posing"), "scans between key scans move with these, and are not aligned once more"
    )

    sensors: Sensors = "both"
    front_end: FrontEndName = Field(
        default="lines",
        description="estimates the scans' poses: our line tracker, KISS-ICP, odometry, or your own class",
    )
    usable_range_m: float = Field(
        default=USABLE_M, gt=0.0, description="longer returns are neither matched nor mapped"
    )
    deskew: bool = Field(default=True, description="deskew the scans; switch off if the driver already does")
    gyro: bool = Field(default=True, description="use the gyro where the wheels slip while turning")
    calibrate_ranges: bool = Field(
        default=True, description="correct the range errors of a short-range lidar"
    )
    tracking: TrackingConfig = TrackingConfig()
    back_end: BackEndName = "gtsam"
    loops: LoopConfig = LoopConfig()
    place_recognition: PlaceRecognitionConfig = PlaceRecognitionConfig()
    refine: RefineConfig = RefineConfig()
    grid: OccupancyConfig = OccupancyConfig()

    def usable(self, lidar: LidarSpec) -> float:
        """The range [m] beyond which returns of this lidar are ignored."""
        return min(lidar.range_max, self.usable_range_m)


@dataclass(frozen=True, eq=False)
class SlamResult:
    """A pose per scan in file order, the grid, and their session."""

    trajectory: Trajectory
    grid: OccupancyGrid
    check: SelfCheck
    session: Session

    @property
    def track(self) -> Track:
        """The front end's track."""
        return self.session.track

    @property
    def T_map_keys(self) -> SE2:
        """Final poses of the key scans."""
        return self.session.graph.T_map_keys

    @property
    def constraints(self) -> list[Constraint]:
        """Constraints of the final graph."""
        return self.session.graph.constraints

    @property
    def loops(self) -> list[Loop]:
        """Loop candidates by distance."""
        return self.session.graph.loops

    @property
    def recognised(self) -> list[Loop]:
        """Loop candidates by place recognition."""
        return self.session.graph.recognised

    @property
    def keys(self) -> NDArray[np.int64]:
        """Scan index of each key scan."""
        return self.track.keys


def no_progress(items: Iterable[int], description: str, total: int) -> Iterable[int]:
    """No progress."""
    del description, total
    return items


@dataclass(frozen=True)
class _Run:
    """The context of a run, passed to every step."""

    config: SlamConfig
    progress: Progress
    edits: Edits


def run_slam(
    recording: Recording,
    config: SlamConfig,
    progress: Progress = no_progress,
    *,
    more: Sequence[Recording] = (),
    edits: Edits = Edits(),  # noqa: B008 (frozen)
) -> SlamResult:
    """Map a recording offline. The map frame starts at its first odometry pose (identity without one).

    `more` are later recordings of the same place: each is located in the map so far and joins the graph;
    the trajectory holds the scans of all, in that order. InputError if one cannot be located. `edits` are
    loops in `recording` that the user rejected or added.
    """
    edits.require_scans(len(recording), recording.source)
    run = _Run(config, progress, edits)
    return _mapped(_session(recording, run), more, run)


def continue_slam(
    session: Session,
    more: Sequence[Recording],
    config: SlamConfig,
    progress: Progress = no_progress,
) -> SlamResult:
    """As `run_slam`, but from the finished session of an earlier map instead of its recording."""
    return _mapped(session, more, _Run(config, progress, Edits()))


def _mapped(session: Session, more: Sequence[Recording], run: _Run) -> SlamResult:
    """The map of a session and of later recordings joined to it."""
    if more and run.config.sensors == "odometry":
        raise InputError(
            f"{more[0].source}: joining it to {session.recording.source} needs scans; "
            "map each separately, or drop sensors=odometry"
        )
    for other in more:
        session = _joined(session, _session(other, run), run)
    recording, config = session.recording, _with_sensors(session.recording, run.config)[1]
    usable, track = config.usable(recording.lidar), session.track
    torn = np.concatenate([session.breaks.gaps, jumps(recording, track, track.T_track_base, session.borders)])
    poses = carried_poses(track.T_track_base, track.keys, session.graph.T_map_keys, torn)
    grid, certainty = make_checked_grid(recording, poses, config.grid, usable, session.motion)
    check = check_map(session, poses, config.tracking.odometry, certainty)
    return SlamResult(Trajectory(recording.stamps_ns, poses), grid, check, session)


def _session(recording: Recording, run: _Run) -> Session:
    """Front end, loop closure and refinement of one recording."""
    if len(recording) == 0:
        raise InputError(f"{recording.source}: no scans to map")
    recording, config = _with_sensors(recording, run.config)
    usable = config.usable(recording.lidar)
    recording = without_repeats(without_own_body(recording), usable)
    turns = compared_turns(recording)
    if turns.alike:
        recording = facing(in_step(recording, turns))
    elif config.front_end != "wheels":
        recording = _without_odometry(recording)
    recording = with_gyro(recording) if config.gyro else recording
    motion, clouds_of, track = _tracked(recording, run, config)
    ranges = _range_errors(recording, clouds_of, track, config)
    if ranges != RangeCalibration():
        recording = ranges.applied(recording)
        motion, clouds_of, track = _tracked(recording, run, config)
    clouds = once(lambda: among(clouds_of(track.keys), track.keys, len(recording)))
    doubted = distrusted(recording, track, config.tracking.odometry, np.zeros(0, dtype=np.int64))
    breaks, steps = track_breaks_of(recording, track), step_constraints(track, config.tracking, doubted)
    graph = _optimised(clouds, track, breaks, steps, replace(run, config=config))
    return Session(recording, clouds, clouds_of, motion, track, breaks, graph, ranges)


def _without_odometry(recording: Recording) -> Recording:
    """The recording without its odometry if that does not turn when the scans do, because it belongs to
    another drive."""
    said = "the odometry does not turn when the scans do (is it from another drive?): not used"
    return replace(recording, T_odom_base=None, odometry=None, notes=(*recording.notes, said))


def _tracked(recording: Recording, run: _Run, config: SlamConfig) -> tuple[SE2 | None, CloudsOf, Track]:
    """The motion during each sweep, a function that makes the clouds of some or all scans, and the front
    end's track."""
    usable, turning = config.usable(recording.lidar), recording.lidar.time_increment != 0.0
    motion = sweep_motion(recording) if turning else None

    def placed(motion: SE2 | None) -> tuple[CloudsOf, Track]:
        clouds_of = clouds_maker(recording, usable, motion)
        scans = run.progress(range(1, len(recording)), "matching scans", len(recording) - 1)
        make = front_end_maker(config.front_end)
        return clouds_of, track_log(recording, clouds_of(None), config.tracking, usable, scans, make)

    clouds_of, track = placed(motion)
    if turning and len(recording) > 1:
        # where neither trusted odometry nor anything else gives the motion during a sweep, the scans do, once
        # they are placed
        noise, no_borders = config.tracking.odometry, np.zeros(0, dtype=np.int64)
        unknown = motion is None or distrusted(recording, track, noise, no_borders)
        if np.any(unknown):
            by_track = sweep_motion_by_track(recording, track.T_track_base)
            known = by_track if motion is None else motion
            motion = SE2(np.where(np.reshape(unknown, (-1, 1, 1)), by_track.xyt, known.xyt))
            clouds_of, track = placed(motion)
    return motion, clouds_of, track


def _range_errors(
    recording: Recording, clouds_of: CloudsOf, track: Track, config: SlamConfig
) -> RangeCalibration:
    """The range error of a short-range lidar, by the key scans."""
    if not config.calibrate_ranges or recording.lidar.range_max > TRIANGULATES_M:
        return RangeCalibration()
    keys, usable = track.keys, config.usable(recording.lidar)
    clouds = among(clouds_of(keys), keys, len(recording))
    return calibrate_ranges(clouds, keys, track.T_track_base[keys], usable)


def _joined(a: Session, b: Session, run: _Run) -> Session:
    """Session `b` found in the map of `a`, and both optimised as one graph."""
    track_a, track_b, T_map_keys = a.carried(), b.carried(), a.graph.T_map_keys
    recording = joined_recording([a.recording, b.recording])
    clouds = once(lambda: joined_clouds([a.clouds(), b.clouds()]))

    def clouds_of(scans: NDArray[np.int64]) -> Clouds:
        border = len(a.recording)
        return joined_clouds(
            [a.clouds_of(scans[scans < border]), b.clouds_of(scans[scans >= border] - border)]
        )

    config = _with_sensors(recording, run.config)[1]
    T_map_b = place_of(clouds(), a, b, config.place_recognition, config.loops)
    if T_map_b is None:
        raise InputError(
            f"{b.recording.source}: no place of {a.recording.source} recognised; map it separately"
        )
    track = joined_track(track_a, track_b, T_map_b)
    border = border_constraint(track_a, T_map_keys, T_map_b, track_b)
    doubted = distrusted(recording, track, config.tracking.odometry, np.array([len(a.recording)]))
    steps = [c for c in step_constraints(track, config.tracking, doubted) if c.i != border.i]
    sweeps = [session.motion for session in (a, b) if session.motion is not None]
    motion = SE2(np.concatenate([sweep.xyt for sweep in sweeps])) if len(sweeps) == 2 else None
    breaks = joined_breaks(a.bridged(), b.bridged(), len(a.recording))
    graph = _optimised(clouds, track, breaks, [*steps, border], replace(run, config=config))
    return Session(recording, clouds, clouds_of, motion, track, breaks, graph, a.ranges)


def _with_sensors(recording: Recording, config: SlamConfig) -> tuple[Recording, SlamConfig]:
    """The recording and settings reduced to the sensors asked for; InputError without those needed."""
    if not config.deskew:
        recording = replace(recording, lidar=replace(recording.lidar, time_increment=0.0))
    if config.sensors == "lidar" and config.front_end == "wheels":
        raise InputError("front_end=wheels needs the odometry that sensors=lidar leaves out")
    if config.sensors == "odometry" and config.front_end not in ("lines", "wheels"):
        raise InputError(f"front_end={config.front_end} needs the scans that sensors=odometry leaves out")
    if config.sensors == "lidar":
        recording = replace(recording, T_odom_base=None, odometry=None)
    if recording.T_odom_base is None:
        for setting in ("sensors=odometry", "front_end=wheels"):
            name, value = setting.split("=")
            if getattr(config, name) == value:
                raise InputError(f"{recording.source}: no odometry, which {setting} needs")
    return recording, _by_odometry(config) if config.sensors == "odometry" else config


def _by_odometry(config: SlamConfig) -> SlamConfig:
    """The settings with plain odometry as front end, and without anything that would move a scan later."""
    off = {
        "front_end": "wheels",
        "calibrate_ranges": False,
        "tracking": config.tracking.model_copy(update={"calibration": False}),
        "loops": config.loops.model_copy(update={"enabled": False}),
        "place_recognition": config.place_recognition.model_copy(update={"enabled": False}),
        "refine": config.refine.model_copy(update={"rounds": 0}),
    }
    return config.model_copy(update=off)


def chosen_parts(config: SlamConfig) -> dict[str, str | None]:
    """The exchangeable parts of a map, by setting; None: not used."""
    config = _by_odometry(config) if config.sensors == "odometry" else config
    matcher = config.loops.match if config.loops.enabled else None
    solved = config.loops.enabled or config.refine.rounds > 0
    back_end = config.back_end if solved else None
    return {"front_end": config.front_end, "loops.match": matcher, "back_end": back_end}


def _optimised(
    clouds: Callable[[], Clouds], track: Track, breaks: TrackBreaks, steps: list[Constraint], run: _Run
) -> Graph:
    """The graph after loop closure and joint refinement of all key poses."""
    config, keys, back_end = run.config, track.keys, make_back_end(run.config.back_end)
    edits = KeyEdits.of(run.edits, keys)
    graph = Graph(track.T_track_base[keys], steps, [], [], breaks.broken)
    if config.loops.enabled and len(keys) > 2:
        loops = config.loops if config.refine.rounds > 0 else config.loops.model_copy(update={"held_m": 0.0})
        scans, closing = KeyScans(clouds(), keys), LoopClosing(loops, edits, back_end)
        graph = close_graph(
            scans, graph.T_map_keys, breaks, steps, closing, config.place_recognition, run.progress
        )
    if config.refine.rounds > 0 and len(keys) > 2:
        T_map_keys, constraints = refine(
            clouds(), keys, graph.T_map_keys, graph.constraints, config.refine, edits, back_end
        )
        graph = replace(graph, T_map_keys=T_map_keys, constraints=constraints)
    return graph
