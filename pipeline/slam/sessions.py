"""Multi-session mapping: each recording is tracked alone, then joined to the graph by place recognition."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.graph.constraints import ALONG_THE_LOG, Constraint, Graph, Kind
from turtlebag.pipeline.slam.graph.pose_graph import carried_poses
from turtlebag.pipeline.slam.loops.by_appearance import PlaceRecognitionConfig, recognise_places
from turtlebag.pipeline.slam.loops.by_distance import LoopClosing, LoopConfig
from turtlebag.pipeline.slam.loops.submaps import windows
from turtlebag.pipeline.slam.odometry.breaks import TrackBreaks, joined_breaks
from turtlebag.pipeline.slam.odometry.evidence import Evidence, evidence_of
from turtlebag.pipeline.slam.odometry.track import Track, TrackingConfig, step_constraints
from turtlebag.pipeline.slam.scans.clouds import PER_POINT, Clouds, KeyScans
from turtlebag.pipeline.slam.sensors.range_calibration import RangeCalibration
from turtlebag.pipeline.slam.sensors.setup_estimate import SensorSetup

BORDER = np.diag([25.0, 25.0, 100.0])
"""Information of the constraint between two sessions: 0.2 m and 0.1 rad."""


@dataclass(frozen=True, eq=False)
class Session:
    """One recording (or several joined) with its map.

    Of the scans' points only those of the key scans stay in memory, `key_scans`. `motion` is the base's
    during each sweep, None if a sweep is one instant. The recording's ranges are corrected already; `ranges`
    is the error of those of the first one, and `setup` its sensors.
    """

    recording: Recording
    key_scans: KeyScans
    motion: SE2 | None
    track: Track
    evidence: Evidence
    breaks: TrackBreaks
    graph: Graph
    ranges: RangeCalibration
    setup: SensorSetup = field(default_factory=SensorSetup)

    @property
    def unconfirmed(self) -> NDArray[np.int64]:
        """Scans before which the motion is unconfirmed, and that no recognised place connects to the rest."""
        breaks = self.breaks.contradicted | self.breaks.alone
        return self.track.keys[1:][self.graph.unbridged & breaks]

    def carried(self) -> Track:
        """The track with the poses of the graph."""
        track = self.track
        T = carried_poses(track.T_track_base, track.keys, self.graph.T_map_keys, self.breaks.gaps)
        return replace(track, T_track_base=T)

    def open_breaks(self) -> TrackBreaks:
        """The breaks of the track that the graph did not bridge."""
        return self.breaks.still_open(self.graph.unbridged)


def join(
    a: Session,
    b: Session,
    places: PlaceRecognitionConfig,
    loops: LoopConfig,
    tracking: TrackingConfig,
) -> Session:
    """Session `b`, one recording, located in the map of `a`, and the two as one: only a weak constraint
    connects them, and the loops between them are still to be closed. InputError if no place of `a` is
    recognised."""
    recording, border = joined_recording([a.recording, b.recording]), len(a.recording)
    key_scans = joined_keys(a.key_scans, b.key_scans)
    T_map_b = place_of(key_scans, a, b, places, loops)
    if T_map_b is None:
        raise InputError(
            f"{b.recording.source}: no place of {a.recording.source} recognised; map it separately"
        )
    track_a, track_b = a.carried(), b.carried()
    track = joined_track(track_a, track_b, T_map_b)
    evidence = evidence_of(recording, track, tracking.odometry, np.append(a.evidence.borders, border))
    weak = [c for c in a.graph.constraints if c.kind is Kind.BORDER]
    weak.append(border_constraint(track_a, a.graph.T_map_keys, T_map_b, track_b))
    ends = {c.j for c in weak}
    steps = [c for c in step_constraints(track, tracking, evidence.distrusted) if c.j not in ends]
    sweeps = [session.motion for session in (a, b) if session.motion is not None]
    motion = SE2(np.concatenate([sweep.xyt for sweep in sweeps])) if len(sweeps) == 2 else None
    breaks = joined_breaks(a.open_breaks(), b.open_breaks(), border)
    graph = Graph(track.T_track_base[track.keys], [*steps, *weak], [], [], breaks.broken)
    return Session(recording, key_scans, motion, track, evidence, breaks, graph, a.ranges)


def borders_of(constraints: Sequence[Constraint], keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """The first scans of later recordings, by the constraints between them; `keys` are all key scans."""
    return keys[[c.j for c in constraints if c.kind is Kind.BORDER]]


def joined_recording(recordings: list[Recording]) -> Recording:
    """One recording of all scans, in the given order; InputError if the lidars differ. The odometry poses are
    each recording's own: steps across a border mean nothing."""
    first = recordings[0]
    for other in recordings[1:]:
        pairs = zip(first.lidars, other.lidars, strict=False)
        if len(first.lidars) != len(other.lidars) or not all(a.same(b) for a, b in pairs):
            raise InputError(
                f"{other.source}: its lidar differs from that of {first.source}; map it separately"
            )
    with_odometry = all(recording.T_odom_base is not None for recording in recordings)
    odometry = [r.T_odom_base.xyt for r in recordings if r.T_odom_base is not None]
    return replace(
        first,
        source=" + ".join(recording.source for recording in recordings),
        stamps_ns=np.concatenate([recording.stamps_ns for recording in recordings]),
        ranges=np.concatenate([recording.ranges for recording in recordings]),
        sensor=np.concatenate([r.lidar_of for r in recordings]) if first.others else None,
        T_odom_base=SE2(np.concatenate(odometry)) if with_odometry else None,
        odometry=None,
        notes=tuple(note for recording in recordings for note in recording.notes),
        findings=tuple(finding for recording in recordings for finding in recording.findings),
    )


