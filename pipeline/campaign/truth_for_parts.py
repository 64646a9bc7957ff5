"""Ground truth in place of parts of the pipeline: for the ablation study, and nothing else.

This is the one exception to the rule that truth stays out of estimators, planners and controllers. Only
the command `ablate` may import it; a test reads every import of the project to make sure.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from turtlebag.datasets.bags.reader import read_poses
from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Observation, Odometry, Recording, Twist
from turtlebag.pipeline.navigation.driver_setup import Made, Mission, make_driver, prepare
from turtlebag.pipeline.navigation.episode import Episode, drive
from turtlebag.pipeline.navigation.navigator import NavigationDriver
from turtlebag.pipeline.navigation.online_localiser import OnlineLocaliser
from turtlebag.pipeline.navigation.sensing import Sensing
from turtlebag.pipeline.slam.factors import Constraint
from turtlebag.pipeline.slam.front_end import Placed
from turtlebag.pipeline.slam.icp_odometry import Lines
from turtlebag.pipeline.slam.loop_closure import close_graph
from turtlebag.pipeline.slam.pose_graph import optimise
from turtlebag.pipeline.slam.sessions import Graph
from turtlebag.pipeline.slam.slam import SlamConfig, Steps
from turtlebag.pipeline.slam.tracker import Maker
from turtlebag.reports.stages import Stage
from turtlebag.sim.simulator import Simulator
from turtlebag.sim.world import World

SURE = np.diag([1e6, 1e6, 1e6])
"""Information of a loop that the truth closes: a millimetre, a thousandth of a radian."""


def with_truth(record: Stage, parts: Collection[str]) -> Recording:
    """The recording of a `record` output with the named parts replaced by the truth of its bag."""
    recording = load_recording(record.folder)
    truth = read_poses(record.folder / "bag", "/ground_truth/odom")
    if record.truth is None or len(record.truth) != len(recording):
        raise InputError(f"{record.folder}: its truth does not have one pose for each scan")
    if "odometry" in parts or "poses" in parts:
        recording = replace(recording, T_odom_base=record.truth.poses)
    if "deskew" in parts or "poses" in parts:
        recording = replace(recording, odometry=truth)
    return recording


def with_sensors(config: SlamConfig, parts: Collection[str]) -> SlamConfig:
    """The settings under which replaced poses are taken as they are."""
    return config.model_copy(update={"sensors": "odometry"}) if "poses" in parts else config


def true_steps(T_world_scans: SE2, parts: Collection[str]) -> Steps:
    """The steps of mapping, with front end and loop closure as asked for; poses (n,), one for each scan."""
    usual = Steps()
    return Steps(
        front_end=_true_front_end(T_world_scans) if "front_end" in parts else usual.front_end,
        close_graph=_true_loops(T_world_scans) if "loops" in parts else usual.close_graph,
    )


def _true_front_end(truth: SE2) -> Maker:
    class TrueFrontEnd(Lines):
        """Sees what the usual one sees, from where the scan truly is."""

        def step(self, points: Array, odometry_step: Array | None, wait_s: float) -> Placed:
            """The true motion since the first scan, on from its pose in the track."""
            tracker = self.tracker
            usual = super().step(points, odometry_step, wait_s)
            moved = truth[0].inverse() @ truth[tracker.scan]
            return replace(usual, T_track_base=(SE2(tracker.pose_of(0)) @ moved).xyt, revised=())

    return TrueFrontEnd


def _true_loops(truth: SE2) -> Callable[..., Graph]:
    def closed(*open_graph: Any) -> Graph:
        found = close_graph(*open_graph)
        scans, T_map_keys, _, steps, *_ = open_graph
        T = truth[scans.keys]
        loops = [Constraint(x.j, x.i, (T[x.j].inverse() @ T[x.i]).xyt, SURE, "loop") for x in found.loops]
        poses = optimise(T_map_keys, [*steps, *loops]) if loops else T_map_keys
        return replace(found, T_map_keys=poses, constraints=[*steps, *loops])

    return closed


def true_drive(world: World, mission: Mission, true_map: Path, parts: Collection[str]) -> Episode:
    """A mission driven with the named parts replaced; nothing is recorded. `true_map` is its yaml."""
    config, request = mission.config, mission.request
    if "plan" in parts:
        informed = prepare(replace(request, map_path=true_map), mission.robot, config, world.keepout)
        mission = replace(mission, costmap=informed.costmap)
    if "deskew" in parts:
        lidar = config.sim.lidar.model_copy(update={"turning": False})
        config = config.model_copy(update={"sim": config.sim.model_copy(update={"lidar": lidar})})
        mission = replace(mission, config=config)
    simulators = _TrueWheels if "odometry" in parts else Simulator
    with simulators(world, mission.robot, config.sim, request.seed) as simulator:

        def make(mission: Mission, first: Observation, bag: BagWriter, say: Callable[[str], None]) -> Made:
            driver, localiser, sequence = make_driver(mission, first, bag, say)
            relocaliser = driver.relocaliser if isinstance(driver, NavigationDriver) else None
            if "localisation" in parts and relocaliser is not None:
                localiser = _TrueLocaliser(relocaliser.localiser, driver.sensing, bag, simulator)
                relocaliser.localiser = localiser
            return driver, localiser, sequence

        return drive(simulator, mission, make=make)


class _TrueWheels(Simulator):
    """Odometry without error."""

    def reset(self, T_world_base: SE2 | None = None, step: int = 0) -> Observation:
        """As ever, with true odometry."""
        return self._true(super().reset(T_world_base, step))

    def step(self, command: Twist) -> Observation:
        """As ever, with true odometry."""
        return self._true(super().step(command))

    def _true(self, observation: Observation) -> Observation:
        odometry = Odometry(observation.stamp_ns, self.truth.T_world_base, self.truth.twist)
        return replace(observation, odometry=odometry)


class _TrueLocaliser(OnlineLocaliser):
    """Knows where the robot is. The filter that it takes the place of only says that it was told its pose."""

    def __init__(
        self, usual: OnlineLocaliser, sensing: Sensing, bag: BagWriter, simulator: Simulator
    ) -> None:
        super().__init__(usual.amcl, sensing.odometry, bag)
        self.T_map_odom = usual.T_map_odom
        self._simulator = simulator

    def observe(self, observation: Observation) -> None:
        """The truth, whatever was observed."""
        T_world_base = self._simulator.truth.T_world_base
        self.T_map_odom = T_world_base @ observation.odometry.T_odom_base.inverse()
        if observation.scan is not None:
            self.scan_poses.append((observation.scan.stamp_ns, self._simulator.scan_truth))
