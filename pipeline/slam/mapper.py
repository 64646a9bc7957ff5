"""Offline SLAM from end to end: a recording in, a pose for every scan and a grid out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.motion import sweeps
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.types import MountedLidar, Recording, Trajectory
from turtlebag.pipeline.slam.check.uncertainty import Uncertainty, scan_covariances, shared_errors
from turtlebag.pipeline.slam.check.verdict import SelfCheck, check_map
from turtlebag.pipeline.slam.graph.back_end import BackEndName, make_back_end
from turtlebag.pipeline.slam.graph.constraints import Constraint, Graph, Loop
from turtlebag.pipeline.slam.graph.edits import Edits, KeyEdits
from turtlebag.pipeline.slam.graph.pose_graph import carried_poses
from turtlebag.pipeline.slam.graph.refinement import RefineConfig, refine
from turtlebag.pipeline.slam.grid import OccupancyConfig, make_checked_grid
from turtlebag.pipeline.slam.loops.by_appearance import PlaceRecognitionConfig
from turtlebag.pipeline.slam.loops.by_distance import LoopClosing, LoopConfig
from turtlebag.pipeline.slam.loops.closure import close_graph
from turtlebag.pipeline.slam.odometry.breaks import breaks_of
from turtlebag.pipeline.slam.odometry.evidence import Evidence
from turtlebag.pipeline.slam.odometry.front_ends import FrontEndName, front_end_maker
from turtlebag.pipeline.slam.odometry.track import Track, TrackingConfig, step_constraints
from turtlebag.pipeline.slam.odometry.tracker import follow
from turtlebag.pipeline.slam.progress import Progress, no_progress
from turtlebag.pipeline.slam.scans.clouds import KeyScans
from turtlebag.pipeline.slam.scans.scans import Scans
from turtlebag.pipeline.slam.sensors.corrected import corrected, with_sensors
from turtlebag.pipeline.slam.sensors.range_calibration import RangeCalibration, range_errors
from turtlebag.pipeline.slam.sensors.setup_estimate import SensorSetup, sensor_setup
from turtlebag.pipeline.slam.sessions import Session, join
from turtlebag.pipeline.slam.walls import with_walls

# Settings that the front end does not read; a change of any other one starts it anew.
LATER = {"back_end", "loops", "place_recognition", "refine", "grid"}

# A correction may raise the entropy of the map by less than the first factor, the misfit of its scans by less
# than the second: both vary by as much without a cause.
AS_SHARP, NO_WORSE = 1.02, 1.002

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
    usable_range_m: float | None = Field(
        default=None, gt=0.0, description="longer returns are neither matched nor mapped; null: all are used"
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

    def usable(self, *lidars: MountedLidar) -> float:
        """The range [m] beyond which returns of these lidars are ignored."""
        return min(max(lidar.spec.range_max for lidar in lidars), self.usable_range_m or math.inf)

    def effective(self) -> SlamConfig:
        """The settings that take effect: with odometry alone, it is the front end, and nothing moves a scan
        later. InputError if sensors and front end contradict each other."""
        if self.sensors == "lidar" and self.front_end == "wheels":
            raise InputError("front_end=wheels needs the odometry that sensors=lidar leaves out")
        if self.sensors != "odometry":
            return self
        if self.front_end not in ("lines", "wheels"):
            raise InputError(f"front_end={self.front_end} needs the scans that sensors=odometry leaves out")
        off = {
            "front_end": "wheels",
            "calibrate_ranges": False,
            "tracking": self.tracking.model_copy(update={"calibration": False}),
            "loops": self.loops.model_copy(update={"enabled": False}),
            "place_recognition": self.place_recognition.model_copy(update={"enabled": False}),
            "refine": self.refine.model_copy(update={"rounds": 0}),
        }
        return self.model_copy(update=off)

    def parts(self) -> dict[str, str | None]:
        """The exchangeable parts of a map, by setting; None: not used."""
        config = self.effective()
        matcher = config.loops.match if config.loops.enabled else None
        solved = config.loops.enabled or config.refine.rounds > 0
        back_end = config.back_end if solved else None
        return {"front_end": config.front_end, "loops.match": matcher, "back_end": back_end}


@dataclass(frozen=True, eq=False)
class SlamResult:
    """A pose per scan in file order, the `covariance` of each (n, 3, 3), the grid, the `confidence` in each
    of its cells (rows, cols) in 255ths, and their session."""

    trajectory: Trajectory
    covariance: Array
    grid: OccupancyGrid
    confidence: NDArray[np.uint8]
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
    loops that the user rejected or added, and walls drawn or erased, by the numbers of the scans there.
    """
    edits.require_scans(sum(map(len, (recording, *more))), recording.source)
    session = solve_graph(track_recording(recording, config, progress), config, edits, progress)
    return draw_map(join_later(session, more, config, edits, progress), config, edits)


