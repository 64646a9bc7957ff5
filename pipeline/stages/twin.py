"""Stage `twin`: a bag in; its map, world and robot out, and the same drive real beside simulated."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import Output, Stopwatch, write_json
from turtlebag.datasets.parts import source_files
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.trajectories import load_tum
from turtlebag.datasets.types import Recording, Trajectory
from turtlebag.datasets.yaml_files import config_text
from turtlebag.pipeline.identify.identify import Identification, Streams, identified, require_motion
from turtlebag.pipeline.localisation.parameters import AmclConfig
from turtlebag.pipeline.slam.graph.edits import Edits
from turtlebag.pipeline.slam.mapper import SlamConfig, SlamResult, run_slam
from turtlebag.pipeline.stages.identify import base_of, tell_of, write_identification
from turtlebag.pipeline.stages.localise import LocaliseConfig, aligned_in_time, run_amcl
from turtlebag.pipeline.stages.map import map_scans, save_mapped
from turtlebag.pipeline.stages.map_summary import Mapped, summary
from turtlebag.pipeline.stages.record import Scene, record_drive
from turtlebag.pipeline.stages.requests.robots import TwinRequest
from turtlebag.pipeline.stages.settings import load_config
from turtlebag.pipeline.stages.sources import recording_of
from turtlebag.pipeline.terminal.messages import log, track
from turtlebag.pipeline.twin.comparison import Difference, compare
from turtlebag.pipeline.twin.driver import Drive
from turtlebag.pipeline.twin.samples import Samples, samples_of
from turtlebag.reports.figures.album import Album
from turtlebag.reports.figures.robots import draw_twin
from turtlebag.reports.twin import twin_page
from turtlebag.sim.robots import RobotSpec
from turtlebag.sim.simulator import SimConfig
from turtlebag.sim.surroundings import Surroundings
from turtlebag.sim.world import World
from turtlebag.sim.worlds import load_world

FROM_THE_START = LocaliseConfig(amcl=AmclConfig(recovery_alpha_slow=0.0))
"""Both start where they are; a search for a lost robot would take longer than all the rest."""


@dataclass(frozen=True, eq=False)
class Looked:
    """A drive that was mapped and localised, and what it looks like."""

    mapped: SlamResult
    samples: Samples


def make_twin(request: TwinRequest, out: Output) -> int:
    """Write the twin of a recording, and drive it as often as asked; 0.

    InputError for a recording without scans, odometry or motion, or with no place to start from on its map.
    """
    (base, files), seed = base_of(request), request.seed
    watch, settled = Stopwatch(), load_config(SlamConfig, request.config, request.settings)
    recording = recording_of(request)
    require_motion(recording)
    mapped = map_scans([recording], settled, None, Edits(), explain=False)
    result = mapped.result
    assert isinstance(result, SlamResult)
    tell_of(recording)
    streams, source = Streams.of(request.source), request.source
    found = identified(recording, result.session, base, streams)
    with out.staged() as folder:
        drive = write_twin(mapped, found, Drive.of(result.trajectory, streams.commands), folder, source)
        real = _looked(recording, result, seed)
        simulated = [_simulated(folder, found, drive, settled, seed, k) for k in range(request.drives)]
        differences = compare(real.samples, [one.samples for one in simulated])
        _write_page(folder, source, found, differences, real, simulated)
        parts = settled.parts()
        inputs = {"source": source, **files, **source_files(parts)}
        metrics = metrics_of(recording, request.drives, differences)
        out.finish(
            folder, "twin", inputs, metrics=metrics, config=config_text(settled), seed=seed,
            extra={"robot": base.name, "parts": parts},
        )  # fmt: skip
    _tell(differences, out.folder, watch.seconds())
    return 0


def metrics_of(recording: Recording, drives: int, differences: list[Difference]) -> dict[str, Any]:
    """metrics.json."""
    apart = [one.quantity.name for one in differences if one.differs]
    return {
        "scans": len(recording), "log_s": recording.duration(), "drives": drives,
        "compared": len(differences), "differ": len(apart), "told_apart": apart,
        "quantities": {one.quantity.name: one.as_metrics() for one in differences},
    }  # fmt: skip


def write_twin(mapped: Mapped, found: Identification, drive: Drive, folder: Path, source: Path) -> Drive:
    """The map as `map` writes it, the robot as `identify` does, its own two files on top, and the world; the
    drive from the first place on that is free on that map, InputError where none is."""
    (folder / "map").mkdir()
    save_mapped(mapped, folder / "map", None)
    write_json(
        folder / "map" / "metrics.json", {**summary(mapped.recording, mapped.result), **mapped.metrics}
    )
    (folder / "map" / "config.yaml").write_text(config_text(mapped.config))
    (folder / "identify").mkdir()
    write_identification(found, folder / "identify", source)
    for name in ("robot.yaml", "identify.json"):
        (folder / "identify" / name).rename(folder / name)
    drive = _start(drive, folder, found.robot)
    _write_world(folder, drive.path.poses[0], source)
    return drive


def _write_world(folder: Path, spawn: SE2, source: Path) -> None:
    """The world file: the map's walls; what is unknown there stops neither beams nor the robot."""
    data = {
        "name": f"twin_of_{source.stem}",
        "robot": "burger",
        "spawn": [round(value, 6) for value in spawn.xyt.tolist()],
        "shapes": [{"kind": "map", "file": "map/map.yaml", "unknown": "free"}],
    }
    (folder / "world.yaml").write_text(yaml.safe_dump(data, sort_keys=False))


