"""Records a run: bag, run log, both trajectories. The only module of navigation that sees ground truth."""

from __future__ import annotations

import numpy as np

from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.runlog import Row, RunLog
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Observation, Trajectory
from turtlebag.pipeline.navigation.command_owner import CommandOwner
from turtlebag.sim.simulator import Simulator


class NoBag(BagWriter):
    """A bag that stores nothing, for when only the numbers of a run are wanted."""

    def __init__(self) -> None:
        """Opens nothing."""

    def _write(self, topic: str, log_time_ns: int, *message: object) -> None:
        """Makes and stores nothing."""


class RunRecorder:
    """Writes each tick of a run to the bag and keeps its rows; at the stamps of the scans also the true pose
    and the robot's estimate, `T_frame_odom` @ odometry."""

    def __init__(self, simulator: Simulator, bag: BagWriter) -> None:
        self._simulator = simulator
        self._bag = bag
        self._owner = "navigation"
        self._begin()

    def _begin(self) -> None:
        self._rows: list[Row] = []
        self._truth: list[tuple[int, SE2]] = []
        self._own: list[tuple[int, SE2]] = []

    def tick(self, observation: Observation, owner: CommandOwner, T_frame_odom: SE2 | None = None) -> None:
        """One control period: the observation, and the command for the next."""
        truth = self._simulator.truth
        self._bag.observation(observation)
        self._bag.truth(truth.stamp_ns, truth.T_world_base, truth.twist)
        self._bag.command(observation.stamp_ns, owner.command)
        if owner.owner != self._owner:
            self._owner = owner.owner
            self._bag.owner(observation.stamp_ns, owner.owner)
        if observation.scan is not None:
            stamp = observation.scan.stamp_ns
            self._truth.append((stamp, self._simulator.scan_truth))
            T_odom_base = owner.driver.sensing.odometry.at(stamp)
            self._own.append((stamp, T_odom_base if T_frame_odom is None else T_frame_odom @ T_odom_base))
        row = Row(
            t_ns=observation.stamp_ns,
            T_world_base=truth.T_world_base,
            T_map_base=owner.driver.estimate,
            T_odom_base=observation.odometry.T_odom_base,
            command=owner.command,
            clearance_m=self._simulator.clearance(),
            contact_visible=truth.contact_visible,
            contact_low=truth.contact_low,
            goal_index=owner.driver.goal_index,
            state=owner.state,
            owner=owner.owner,
        )
        self._rows.append(row)

    def log(self) -> RunLog:
        """All rows so far."""
        return RunLog.of(self._rows)

    def truth(self) -> Trajectory:
        """True base poses at the stamps of the scans."""
        return trajectory_of(self._truth)

    def own(self) -> Trajectory:
        """The robot's estimated poses at the stamps of the scans."""
        return trajectory_of(self._own)


def trajectory_of(samples: list[tuple[int, SE2]]) -> Trajectory:
    """Stamped poses as a trajectory, which may be empty."""
    stamps = np.array([stamp for stamp, _ in samples], dtype=np.int64)
    poses = SE2.stack([pose for _, pose in samples]) if samples else SE2.identity(0)
    return Trajectory(stamps, poses)