def continue_slam(
    session: Session,
    more: Sequence[Recording],
    config: SlamConfig,
    progress: Progress = no_progress,
    *,
    edits: Edits = Edits(),  # noqa: B008 (frozen)
) -> SlamResult:
    """As `run_slam`, but from the finished session of an earlier map instead of its recording."""
    edits.require_scans(sum(map(len, (session.recording, *more))), session.recording.source)
    return draw_map(join_later(session, more, config, edits, progress), config, edits)


def track_recording(recording: Recording, config: SlamConfig, progress: Progress) -> Session:
    """From a recording to a graph without loops: key scans, and the steps between them.

    Its sensors are corrected by each other, then its scans are followed one by one. Where these show errors
    of the ranges or of the lidar's pose, they are followed again without, which counts if they fit each other
    as well, or the map is as sharp. That of a lidar that sweeps in no time cannot tell of its pose.
    """
    config = config.effective()
    log = with_sensors(recording, config.sensors, config.front_end, deskew=config.deskew)
    usable = config.usable(*log.lidars)
    matched = config.front_end != "wheels"
    log = corrected(log, usable, gyro=config.gyro, matched=matched, deskew=config.deskew)
    ranges = RangeCalibration()
    tracked = _Tracked.of(log, config, progress)
    if config.calibrate_ranges:
        errors = range_errors(tracked.scans, tracked.track)
        if errors != ranges:
            again = _Tracked.of(errors.applied(tracked.log), config, progress)
            if again.misfit_m < NO_WORSE * tracked.misfit_m:
                tracked, ranges = again, errors
    setup = tracked.setup(recording.lidars)
    if setup.misplaced and sweeps(log):
        again = _Tracked.of(setup.applied(tracked.log), config, progress)
        if again.entropy_bits < AS_SHARP * tracked.entropy_bits:
            tracked, setup = again, again.setup(recording.lidars)
    track, evidence = tracked.track, tracked.evidence
    breaks, steps = breaks_of(track, evidence), step_constraints(track, config.tracking, evidence.distrusted)
    graph = Graph(track.T_track_base[track.keys], steps, [], [], breaks.broken)
    return Session(
        tracked.log, tracked.key_scans, tracked.scans.motion, track, evidence, breaks, graph, ranges, setup
    )


