"""The stage `plan`: one path over a map, as a table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict

from datasets.errors import InputError
from datasets.maps import load_map
from datasets.outputs import Stopwatch, check_free, staged_output, write_json, write_manifest
from datasets.se2 import SE2
from datasets.seeds import stream
from pipeline.config import config_text
from pipeline.console import log
from planners.costmap import Costmap, CostmapConfig, costmap_from_grid
from planners.footprint import path_clearance, sample_footprint
from planners.global_plan import NoPath, Plan, PlanConfig, fits, plan_path
from sim.robots import RobotSpec, load_robot


class PlanStageConfig(BaseModel):
    """Settings of the stage."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    costmap: CostmapConfig = CostmapConfig()
    plan: PlanConfig = PlanConfig()


def plan(
    map_path: Path,
    robot: str,
    T_map_start: SE2,
    T_map_goal: SE2,
    out: Path,
    *,
    seed: int = 0,
    config: PlanStageConfig | None = None,
    force: bool = False,
    command_line: Sequence[str] = (),
) -> int:
    """Plan from start to goal; 0 with a path, 1 without, both with complete outputs.

    Raises InputError, with nothing written, when start or goal is off the map or in an obstacle.
    """
    check_free(out, force=force)
    watch = Stopwatch()
    config = config or PlanStageConfig()
    spec = load_robot(robot)
    costmap = costmap_from_grid(load_map(map_path), config.costmap)
    for option, pose in (("--start", T_map_start), ("--goal", T_map_goal)):
        _check_pose(option, pose, costmap, spec, map_path)
    found, reason, planning_s = _search(costmap, spec, T_map_start, T_map_goal, config, seed)
    with staged_output(out, force=force) as folder:
        _write_path(folder / "path.csv", found)
        write_json(folder / "metrics.json", plan_metrics(costmap, spec, found, reason, config))
        (folder / "config.yaml").write_text(config_text(config))
        write_manifest(
            folder,
            stage="plan",
            command=command_line,
            inputs={"map": map_path},
            seed=seed,
            wall_s=watch.seconds(),
            extra={"robot": spec.name, "out": str(out), "planning_s": round(planning_s, 6)},
        )
    if found is None:
        log.info(f"no path: {reason}")
        return 1
    log.info(f"{found.length:.2f} m, {len(found.poses)} poses, {planning_s * 1e3:.0f} ms -> {out}")
    return 0


def _search(
    costmap: Costmap, spec: RobotSpec, start: SE2, goal: SE2, config: PlanStageConfig, seed: int
) -> tuple[Plan | None, str, float]:
    watch = Stopwatch()
    plan_seed = int(stream(seed, "plan").integers(2**31))
    try:
        found = plan_path(costmap, spec.model, start, goal, config.plan, plan_seed)
    except NoPath as error:
        return None, str(error), watch.seconds()
    return found, "", watch.seconds()


def _check_pose(option: str, pose: SE2, costmap: Costmap, spec: RobotSpec, map_path: Path) -> None:
    x, y, yaw = pose.xyt.tolist()
    text = f"{option} {x:g},{y:g},{yaw:g}"
    gx, gy = (costmap.T_grid_map @ pose.xy).tolist()
    width, height = costmap.size
    if not (0.0 <= gx < width and 0.0 <= gy < height):
        raise InputError(f"{text}: is off the map {map_path}")
    if not fits(costmap, spec.model, pose):
        raise InputError(f"{text}: the robot would stand in an obstacle or unknown space of {map_path}")


def plan_metrics(
    costmap: Costmap, spec: RobotSpec, found: Plan | None, reason: str, config: PlanStageConfig
) -> dict[str, Any]:
    """Length, clearance of the footprint along the path, and what found it."""
    metrics: dict[str, Any] = {"success": found is not None, "planner": config.plan.ompl.planner}
    metrics["space"] = config.plan.ompl.space
    if found is None:
        return {**metrics, "reason": reason}
    poses = np.ascontiguousarray((costmap.T_grid_map @ found.poses).xyt)
    samples = sample_footprint(spec.model, costmap.resolution / 2.0)
    clearance = path_clearance(
        costmap.clearance,
        costmap.resolution,
        samples.points,
        samples.inscribed,
        samples.circumscribed,
        poses,
        float(poses[0, 0]),
        float(poses[0, 1]),
        np.inf,
    )
    return {
        **metrics,
        "length_m": found.length,
        "min_clearance_m": float(clearance),
        "margin_m": found.margin,
        "poses": len(found.poses),
        "attempts": found.attempts,
    }


def _write_path(path: Path, found: Plan | None) -> None:
    rows = [] if found is None else found.poses.xyt.tolist()
    lines = [f"{x:.6f},{y:.6f},{yaw:.6f}\n" for x, y, yaw in rows]
    path.write_text("x,y,yaw\n" + "".join(lines))
