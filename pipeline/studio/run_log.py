"""Run log and trajectories of a session, written while it runs.

Apart from the view, this is the only module of the studio that sees ground truth.
"""

from __future__ import annotations

from pathlib import Path

from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.runlog import RunLog, write_header
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.trajectories import write_tum
from turtlebag.datasets.types import Observation
from turtlebag.pipeline.navigation.command_owner import CommandOwner
from turtlebag.pipeline.navigation.metrics import measured
from turtlebag.pipeline.navigation.recorder import RunRecorder, trajectory_of
from turtlebag.pipeline.studio.pilot import Task
from turtlebag.reports.metrics.navigation import RunMetrics
from turtlebag.sim.simulator import Simulator

CHUNK_ROWS = 300
"""Rows that are held back before they are written."""


class RunLogWriter(RunRecorder):
    """Keeps the rows of the task under way, for its metrics; everything else is on the disk only."""

    def __init__(self, folder: Path, simulator: Simulator, bag: BagWriter) -> None:
        super().__init__(simulator, bag)
        (folder / "truth").mkdir()
        self._log_file = (folder / "runlog.csv").open("x", newline="")
        write_header(self._log_file)
        self._own_file = (folder / "trajectory.tum").open("x")
        self._truth_file = (folder / "truth/trajectory.tum").open("x")
        self._task: _TaskRows | None = None

    def begin(self) -> None:
        """From the next tick on a task is under way."""
        self._write()
        self._task = _TaskRows()

    def tick(self, observation: Observation, owner: CommandOwner, T_frame_odom: SE2 | None = None) -> None:
        """One control period: what was seen, and what is commanded for the next."""
        super().tick(observation, owner, T_frame_odom)
        if len(self._rows) >= CHUNK_ROWS:
            self._write()

    def end(self, task: Task, grid: OccupancyGrid | None) -> RunMetrics | None:
        """How the task under way went; `grid` is the map that it made. None when it had no tick."""
        self._write()
        assert self._task is not None
        rows, self._task = self._task, None
        if not rows.logs:
            return None
        truth, estimate = trajectory_of(rows.truths), trajectory_of(rows.estimates)
        log, known = RunLog.joined(rows.logs), estimate if task.on_map else None
        return measured(task.kind, log, task.sequence, truth, known, self._simulator, grid)

    def close(self) -> None:
        """Finish the files."""
        self._write()
        for file in (self._log_file, self._own_file, self._truth_file):
            file.close()

    def _write(self) -> None:
        if not self._rows:
            return
        log = self.log()
        log.write_rows(self._log_file)
        write_tum(self.own(), self._own_file)
        write_tum(self.truth(), self._truth_file)
        if self._task is not None:
            self._task.logs.append(log)
            self._task.estimates += self._own
            self._task.truths += self._truth
        self._begin()


class _TaskRows:
    """What was written since a task began."""

    def __init__(self) -> None:
        self.logs: list[RunLog] = []
        self.estimates: list[tuple[int, SE2]] = []
        self.truths: list[tuple[int, SE2]] = []
