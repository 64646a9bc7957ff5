"""The closed loop: a driver run in the simulator, with or without recording a bag."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.durations import nanoseconds
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.ground_truth import known_truth
from turtlebag.datasets.runlog import RunLog
from turtlebag.datasets.types import Trajectory
from turtlebag.pipeline.navigation.command_owner import CommandOwner
from turtlebag.pipeline.navigation.driver import Task
from turtlebag.pipeline.navigation.driver_setup import MAX_SIMULATED_S, make_driver
from turtlebag.pipeline.navigation.explore_driver import ExploreDriver
from turtlebag.pipeline.navigation.metrics import measured
from turtlebag.pipeline.navigation.mission import Mission
from turtlebag.pipeline.navigation.navigator import NavigationDriver
from turtlebag.pipeline.navigation.recorder import NoBag, RunRecorder, trajectory_of
from turtlebag.pipeline.navigation.status_lines import News
from turtlebag.pipeline.navigation.teleop_override import Interval, Script, Source, load_script
from turtlebag.planners.control.collision_monitor import CollisionMonitor
from turtlebag.reports.metrics.navigation import RunMetrics
from turtlebag.sim.robots import static_transforms
from turtlebag.sim.simulator import Simulator


@dataclass(frozen=True, eq=False)
class Episode:
    """The result of a run: metrics, the log, and the estimated pose at each scan."""

    metrics: RunMetrics
    log: RunLog
    truth: Trajectory
    estimate: Trajectory
    grid: OccupancyGrid | None = None
    """The map that the run made, if it made one."""
    asked: tuple[Interval, ...] = ()
    """The overrides, as a script that repeats them."""


class Audience(NamedTuple):
    """Outputs of a run: a bag, messages of the driver, and a view of every tick; by default none.

    A non-empty `interrupted` ends the run.
    """

    bag: BagWriter = NoBag()
    say: Callable[[str], None] = lambda line: None
    news: News | None = None
    interrupted: Sequence[int] = ()


NOBODY = Audience()


def drive(
    simulator: Simulator,
    mission: Mission,
    audience: Audience = NOBODY,
    overrides: Source | None = None,
) -> Episode:
    """Observe, decide, log, act, until the driver is done or the run is interrupted.

    `overrides` says when someone else has the commands; without it, the script of the configuration does.
    """
    bag, say, news, interrupted = audience
    observation = simulator.reset(mission.request.start)
    bag.static_transforms(observation.stamp_ns, static_transforms(mission.robot))
    with known_truth(lambda scan: simulator.scan_truth):
        driver = make_driver(mission, observation, bag, say)
    navigator = driver if isinstance(driver, NavigationDriver) else None
    sequence = None if navigator is None else navigator.sequence
    localiser = None if navigator is None else navigator.localiser
    owner = _owner(driver, mission, overrides)
    recorder = RunRecorder(simulator, bag)
    while True:
        command = owner.step(observation)
        recorder.tick(observation, owner)
        ended = _cut_short(observation.stamp_ns, interrupted)
        if ended and sequence is not None and not driver.finished:
            sequence.close_all("timeout", ended, observation.stamp_ns)
        if news is not None:
            news.tick(observation.stamp_ns, owner, sequence, simulator.truth)
        if driver.finished or ended:
            break
        observation = simulator.step(command)
    estimate = recorder.own() if localiser is None else trajectory_of(localiser.scan_poses)
    truth, log = recorder.truth(), recorder.log()
    grid = driver.grid if isinstance(driver, ExploreDriver) else None
    on_map = None if localiser is None else estimate
    metrics = measured(mission.request.task, log, sequence, truth, on_map, simulator, grid)
    return Episode(metrics, log, truth, estimate, grid, tuple(owner.asked))


def _cut_short(stamp_ns: int, interrupted: Sequence[int]) -> str:
    """Why the run ends here though the driver is not done; empty when it does not."""
    if interrupted:
        return "the run was interrupted"
    return f"the run ended after {MAX_SIMULATED_S:g} s" if stamp_ns > nanoseconds(MAX_SIMULATED_S) else ""


def _owner(driver: Task, mission: Mission, overrides: Source | None) -> CommandOwner:
    """The driver, and the source of teleop overrides."""
    config, model = mission.config, mission.robot.model
    monitor = CollisionMonitor(model) if config.teleop_override.monitor else None
    file = mission.request.teleop_override
    script = load_script(file) if isinstance(file, Path) else config.teleop_override.script
    return CommandOwner(driver, model, overrides or Script(script), monitor)
