"""The stage `navigate`: a task driven in closed loop with the simulator, recorded and measured."""

from __future__ import annotations

import logging
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from turtlebag.datasets.bags.footprint import footprint_text
from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.maps import map_files, save_map
from turtlebag.datasets.outputs import Output, sha256_text
from turtlebag.datasets.parts import source_files
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.trajectories import save_tum
from turtlebag.datasets.yaml_files import config_text
from turtlebag.pipeline.navigation.config import NavigateConfig
from turtlebag.pipeline.navigation.driver_setup import DEFAULT_DURATION_S, prepare
from turtlebag.pipeline.navigation.episode import Audience, Episode, drive
from turtlebag.pipeline.navigation.mission import Mission, Request
from turtlebag.pipeline.navigation.status_lines import News, verdict
from turtlebag.pipeline.navigation.teleop_override import Source, script_text
from turtlebag.pipeline.stages.record import save_truth
from turtlebag.pipeline.stages.requests.drives import NavigateRequest
from turtlebag.pipeline.stages.settings import load_config
from turtlebag.pipeline.stages.sources import pose_or_word
from turtlebag.pipeline.terminal.interrupts import deferred_interrupt, require_no_hangup
from turtlebag.pipeline.terminal.messages import log, redrawn, say, simulated_time
from turtlebag.planners.costmap import Area, area_mask
from turtlebag.planners.tasks.waypoints import load_keepout
from turtlebag.reports.metrics.navigation import RunMetrics
from turtlebag.sim.robots import RobotSpec, load_robot
from turtlebag.sim.simulator import Simulator
from turtlebag.sim.world import World
from turtlebag.sim.worlds import load_world, own_files


def navigate_as_asked(request: NavigateRequest, out: Output) -> int:
    """Run the task of a request; the exit code of `navigate`."""
    settings = request.settings | ({"avoid.mode": request.mode} if request.mode else {})
    drive = Request(
        task=request.task,
        seed=request.seed,
        map_path=request.map,
        start=None if request.start is None else SE2.from_xyt(*request.start),
        initial_pose=pose_or_word(request.initial_pose),
        goal=None if request.goal is None else SE2.from_xyt(*request.goal),
        waypoints_path=request.waypoints,
        laps=request.laps,
        timeout_s=request.timeout,
        duration_s=request.duration,
        wiggle=request.wiggle,
        teleop_override=request.teleop_override,
        keepout=_areas(request.keepout),
        keepout_path=None if request.keepout in (None, "none") else Path(request.keepout),
    )
    world = load_world(request.world)
    files = own_files(request.world, request.robot)
    return navigate(
        world,
        load_robot(request.robot or world.robot),
        drive,
        out,
        config=load_config(NavigateConfig, request.config, settings),
        say=say if log.isEnabledFor(logging.INFO) else lambda line: None,
        files=files | ({"config": request.config} if isinstance(request.config, Path) else {}),
    )


def _areas(keepout: Path | str | None) -> tuple[Area, ...] | None:
    """The areas of a file, or none; None: the world's own."""
    return load_keepout(keepout) if isinstance(keepout, Path) else None if keepout is None else ()


def navigate(
    world: World,
    robot: RobotSpec,
    request: Request,
    out: Output,
    *,
    config: NavigateConfig | None = None,
    say: Callable[[str], None] = say,
    files: Mapping[str, Path] | None = None,
) -> int:
    """Run a task and write the run outputs to `out`; 0 when it truly succeeded, 1 when it did not.

    What counts is the truth, `true_success` of the metrics: a robot that believes that it has reached its
    goal and stands elsewhere has failed. Interrupted at the keyboard of an override, 130 or 143: what was
    driven until then cannot be driven again, and is kept. Unfinished when the disk is full or the terminal
    was closed: what there is of the run is kept beside the output.

    `say` takes the decisions of the task avoid, a line each. `files` are inputs that the manifest is to name
    besides those of the request. InputError, with nothing written, for bad goals and unreadable maps.
    """
    mission = prepare(request, robot, config or NavigateConfig(), world.keepout)
    _refuse_outlines_off(mission)
    custom = _of_bag(world, mission)
    known_s = request.duration_s or DEFAULT_DURATION_S
    by_hand = request.teleop_override == "keyboard"
    with (
        deferred_interrupt() if by_hand else deferred_interrupt([signal.SIGHUP]) as interrupted,
        Simulator(world, mission.robot, mission.config.sim, request.seed) as simulator,
        out.staged(save_bag=True) as folder,
    ):
        with (
            BagWriter(folder / "bag", custom=custom, lidars=mission.robot.lidars) as bag,
            _overrides(mission) as overrides,
            simulated_time(known_s if request.task == "avoid" else None) as clock,
        ):
            news = News(_opening(world, mission), log.info, clock)
            episode = drive(simulator, mission, Audience(bag, say, news, interrupted), overrides)
        require_no_hangup(interrupted)
        metrics, loop_s, parts = episode.metrics, out.wall_s, _parts(mission)
        _write(folder, episode, simulator)
        out.finish(
            folder,
            "navigate",
            {**_inputs(request), **(files or {}), **source_files(parts)},
            metrics=metrics,
            config=config_text(mission.config),
            seed=request.seed,
            extra={
                "world": world.name,
                "robot": mission.robot.name,
                "task": request.task,
                "parts": parts,
                "out": str(out.folder),
                "realtime_factor": round(metrics["time_s"] / max(loop_s, 1e-9), 2),
                **({"interrupted": True} if interrupted else {}),
            },
        )
    _report(mission, metrics, interrupted, out.folder)
    return 128 + interrupted[0] if interrupted else int(not metrics["true_success"])


