"""What a session leaves behind besides its bags: run log and trajectories, written as it goes on.

Together with the view it is the only place of the studio that sees the truth.
"""

from __future__ import annotations

from pathlib import Path

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.runlog import RunLog, RunLogBuilder, write_header
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.trajectories import write_tum
from turtlebag.datasets.types import Observation, Twist
from turtlebag.pipeline.navigation.metrics import floor_of, goal_of
from turtlebag.pipeline.navigation.recorder import trajectory_of
from turtlebag.pipeline.navigation.takeover import CommandOwner
from turtlebag.pipeline.studio.pilot import Pilot
from turtlebag.pipeline.studio.tasks import Task
from turtlebag.pipeline.studio.tee import Tee
from turtlebag.reports.metrics.navigation import RunMetrics, run_metrics
from turtlebag.sim.simulator import Simulator

CHUNK_ROWS = 300
"""Rows that are held back before they are written."""


class Diary:
    """Keeps the rows of the task under way, for its metrics; everything else is on the disk only."""

    def __init__(self, folder: Path, simulator: Simulator) -> None:
        self._simulator = simulator
        (folder / "truth").mkdir()
        self._log = (folder / "runlog.csv").open("x", newline="")
        write_header(self._log)
        self._estimate = (folder / "trajectory.tum").open("x")
        self._truth = (folder / "truth/trajectory.tum").open("x")
        self._rows = RunLogBuilder()
        self._estimates: list[tuple[int, SE2]] = []
        self._truths: list[tuple[int, SE2]] = []
        self._task: _TaskRows | None = None
        self._owner = "navigation"

    def begin(self) -> None:
        """From the next tick on a task is under way."""
        self._write()
        self._task = _TaskRows()

    def tick(
        self, observation: Observation, pilot: Pilot, owner: CommandOwner, command: Twist, bag: Tee
    ) -> None:
        """One control period: what was seen, and what is commanded for the next."""
        truth = self._simulator.truth
        bag.observation(observation)
        if observation.cloud is not None:
            bag.cloud(observation.stamp_ns, *observation.cloud, "lidar_3d")
        bag.truth(truth.stamp_ns, truth.T_world_base, truth.twist)
        bag.command(observation.stamp_ns, command)
        if owner.owner != self._owner:
            self._owner = owner.owner
            bag.owner(observation.stamp_ns, owner.owner)
        if observation.scan is not None:
            stamp = observation.scan.stamp_ns
            self._truths.append((stamp, self._simulator.scan_truth))
            self._estimates.append((stamp, pilot.T_map_odom @ pilot.sensing.odometry.at(stamp)))
        self._rows.append(
            observation.stamp_ns,
            T_world_base=truth.T_world_base,
            T_map_base=pilot.estimate,
            T_odom_base=observation.odometry.T_odom_base,
            command=command,
            clearance_m=self._simulator.clearance(),
            contact_visible=truth.contact_visible,
            contact_low=truth.contact_low,
            goal_index=pilot.goal_index,
            state=owner.state,
            owner=owner.owner,
        )
        if len(self._rows.stamps) >= CHUNK_ROWS:
            self._write()

    def end(self, task: Task, grid: OccupancyGrid | None) -> RunMetrics | None:
        """How the task under way went; `grid` is the map that it made. None when it had no tick."""
        self._write()
        assert self._task is not None
        rows, self._task = self._task, None
        if not rows.logs:
            return None
        truth, estimate = trajectory_of(rows.truths), trajectory_of(rows.estimates)
        known = estimate if task.on_map and len(estimate) else None
        goals = [goal_of(outcome) for outcome in task.sequence.outcomes] if task.sequence is not None else []
        floor = None
        if task.kind in ("avoid", "explore"):
            robot = self._simulator.robot
            resolution = 0.05 if grid is None else grid.resolution
            floor = floor_of(robot, self._simulator.world.rasterize(robot.lidar_height, resolution), grid)
        return run_metrics(task.kind, RunLog.joined(rows.logs), goals, truth, known, floor)

    def close(self) -> None:
        """Finish the files."""
        self._write()
        for file in (self._log, self._estimate, self._truth):
            file.close()

    def _write(self) -> None:
        if not self._rows.stamps:
            return
        log = self._rows.build()
        log.write_rows(self._log)
        write_tum(trajectory_of(self._estimates), self._estimate)
        write_tum(trajectory_of(self._truths), self._truth)
        if self._task is not None:
            self._task.logs.append(log)
            self._task.estimates += self._estimates
            self._task.truths += self._truths
        self._rows, self._estimates, self._truths = RunLogBuilder(), [], []


class _TaskRows:
    """What was written since a task began."""

    def __init__(self) -> None:
        self.logs: list[RunLog] = []
        self.estimates: list[tuple[int, SE2]] = []
        self.truths: list[tuple[int, SE2]] = []
