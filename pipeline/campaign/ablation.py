"""The stage `ablate`: map a recording, and drive on the map, with parts replaced by ground truth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.maps import save_map
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.trajectories import save_tum
from turtlebag.datasets.yaml_files import config_text
from turtlebag.pipeline.campaign.parts import PARTS
from turtlebag.pipeline.campaign.truth_for_parts import true_drive, true_steps, with_sensors, with_truth
from turtlebag.pipeline.navigation.config import NavigateConfig
from turtlebag.pipeline.navigation.driver_setup import Request, prepare
from turtlebag.pipeline.slam.slam import SlamConfig, run_slam
from turtlebag.pipeline.stages.settings import load_config
from turtlebag.pipeline.terminal.messages import track
from turtlebag.reports.metrics.navigation import RunMetrics
from turtlebag.reports.metrics.references import References
from turtlebag.reports.stages import Stage, load_stage
from turtlebag.sim.robots import load_robot
from turtlebag.sim.simulator import SimConfig
from turtlebag.sim.worlds import load_world


def ablate(
    folder_of_record: Path,
    out: Output,
    *,
    replace: str = "none",
    patrol: bool = False,
    config: Path | None = None,
    settings: Sequence[str] = (),
) -> int:
    """Write to `out` a map of a record and the errors that are left when parts are replaced by the truth.

    `replace` names the parts, with commas between them, or is "none". With `patrol` the tutorial's patrol is
    driven on the map too. InputError, with nothing written, for an unknown part or a folder without truth.
    """
    parts = [] if replace == "none" else replace.split(",")
    for part in parts:
        if part not in PARTS:
            raise InputError(f"--replace {part}: unknown part (known: none, {', '.join(PARTS)})")
    record = load_stage(folder_of_record)
    if record.kind != "record" or record.truth is None or record.true_map is None:
        raise InputError(f"{folder_of_record}: has no ground truth; give the output of record")
    resolved = with_sensors(load_config(SlamConfig, config, settings), parts)
    recording, steps = with_truth(record, parts), true_steps(record.truth.poses, parts)
    result = run_slam(recording, resolved, track, steps=steps)
    with out.staged([folder_of_record]) as folder:
        save_map(result.grid, folder)
        save_tum(result.trajectory, folder / "trajectory.tum")
        errors = References(record.truth, record.true_map).errors(result.trajectory, result.grid)
        left = {"replaced": parts, **errors}
        if patrol:
            left["patrol"] = _patrol(record, folder / "map.yaml", parts)
        inputs, config_yaml = {"source": folder_of_record}, config_text(resolved)
        out.finish(folder, "ablate", inputs, metrics=left, config=config_yaml, seed=record.manifest.seed)
    return 0


def _patrol(record: Stage, built: Path, parts: list[str]) -> RunMetrics:
    """The tutorial's patrol in the record's world, with its robot, sensors and seed: the run's numbers."""
    world = load_world(record.fact("world") or "")
    sim = SimConfig.model_validate(record.config.get("sim", {}))
    robot = load_robot(record.fact("robot") or world.robot)
    request = Request(task="patrol", seed=record.manifest.seed or 0, map_path=built, initial_pose="start")
    mission = prepare(request, robot, NavigateConfig(sim=sim), world.keepout)
    return true_drive(world, mission, record.folder / "truth/map.yaml", parts).metrics
