"""Stage `map`: a bag or log in, map files and metrics out."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from turtlebag.datasets.bags.mapping_input import NoScans
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.ground_truth import known_truth
from turtlebag.datasets.maps import save_confidence, save_map
from turtlebag.datasets.outputs import Output, Stopwatch, write_json
from turtlebag.datasets.parts import source_files
from turtlebag.datasets.trajectories import save_covariances, save_tum
from turtlebag.datasets.types import Recording, Trajectory
from turtlebag.datasets.yaml_files import config_text
from turtlebag.pipeline.slam.explain import loop_record, write_explanation
from turtlebag.pipeline.slam.graph.back_end import make_back_end
from turtlebag.pipeline.slam.graph.edits import Edits, load_edits
from turtlebag.pipeline.slam.graph.pose_graph import write_g2o
from turtlebag.pipeline.slam.mapper import SlamConfig, continue_slam, run_slam
from turtlebag.pipeline.slam.odometry.front_ends import front_end_maker
from turtlebag.pipeline.slam.session_file import FILE as GRAPH
from turtlebag.pipeline.slam.session_file import load_session, require_same_front_end, save_session
from turtlebag.pipeline.slam.sessions import Session
from turtlebag.pipeline.stages.map3d import map_clouds
from turtlebag.pipeline.stages.map_summary import Mapped, summary, tell_map
from turtlebag.pipeline.stages.requests.maps import MapRequest
from turtlebag.pipeline.stages.settings import Chosen, ConfigSource, load_config
from turtlebag.pipeline.stages.sources import recording_of
from turtlebag.pipeline.terminal.messages import log, log_notes, track
from turtlebag.reports.metrics.references import References

TAKEN = (
    "map", "before", "confidence", "config", "explain", "graph", "manifest", "metrics",
    "poses_with_covariance", "trajectory",
)  # fmt: skip
"""Names of our own files in the folder of a map."""


def build_map(request: MapRequest, out: Output) -> int:
    """Map recordings into the folder of `out`; 0 done, 1 when the truth says that the map is bad.

    InputError when anything given cannot be used, before anything is written.
    """
    references = References.load(request.truth, request.relations)
    _require_name(request.name)
    watch = Stopwatch()
    with known_truth(references.true_pose):
        made = _mapped(request)
    slam_s = watch.seconds()
    metrics = _metrics(made, references)
    with out.staged() as folder:
        save_mapped(made, folder, request.name)
        read = {**_files(request), **references.inputs, **source_files(made.manifest.get("parts", {}))}
        pace = {"slam_s": round(slam_s, 3), "scans_per_s": round(len(made.recording) / slam_s, 1)}
        out.finish(
            folder,
            "map",
            read,
            metrics=metrics,
            config=config_text(made.config),
            extra={**pace, **made.manifest},
        )
    return 0 if tell_map(metrics, out.folder, slam_s) else 1


def _files(request: MapRequest) -> dict[str, Path]:
    """What is read, by the names that a manifest gives it."""
    continued = None if request.continued is None else request.continued / GRAPH
    also = {f"also_{k}": path for k, path in enumerate(request.also, start=1)}
    others = {"continued": continued, "edits": request.edits}
    return {"source": request.source, **also, **{name: path for name, path in others.items() if path}}


def _mapped(request: MapRequest) -> Mapped:
    """Map planar scans, or where the source has none, its point clouds."""
    edits = Edits() if request.edits is None else load_edits(request.edits)
    earlier = None if request.continued is None else load_session(request.continued)
    try:
        first = recording_of(request)
    except NoScans as error:
        if not error.clouds:
            raise
        return map_clouds(request)
    settled = _settled(request.config, request.settings)
    recordings = [first, *(recording_of(request, path) for path in request.also)]
    notes = [note for one in recordings for note in _notes(one, several=len(recordings) > 1)]
    if request.continued is not None and earlier is not None:
        notes += require_same_front_end(request.continued, earlier[1], settled)
    log_notes(notes)
    return map_scans(recordings, settled, earlier and earlier[0], edits, explain=request.explain)


def _metrics(made: Mapped, references: References) -> Mapping[str, object]:
    known = made.recording.T_odom_base is not None
    errors = references.errors(
        made.result.trajectory, made.result.grid, odometry=known, before_loops=made.before_loops
    )
    with_truth = made.with_truth if "ate_m" in errors else {}
    return {**summary(made.recording, made.result), **made.metrics, **errors, **with_truth}


def save_mapped(made: Mapped, folder: Path, named: str | None) -> None:
    """All files of a map but its metrics and settings."""
    for name in ("map", *([] if named is None else [named])):
        save_map(made.result.grid, folder, name)
    write_g2o(folder / "graph.g2o", made.result.T_map_keys, made.result.constraints)
    write_json(folder / "graph.json", made.record)
    made.write(folder)


def map_scans(
    recordings: list[Recording], config: SlamConfig, earlier: Session | None, edits: Edits, *, explain: bool
) -> Mapped:
    """Map planar scans, all of them or joined to an earlier map."""
    if earlier is not None:
        result = continue_slam(earlier, recordings, config, track, edits=edits)
    else:
        result = run_slam(recordings[0], config, track, more=recordings[1:], edits=edits)
    for asked, loop in zip(edits.add, result.loops, strict=False):
        if not loop.accepted:
            log.warning(f"--edits: scan {asked.scan} at scan {asked.place}: not joined: {loop.verdict}")
    recording = result.session.recording
    read = {note for one in recordings for note in one.notes}
    log_notes(note for note in recording.notes if note not in read)

    def write(folder: Path) -> None:
        save_tum(result.trajectory, folder / "trajectory.tum")
        save_covariances(result.trajectory, result.covariance, folder)
        save_confidence(result.confidence, folder / "confidence.pgm")
        save_session(folder / GRAPH, result.session, config)
        if explain:
            write_explanation(folder, result, config)

    parts = {"parts": config.parts()}
    sensors = {**result.session.ranges.as_metrics(), **result.session.setup.as_metrics()}
    alone = earlier is None and len(recordings) == 1
    return Mapped(
        recording,
        config,
        result,
        loop_record(result),
        write,
        metrics=sensors,
        before_loops=Trajectory(result.trajectory.stamps_ns, result.track.T_track_base) if alone else None,
        manifest=parts,
    )


def _require_name(named: str | None) -> None:
    """InputError when a map cannot be saved by this name beside our own files."""
    if named is not None and (not re.fullmatch(r"[\w][\w.-]*", named) or named in TAKEN):
        raise InputError(
            f"--name {named}: use letters, digits, - and _, without a folder or an extension "
            f"(taken: {', '.join(TAKEN)})"
        )


def _notes(recording: Recording, *, several: bool) -> Iterable[str]:
    """A recording's notes; among several, each says which it is of."""
    return (f"{recording.source}: {note}" if several else note for note in recording.notes)


def _settled(config: ConfigSource, settings: Chosen) -> SlamConfig:
    """The settings, with the parts that they name looked up."""
    settled = load_config(SlamConfig, config, settings)
    front_end_maker(settled.front_end)
    settled.loops.matcher()
    make_back_end(settled.back_end)
    return settled