def _of_bag(world: World, mission: Mission) -> dict[str, str]:
    """What the bag says of its run."""
    return {
        "seed": str(mission.request.seed),
        "config_sha256": sha256_text(config_text(mission.config)),
        "world": world.name,
        "task": mission.request.task,
        **footprint_text(mission.robot.model.footprint),
    }


def _write(folder: Path, episode: Episode, simulator: Simulator) -> None:
    """What a run leaves beside its bag."""
    save_tum(episode.estimate, folder / "trajectory.tum")
    episode.log.save(folder / "runlog.csv")
    if episode.grid is not None:
        save_map(episode.grid, folder)
    if episode.asked:
        (folder / "teleop_override.yaml").write_text(script_text(episode.asked))
    save_truth(folder / "truth", episode.truth, simulator.world, simulator.robot)


def _report(mission: Mission, metrics: RunMetrics, interrupted: Sequence[int], out: Path) -> None:
    """When the robot was kidnapped, and how the run ended."""
    for when, x, y, yaw in mission.config.sim.faults.kidnap:
        if when <= metrics["time_s"]:
            log.info(f"kidnapped at {when:g} s to ({x:g}, {y:g}, {yaw:g})")
    if interrupted:
        log.warning("interrupted; the run so far is kept")
    log.info(f"{verdict(metrics)} -> {out}")


def _parts(mission: Mission) -> dict[str, str | None]:
    """The exchangeable parts of a run by the settings that choose them; None: not used."""
    config, on_a_map = mission.config, mission.grid is not None
    return {
        "task": mission.request.task,
        "localiser": config.localiser if on_a_map else None,
        "plan.planner": config.plan.planner,
        "controller": config.controller if on_a_map else config.mapless.controller,
    }


def _opening(world: World, mission: Mission) -> str:
    """What is going to be done, in one line."""
    request, laps = mission.request, mission.config.sequence.laps
    tasks = {
        "goal": "drive to a goal",
        "patrol": f"patrol of {len(mission.waypoints)} goals" + (f", {laps} laps" if laps > 1 else ""),
        "avoid": "drive around and avoid obstacles",
        "explore": "explore and map",
    }
    doing = tasks.get(request.task, f"task {request.task}")
    return f"{doing}: {mission.robot.name} in {world.name}, seed {request.seed}"


@contextmanager
def _overrides(mission: Mission) -> Iterator[Source | None]:
    """The keyboard, if it may override; the terminal is as before afterwards."""
    if mission.request.teleop_override != "keyboard":
        yield None
        return
    from turtlebag.pipeline.terminal.keyboard_teleop import OverrideKeys, clock, keys_of, show

    show(OverrideKeys.TABLE + "\n")
    with keys_of(sys.stdin.fileno()) as read_keys, redrawn() as redraw:
        yield OverrideKeys(
            mission.robot.limits, read_keys, clock(mission.config.teleop_override.speed), redraw
        )


def _inputs(request: Request) -> dict[str, Path]:
    inputs = {} if request.map_path is None else map_files(request.map_path)
    if isinstance(request.teleop_override, Path):
        inputs["teleop_override"] = request.teleop_override
    if request.waypoints_path is not None:
        inputs["waypoints"] = request.waypoints_path
    if request.keepout_path is not None:
        inputs["keepout"] = request.keepout_path
        if any(isinstance(area, OccupancyGrid) for area in request.keepout or ()):
            inputs["keepout_image"] = map_files(request.keepout_path)["map_image"]
    return inputs


def _refuse_outlines_off(mission: Mission) -> None:
    """InputError for an area of --keepout that covers no cell of the map: it would keep out of nothing."""
    if mission.costmap is None or mission.request.keepout_path is None:
        return
    for number, area in enumerate(mission.request.keepout or (), start=1):
        if not area_mask(mission.costmap, area).any():
            raise InputError(
                f"--keepout {mission.request.keepout_path}: keepout {number}: lies outside the map "
                f"{mission.request.map_path}; correct it or remove it"
            )
