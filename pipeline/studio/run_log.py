"""Run log and trajectories of a session, written when it ends.

Apart from the view, this is the only module of the studio that sees ground truth.
"""

from __future__ import annotations

from pathlib import Path

from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.runlog import RunLog
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.trajectories import save_tum
from turtlebag.datasets.types import Observation
from turtlebag.pipeline.navigation.command_owner import CommandOwner
from turtlebag.pipeline.navigation.metrics import measured
from turtlebag.pipeline.navigation.recorder import RunRecorder, trajectory_of
from turtlebag.pipeline.studio.pilot import Task
from turtlebag.reports.metrics.navigation import RunMetrics
from turtlebag.sim.simulator import Simulator

CHUNK_ROWS = 300
"""So many rows become arrays, a sixth of their size."""


class SessionRecorder(RunRecorder):
    """Keeps the rows of a session, which may last for hours, and where in them the task under way began."""

    def __init__(self, simulator: Simulator, bag: BagWriter) -> None:
        super().__init__(simulator, bag)
        self._parts: list[RunLog] = []
        self._task = 0, 0

    def begin(self) -> None:
        """From the next tick on a task is under way."""
        self._pack()
        self._task = len(self._parts), len(self._own)

    def tick(self, observation: Observation, owner: CommandOwner, T_frame_odom: SE2 | None = None) -> None:
        """One control period: what was seen, and what is commanded for the next."""
        super().tick(observation, owner, T_frame_odom)
        if len(self._rows) >= CHUNK_ROWS:
            self._pack()

    def end(self, task: Task, grid: OccupancyGrid | None) -> RunMetrics | None:
        """How the task under way went; `grid` is the map that it made. None when it had no tick."""
        self._pack()
        part, scan = self._task
        if part == len(self._parts):
            return None
        truth, estimate = trajectory_of(self._truth[scan:]), trajectory_of(self._own[scan:])
        log, known = RunLog.joined(self._parts[part:]), estimate if task.on_map else None
        return measured(task.kind, log, task.sequence, truth, known, self._simulator, grid)

    def save(self, folder: Path) -> None:
        """Write the files of the session."""
        (folder / "truth").mkdir(exist_ok=True)
        RunLog.joined([*self._parts, self.log()]).save(folder / "runlog.csv")
        save_tum(self.own(), folder / "trajectory.tum")
        save_tum(self.truth(), folder / "truth/trajectory.tum")

    def _pack(self) -> None:
        if self._rows:
            self._parts.append(self.log())
            self._rows = []