def joined_keys(a: KeyScans, b: KeyScans) -> KeyScans:
    """The key scans of two logs, those of the second after those of the first."""
    keys = np.concatenate([a.keys, b.keys + len(a.clouds.starts) - 1])
    return KeyScans(joined_clouds([a.clouds, b.clouds]), keys)


def joined_clouds(clouds: Sequence[Clouds]) -> Clouds:
    """Several clouds as one, with their scans numbered consecutively."""
    rows = np.cumsum([0, *[len(cloud.points) for cloud in clouds]])
    starts = [cloud.starts[:-1] + row for cloud, row in zip(clouds, rows, strict=False)]
    tables = [
        np.where(cloud.table >= 0, cloud.table + np.int32(row), np.int32(-1))
        for cloud, row in zip(clouds, rows, strict=False)
    ]
    return Clouds(
        **{name: np.concatenate([getattr(cloud, name) for cloud in clouds]) for name in PER_POINT},
        starts=np.concatenate([*starts, rows[-1:]]).astype(np.int64),
        table=np.concatenate(tables).astype(np.int32),
        origin=clouds[0].origin,
        bins=clouds[0].bins,
        sensor=np.concatenate([cloud.sensor for cloud in clouds]),
    )


def joined_track(a: Track, b: Track, T_a_b: SE2) -> Track:
    """Track `b` appended to `a`, moved by `T_a_b`; its scans are numbered after `a`'s."""
    n = len(a.T_track_base)
    steps = None
    if a.odometry_steps is not None and b.odometry_steps is not None:
        border = (a.T_track_base[a.keys[-1]].inverse() @ (T_a_b @ b.T_track_base[0])).xyt
        steps = np.concatenate([a.odometry_steps, border[None], b.odometry_steps])
    return Track(
        SE2(np.concatenate([a.T_track_base.xyt, (T_a_b @ b.T_track_base).xyt])),
        np.concatenate([a.keys, b.keys + n]),
        np.concatenate([a.overlap, b.overlap]),
        np.concatenate([a.rmse, b.rmse]),
        np.concatenate([a.information, b.information]),
        np.concatenate([a.source, b.source]),
        steps,
        a.calibration,
        np.concatenate([a.usable, b.usable]),
    )


def place_of(
    scans: KeyScans, a: Session, b: Session, config: PlaceRecognitionConfig, loops: LoopConfig
) -> SE2 | None:
    """The pose of session `b` (its key scans follow `a`'s in `scans`) in the map of `a`, by place recognition
    across the break between the two. The first eighth of `b` is tried first, then more of it. If `b` has
    fewer submaps than must agree, those it has are enough. None if no place is recognised."""
    n, open_b = len(a.track.keys), b.open_breaks()
    breaks = joined_breaks(a.open_breaks(), open_b, len(a.recording), broken=True)
    clouds, keys = scans
    T = np.concatenate([a.graph.T_map_keys.xyt, b.graph.T_map_keys.xyt])
    constraints = [*a.graph.constraints, *(replace(c, i=c.i + n, j=c.j + n) for c in b.graph.constraints)]
    submaps = len(windows(len(keys) - n, open_b.broken))
    config = config.model_copy(update={"min_support": max(min(config.min_support, submaps), 1)})
    for share in (8, 4, 2, 1):
        asked = n + (len(keys) - n) // share
        steps = [c for c in constraints if max(c.i, c.j) < asked and c.kind in ALONG_THE_LOG]
        held = [c for c in constraints if max(c.i, c.j) < asked and c.kind not in ALONG_THE_LOG]
        log = KeyScans(clouds, keys[:asked]), SE2(T[:asked]), steps, breaks.first(asked - 1), held
        record = recognise_places(*log, config, LoopClosing(loops)).record
        found = [place for place in record if place.accepted and place.j < n <= place.i]
        if found:
            best = max(found, key=lambda place: place.overlap)
            return SE2(T[best.j]) @ SE2(best.T_j_i) @ SE2(T[best.i]).inverse()
    return None


def border_constraint(a: Track, T_map_keys: SE2, T_map_b: SE2, b: Track) -> Constraint:
    """A weak constraint of the first key of `b` to the last of `a`; the loops between them determine the
    rest."""
    last = len(a.keys) - 1
    relative = T_map_keys[last].inverse() @ (T_map_b @ b.T_track_base[b.keys[0]])
    return Constraint(last, last + 1, relative.xyt, BORDER, Kind.BORDER)