def _start(drive: Drive, folder: Path, robot: RobotSpec) -> Drive:
    _write_world(folder, drive.path.poses[0], Path("twin"))
    around = Surroundings(load_world(str(folder / "world.yaml")), robot, 0)
    for number in range(0, len(drive.path) // 2, 5):
        try:
            around.require_free(drive.path.poses[number], "start")
        except InputError:
            continue
        return drive.later(number)
    raise InputError("twin: the robot has no place to stand where it drove, by its own map")


def _simulated(
    folder: Path,
    found: Identification,
    drive: Drive,
    config: SlamConfig,
    seed: int,
    number: int,
) -> Looked:
    """One drive in the twin, by a robot drawn from the intervals, mapped and localised."""
    robot, sim_seed = found.drawn(stream(seed, f"twin robot {number}")), seed + number
    recording, _ = driven_again(load_world(str(folder / "world.yaml")), robot, drive, sim_seed)
    return _looked(recording, run_slam(recording, config, track), sim_seed)


def driven_again(world: World, robot: RobotSpec, drive: Drive, seed: int) -> tuple[Recording, Trajectory]:
    """A drive in a world, recorded and read again as a bag is; and the truth at its scans."""
    start = drive.path.poses[0]
    scene = Scene("world.yaml", "robot.yaml", world, robot, SimConfig().resolved(robot), start, seed)
    with tempfile.TemporaryDirectory() as place:
        there = Path(place) / "drive"
        if record_drive(scene, drive.driver(), "twin", Output(there), tell=False) >= 128:
            raise KeyboardInterrupt
        return load_recording(there), _undelayed(load_tum(there / "truth" / "trajectory.tum"), robot)


def _undelayed(truth: Trajectory, robot: RobotSpec) -> Trajectory:
    """The truth where the beams of the scans were taken, and not at their late stamps: as a map has it."""
    late_ns = round(1e9 * float(np.mean(robot.lidar.errors.stamp_delay)))
    stamps, first = np.unique(truth.stamps_ns, return_index=True)  # two lidars may scan at once
    path = Trajectory(stamps, truth.poses[first])
    return Trajectory(truth.stamps_ns, path.at(truth.stamps_ns - late_ns))


def _looked(recording: Recording, mapped: SlamResult, seed: int) -> Looked:
    """What a drive looks like, real or simulated."""
    start = mapped.trajectory.poses[0]
    localised = run_amcl(aligned_in_time(recording), mapped.grid, start, FROM_THE_START, stream(seed, "amcl"))
    return Looked(mapped, samples_of(recording, mapped, localised.trajectory))


def _write_page(
    folder: Path,
    source: Path,
    found: Identification,
    differences: list[Difference],
    real: Looked,
    simulated: list[Looked],
) -> None:
    album = Album(folder / "figures")
    draw_twin(differences, real.mapped.grid, simulated[0].mapped.grid, album)
    shown = sum(one.observable for one in found.estimates)
    about = {"base": found.base.name, "shown": shown, "total": len(found.estimates), "drives": len(simulated)}
    (folder / "index.html").write_text(twin_page(source.name, about, differences, album.pictures))


def _tell(differences: list[Difference], folder: Path, wall_s: float) -> None:
    apart_ones = [one for one in differences if one.differs]
    for one in apart_ones[:3]:
        log.info(f"{one.quantity.label}: {one.sentence}")
    log.info(
        f"real and simulated differ in {len(apart_ones)} of {len(differences)} quantities, in {wall_s:.1f} s "
        f"-> {folder / 'index.html'}"
    )
