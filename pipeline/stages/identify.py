"""Stage `identify`: a bag in, the robot that made it out: a file for the simulator, and a page."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import yaml

from turtlebag.datasets.outputs import Output, Stopwatch, write_json
from turtlebag.datasets.parts import source_files
from turtlebag.datasets.types import Recording
from turtlebag.datasets.yaml_files import config_text
from turtlebag.pipeline.identify.identify import Identification, Streams, identify, require_motion
from turtlebag.pipeline.identify.robot_file import nav2_yaml, scan_filter, transform_arguments
from turtlebag.pipeline.slam.mapper import SlamConfig
from turtlebag.pipeline.stages.requests.robots import IdentifyRequest, TwinRequest
from turtlebag.pipeline.stages.settings import load_config
from turtlebag.pipeline.stages.sources import recording_of
from turtlebag.pipeline.terminal.messages import log, log_notes, track
from turtlebag.reports.figures.album import Album
from turtlebag.reports.figures.robots import draw_plots
from turtlebag.reports.identify import identify_page
from turtlebag.sim.robots import RobotSpec, load_robot


def identify_robot(request: IdentifyRequest, out: Output) -> int:
    """Write the robot of a recording; 0. InputError for a recording without scans, odometry or motion."""
    base, files = base_of(request)
    watch, settled = Stopwatch(), load_config(SlamConfig, request.config, request.settings)
    recording = recording_of(request)
    require_motion(recording)
    tell_of(recording)
    found = identify(recording, base, Streams.of(request.source), settled, track)
    parts = settled.parts()
    with out.staged() as folder:
        write_identification(found, folder, request.source)
        inputs = {"source": request.source, **files, **source_files(parts)}
        out.finish(
            folder, "identify", inputs, metrics=metrics_of(found), config=config_text(settled),
            extra={"robot": base.name, "parts": parts},
        )  # fmt: skip
    shown = sum(one.observable for one in found.estimates)
    of = f"{shown} of {len(found.estimates)} parameters"
    log.info(f"{of} in {watch.seconds():.1f} s -> {out.folder / 'robot.yaml'}")
    return 0


def base_of(request: IdentifyRequest | TwinRequest) -> tuple[RobotSpec, dict[str, Path]]:
    """The robot that gives what no recording shows, and its file if it is one of the user's."""
    place = Path(request.robot)
    return load_robot(request.robot), {"robot": place} if place.is_file() else {}


def tell_of(recording: Recording) -> None:
    """What was repaired, and which of several lidars is identified."""
    log_notes(recording.notes)
    if recording.others:
        others = " or ".join(f"--topic {lidar.topic}" for lidar in recording.others)
        log.info(f"note: the robot has the lidar of {recording.topic}; {others} identifies another one")


def metrics_of(found: Identification) -> dict[str, Any]:
    """metrics.json: each parameter, its equation apart."""
    parameters = {
        name: {key: value for key, value in entry.items() if key != "equation"}
        for name, entry in found.as_record()["parameters"].items()
    }
    shown = sum(one.observable for one in found.estimates)
    counts = {"scans": len(found.recording), "log_s": found.recording.duration(), "observable": shown}
    return {**counts, "parameters": parameters}


def write_identification(found: Identification, folder: Path, source: Path) -> None:
    """robot.yaml, identify.json, what other programs want, and the page with its figures."""
    values, base = found.values, found.base
    heading = (
        f"# Identified by turtlebag identify; shape, masses and what the bag does not show: {base.name}.\n"
    )
    (folder / "robot.yaml").write_text(heading + _yaml(found.robot.model_dump(mode="json")))
    write_json(folder / "identify.json", found.as_record())
    (folder / "nav2.yaml").write_text(_yaml(nav2_yaml(values, base)))
    (folder / "scan_filter.yaml").write_text(_yaml(scan_filter(values)))
    (folder / "static_transform_publisher.txt").write_text(transform_arguments(values, base))
    plots = {name: plot.as_record() for name, plot in found.plots.items()}
    (folder / "plots.json").write_text(json.dumps(plots))
    album = Album(folder / "figures")
    draw_plots(plots, album)
    others = {
        name: (folder / name).read_text()
        for name in ("nav2.yaml", "scan_filter.yaml", "static_transform_publisher.txt")
    }
    data = {name: key for key, plot in found.plots.items() for name in plot.of}
    page = identify_page(source.name, found.as_record(), album.pictures, data, others)
    (folder / "index.html").write_text(page)


def _yaml(data: dict[str, Any]) -> str:
    return yaml.safe_dump(_short(data), sort_keys=False, default_flow_style=None, width=110)


def _short(data: Any) -> Any:
    """The data with six digits of each number."""
    if isinstance(data, dict):
        return {key: _short(value) for key, value in data.items()}
    if isinstance(data, list):
        return [_short(value) for value in data]
    return float(f"{data:.6g}") if isinstance(data, float) else data
