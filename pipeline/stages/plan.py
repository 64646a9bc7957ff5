"""The stage `plan`: one path over a map, as a table."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Required, TypedDict, get_args

import numpy as np

from turtlebag.datasets.maps import load_map, map_files
from turtlebag.datasets.outputs import Output, Stopwatch
from turtlebag.datasets.parts import is_own, source_files
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.yaml_files import config_text
from turtlebag.pipeline.navigation.initial_pose import require_free
from turtlebag.pipeline.stages.requests.maps import PlanRequest
from turtlebag.pipeline.stages.settings import load_config
from turtlebag.pipeline.terminal.messages import log
from turtlebag.planners.costmap import Costmap, CostmapConfig, costmap_from_grid
from turtlebag.planners.footprint import path_clearance, sample_footprint
from turtlebag.planners.global_plan import plan_path
from turtlebag.planners.ompl_planner import PlannerName, ompl_loads
from turtlebag.planners.planner import NoPath, Plan, PlanConfig
from turtlebag.sim.robots import RobotSpec, load_robot


class PlanStageConfig(Settings, allow_inf_nan=False):
    """Settings of the stage."""

    costmap: CostmapConfig = CostmapConfig()
    plan: PlanConfig = PlanConfig()


class PlanMetrics(TypedDict, total=False):
    """A plan in numbers: `reason` without a path, and of a path its length, the least clearance of the
    footprint, the margin it was planned with [m] and how many poses it has. `planners` are those that were
    compared."""

    success: Required[bool]
    planner: Required[str]
    reason: str
    length_m: float
    min_clearance_m: float
    margin_m: float
    poses: int
    planners: list[PlanMetrics]


@dataclass(frozen=True, eq=False)
class Query:
    """From where to where on the map, for which robot."""

    robot: RobotSpec
    T_map_start: SE2
    T_map_goal: SE2
    seed: int = 0

    def require_free(self, costmap: Costmap, map_path: Path, options: str = "") -> None:
        """InputError when start or goal is off the map or in an obstacle."""
        for what, pose in (("start", self.T_map_start), ("goal", self.T_map_goal)):
            require_free(f"{options}{what}", pose, costmap, self.robot.model, map_path)


def plan(request: PlanRequest, out: Output) -> int:
    """Plan from start to goal; 0 with a path, 1 without, both with complete outputs.

    With `compare` every planner is asked: its path goes to path-NAME.csv, its numbers to `planners` of the
    metrics. Raises InputError, with nothing written, when start or goal is off the map or in an obstacle.
    """
    map_path, compare, robot = request.map, request.compare, load_robot(request.robot)
    query = Query(robot, SE2.from_xyt(*request.start), SE2.from_xyt(*request.goal), request.seed)
    settings = request.settings | planner_settings(request.planner)
    config = load_config(PlanStageConfig, request.config, settings)
    costmap = costmap_from_grid(load_map(map_path), config.costmap)
    query.require_free(costmap, map_path, "--")
    route, reason, planning_s = search(costmap, query, config)
    metrics = plan_metrics(costmap, query.robot, route, reason, config)
    others: dict[str, tuple[Plan | None, str, float]] = {}
    if compare:
        metrics["planners"] = []
        for other in planners_to_compare(config):
            name = other.plan.name
            own = (route, reason, planning_s) if name == config.plan.name else None
            others[name] = path, why, took_s = own or search(costmap, query, other)
            metrics["planners"].append(plan_metrics(costmap, query.robot, path, why, other))
            log.info("%s", _line(metrics["planners"][-1], took_s))
    parts = {"plan.planner": config.plan.planner}
    with out.staged() as folder:
        _write_path(folder / "path.csv", route)
        for name, (path, *_) in others.items():
            _write_path(folder / f"path-{name}.csv", path)
        out.finish(
            folder,
            "plan",
            {**map_files(map_path), **source_files(parts)},
            metrics=metrics,
            config=config_text(config),
            seed=query.seed,
            extra={
                "robot": query.robot.name,
                "out": str(out.folder),
                "parts": parts,
                "planning_s": round(planning_s, 6),
                **({"planners_s": {n: round(s, 6) for n, (*_, s) in others.items()}} if compare else {}),
            },
        )
    if route is None:
        log.info(f"no path: {reason}")
        return 1
    log.info(f"path of {route.length:.2f} m found in {planning_s * 1e3:.0f} ms -> {out.folder}")
    return 0


def planner_settings(name: str | None) -> dict[str, str]:
    """What the option --planner stands for: one of OMPL's, the lattice, or a class of the user's."""
    if name is None:
        return {}
    if name in get_args(PlannerName):
        return {"plan.planner": "ompl", "plan.ompl.planner": name}
    return {"plan.planner": name}


def planners_to_compare(config: PlanStageConfig) -> list[PlanStageConfig]:
    """The same settings with every planner that is here, the chosen one among them."""
    plans = [config.plan] if is_own(config.plan.planner) else []
    if ompl_loads():
        ompl = [config.plan.ompl.model_copy(update={"planner": name}) for name in get_args(PlannerName)]
        plans += [config.plan.model_copy(update={"planner": "ompl", "ompl": one}) for one in ompl]
    else:
        log.info("the planners of OMPL are left out, which is not here")
    plans.append(config.plan.model_copy(update={"planner": "lattice"}))
    return [config.model_copy(update={"plan": plan}) for plan in plans]


def _line(metrics: PlanMetrics, seconds: float) -> str:
    if not metrics["success"]:
        return f"{metrics['planner']}: {metrics['reason']}"
    return (
        f"{metrics['planner']}: {metrics['length_m']:.2f} m, {metrics['min_clearance_m']:.2f} m clear, "
        f"{seconds * 1e3:.0f} ms"
    )


def search(costmap: Costmap, query: Query, config: PlanStageConfig) -> tuple[Plan | None, str, float]:
    """The path, or None and why there is none; and the wall time it took [s]."""
    watch = Stopwatch()
    plan_seed = int(stream(query.seed, "plan").integers(2**31))
    try:
        route = plan_path(
            costmap, query.robot.model, query.T_map_start, query.T_map_goal, config.plan, plan_seed
        )
    except NoPath as error:
        return None, str(error), watch.seconds()
    return route, "", watch.seconds()


def plan_metrics(
    costmap: Costmap, spec: RobotSpec, route: Plan | None, reason: str, config: PlanStageConfig
) -> PlanMetrics:
    """Length, clearance of the footprint along the path, and its planner."""
    metrics: PlanMetrics = {"success": route is not None, "planner": config.plan.name}
    if route is None:
        return {**metrics, "reason": reason}
    poses = np.ascontiguousarray((costmap.T_grid_map @ route.poses).xyt)
    samples = sample_footprint(spec.model, costmap.resolution / 2.0)
    clearance = path_clearance(
        costmap.clearance, costmap.resolution, samples, poses, float(poses[0, 0]), float(poses[0, 1]), np.inf
    )
    return {
        **metrics,
        "length_m": route.length,
        "min_clearance_m": float(clearance),
        "margin_m": route.margin,
        "poses": len(route.poses),
    }


def _write_path(path: Path, route: Plan | None) -> None:
    rows = [] if route is None else route.poses.xyt.tolist()
    lines = [f"{x:.6f},{y:.6f},{yaw:.6f}\n" for x, y, yaw in rows]
    path.write_text("x,y,yaw\n" + "".join(lines))