@dataclass(frozen=True, eq=False)
class _Tracked:
    """A log as the front end followed it."""

    log: Recording
    scans: Scans
    track: Track
    evidence: Evidence
    config: SlamConfig

    @staticmethod
    def of(log: Recording, config: SlamConfig, progress: Progress) -> _Tracked:
        """The log, followed."""
        scans, make = Scans.of(log, config.usable(*log.lidars)), front_end_maker(config.front_end)
        return _Tracked(log, *follow(scans, config.tracking, make, progress), config)

    @cached_property
    def key_scans(self) -> KeyScans:
        """The points of its key scans."""
        return self.scans.of_keys(self.track.keys)

    @cached_property
    def entropy_bits(self) -> float:
        """How blurred its map is before loops are closed; askew, as chance sharpens walls along the cells."""
        log, scans, poses = self.log, self.scans, SE2.from_xyt(0.0, 0.0, 0.5) @ self.track.T_track_base
        drawn = make_checked_grid(log, poses, self.config.grid, scans.usable_m, scans.motion)
        return drawn.certainty.entropy_bits

    @property
    def misfit_m(self) -> float:
        """How far the points of a scan lie from the walls of others [m]."""
        return float(self.track.rmse[self.track.fits].mean()) if self.track.fits.any() else 0.0

    def setup(self, declared: Sequence[MountedLidar]) -> SensorSetup:
        """The sensor set-up by the key scans of each lidar, which are declared to sit there; empty without
        odometry, or with nothing else."""
        if self.log.T_odom_base is None or self.config.front_end == "wheels":
            return SensorSetup()
        (clouds, keys), found = self.key_scans, []
        for number, lidar in enumerate(self.log.lidars):
            its, there = keys[self.log.lidar_of[keys] == number], declared[number].T_base_lidar
            log = replace(self.log, T_base_lidar=lidar.T_base_lidar)
            found.append(sensor_setup(log, KeyScans(clouds, its), self.track.T_track_base[its], there))
        return found[0].with_others(found[1:])


def solve_graph(session: Session, config: SlamConfig, edits: Edits, progress: Progress) -> Session:
    """The session with the loops of its graph closed, by distance and by appearance, and the poses of all
    overlapping key scans refined together."""
    config, keys = config.effective(), session.track.keys
    scans, graph, back_end = session.key_scans, session.graph, make_back_end(config.back_end)
    by_hand = KeyEdits.of(edits, keys, len(session.recording))
    refined = config.refine.rounds > 0 and len(keys) > 2
    loops = config.loops if refined else config.loops.model_copy(update={"held_m": 0.0})
    closing = LoopClosing(loops, by_hand, back_end)
    if loops.enabled and len(keys) > 2:
        graph = close_graph(scans, graph, session.breaks, closing, config.place_recognition, progress)
    if refined:
        poses, constraints = refine(
            *scans, graph.T_map_keys, graph.constraints, config.refine, by_hand, back_end
        )
        graph = replace(graph, T_map_keys=poses, constraints=constraints)
    return replace(session, graph=graph)


def join_later(
    session: Session, more: Sequence[Recording], config: SlamConfig, edits: Edits, progress: Progress
) -> Session:
    """The session with later recordings, each mapped alone and then joined to it."""
    if more and config.sensors == "odometry":
        raise InputError(
            f"{more[0].source}: joining it to {session.recording.source} needs scans; "
            "map each separately, or drop sensors=odometry"
        )
    for recording in more:
        other = solve_graph(track_recording(recording, config, progress), config, Edits(), progress)
        both = join(session, other, config.place_recognition, config.loops, config.tracking)
        session = solve_graph(both, config, edits, progress)
    return session


def draw_map(session: Session, config: SlamConfig, edits: Edits) -> SlamResult:
    """The map of a session: a pose for every scan, the grid with the walls of the edits, and its check."""
    log, track, graph = session.recording, session.track, session.graph
    torn = np.concatenate([session.breaks.gaps, session.evidence.jumps(track.T_track_base)])
    poses = carried_poses(track.T_track_base, track.keys, graph.T_map_keys, torn)
    drawn = make_checked_grid(log, poses, config.grid, config.usable(*log.lidars), session.motion)
    shared = shared_errors(track, graph.constraints, session.evidence.unobserved_m)
    uncertainty = Uncertainty.of(graph.T_map_keys, graph.constraints, shared)
    check = check_map(session, poses, drawn.certainty, uncertainty)
    covariance = scan_covariances(uncertainty, track, poses, log.stamps_ns)
    trajectory = Trajectory(log.stamps_ns, poses)
    grid, confidence = with_walls(drawn.grid, drawn.confidence, edits.walls, poses)
    return SlamResult(trajectory, covariance, grid, confidence, check, session)
