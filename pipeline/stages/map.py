"""Stage `map`: a bag or log in, map files and metrics out."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from turtlebag.datasets.bags.mapping_input import NoScans
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.files import unchanged
from turtlebag.datasets.maps import save_map
from turtlebag.datasets.output_rules import check_free
from turtlebag.datasets.outputs import Stopwatch, staged_output, write_json, write_manifest
from turtlebag.datasets.parts import source_files
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.trajectories import save_tum
from turtlebag.datasets.types import Recording
from turtlebag.datasets.yaml_files import config_text
from turtlebag.pipeline.slam.back_end import make_back_end
from turtlebag.pipeline.slam.edits import Edits, load_edits
from turtlebag.pipeline.slam.explain import loop_record, write_explanation
from turtlebag.pipeline.slam.front_ends import front_end_maker
from turtlebag.pipeline.slam.pose_graph import write_g2o
from turtlebag.pipeline.slam.sessions import Session
from turtlebag.pipeline.slam.slam import SlamConfig, chosen_parts, continue_slam, run_slam
from turtlebag.pipeline.slam.stored import FILE as GRAPH
from turtlebag.pipeline.slam.stored import load_session, require_same_front_end, save_session
from turtlebag.pipeline.stages.map3d import map_clouds
from turtlebag.pipeline.stages.map_references import References
from turtlebag.pipeline.stages.map_summary import Mapped, summary, tell_map
from turtlebag.pipeline.stages.settings import load_config
from turtlebag.pipeline.terminal.messages import log, log_notes, track

TAKEN = ("map", "before", "config", "explain", "graph", "manifest", "metrics", "trajectory")
"""Names of our own files in the folder of a map."""


def build_map(
    source: Path,
    out: Path,
    *,
    truth: Path | None = None,
    relations: Path | None = None,
    config: Path | None = None,
    settings: Sequence[str] = (),
    laser: SE2 | None = None,
    upside_down: bool = False,
    also: Sequence[Path] = (),
    continued: Path | None = None,
    topic: str | None = None,
    named: str | None = None,
    edits: Path | None = None,
    explain: bool = False,
    force: bool = False,
    command: Sequence[str] = (),
) -> int:
    """Map `source` into the folder `out`; 0 done, 1 when the truth says that the map is bad.

    `topic` names the scans of a bag, LaserScan or PointCloud2; without it /scan or the only LaserScan
    topic is mapped in 2D, and where there is none the point clouds in 3D.

    `truth` is a record's `truth` folder (or the record), `relations` a benchmark file; both add
    metrics. `also` are later recordings of the same place, joined into one graph; `continued` is the folder
    of an earlier map, whose graph `source` and they join without it being made again. `named` is a name by
    which the map is saved too, as `map_saver -f` would. `edits` is a file of loops that a person rejected or
    added. `laser` and
    `upside_down` override how the input says the laser sits on the robot. InputError when anything given
    cannot be used, before anything is written.
    """
    check_free(out, force=force, kind="folder")
    _require_name(named)
    settled = _settled(config, settings)
    references = References.load(truth, relations)
    if edits is not None and (also or continued is not None):
        raise InputError("--edits: its scans are those of one log; leave out --also and --continue")
    edited = Edits() if edits is None else load_edits(edits)
    watch = Stopwatch()
    earlier = None if continued is None else load_session(continued)
    try:
        recordings = [_recording(source, (laser, upside_down), topic)]
    except NoScans as error:
        if not error.clouds:
            raise
        planar = {
            "--also": bool(also),
            "--laser": laser is not None,
            "--continue": continued is not None,
            "--edits": edits is not None,
        }
        for option in (option for option, given in planar.items() if given):
            raise InputError(f"{option}: only for 2D scans, and {source} is mapped in 3D") from None
        made = map_clouds(source, topic, config, settings, explain=explain)
    else:
        if isinstance(settled, InputError):
            raise settled
        recordings += [_recording(path, (laser, upside_down), topic) for path in also]
        notes = [note for one in recordings for note in _notes(one, several=bool(also))]
        if continued is not None and earlier is not None:
            notes += require_same_front_end(continued, earlier[1], settled)
        log_notes(notes)
        made = _map_scans(recordings, settled, earlier and earlier[0], edited, explain=explain)
    slam_s, result = watch.seconds(), made.result
    errors: dict[str, Any] = dict(references.errors(result.trajectory, result.grid))
    if "ate_m" in errors:
        errors |= made.with_truth
    metrics = {**summary(made.recording, result), **made.metrics, **errors}
    with staged_output(out, force=force) as folder:
        for name in ("map", *([] if named is None else [named])):
            save_map(result.grid, folder, name)
        write_g2o(folder / "graph.g2o", result.T_map_keys, result.constraints)
        write_json(folder / "metrics.json", metrics)
        (folder / "config.yaml").write_text(config_text(made.config))
        write_json(folder / "graph.json", made.record)
        made.write(folder)
        write_manifest(
            folder,
            stage="map",
            command=command,
            inputs={
                "source": source,
                **{f"also_{k}": path for k, path in enumerate(also, start=1)},
                **({} if continued is None else {"continued": continued / GRAPH}),
                **({} if edits is None else {"edits": edits}),
                **references.inputs,
                **source_files(made.manifest.get("parts", {})),
            },
            wall_s=watch.seconds(),
            extra={"slam_s": round(slam_s, 3), "scans_per_s": round(len(made.recording) / slam_s, 1)}
            | made.manifest,
        )
    return 0 if tell_map(metrics, out, slam_s) else 1


def _map_scans(
    recordings: list[Recording],
    config: SlamConfig,
    earlier: Session | None,
    edits: Edits,
    *,
    explain: bool,
) -> Mapped:
    """Map planar scans, all of them or joined to an earlier map."""
    if earlier is not None:
        result = continue_slam(earlier, recordings, config, track)
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
        save_session(folder / GRAPH, result.session, config)
        if explain:
            write_explanation(folder, result, config)

    parts = {"parts": chosen_parts(config)}
    ranges = result.session.ranges.as_metrics()
    return Mapped(recording, config, result, loop_record(result), write, metrics=ranges, manifest=parts)


def _require_name(named: str | None) -> None:
    """InputError when a map cannot be saved by this name beside our own files."""
    if named is not None and (not re.fullmatch(r"[\w][\w.-]*", named) or named in TAKEN):
        raise InputError(
            f"--name {named}: use letters, digits, - and _, without a folder or extension, and none of "
            f"{', '.join(TAKEN)}"
        )


def _notes(recording: Recording, *, several: bool) -> Iterable[str]:
    """A recording's notes; among several, each says which it is of."""
    return (f"{recording.source}: {note}" if several else note for note in recording.notes)


def _settled(config: Path | None, settings: Sequence[str]) -> SlamConfig | InputError:
    """The settings, read before anything else, with the parts they name there; what is wrong with them for
    planar scans is an error only once the input turns out to be planar."""
    try:
        settled = load_config(SlamConfig, config, settings)
        front_end_maker(settled.front_end)
        settled.loops.matcher()
        make_back_end(settled.back_end)
        return settled
    except InputError as error:
        return error


def _recording(path: Path, laser: tuple[SE2 | None, bool], topic: str | None) -> Recording:
    """An input; InputError when it changes while it is read."""
    with unchanged(path):
        return load_recording(path, T_base_lidar=laser[0], upside_down=laser[1], topic=topic)
