"""The map on display, and the walls that a person draws on it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.graph.edits import Edits, WallEdit
from turtlebag.pipeline.slam.mapper import SlamResult
from turtlebag.pipeline.slam.walls import with_walls
from turtlebag.pipeline.studio import inputs
from turtlebag.pipeline.studio.loops_shown import ShownGraph, graph_of
from turtlebag.pipeline.studio.view import MapLayer


@dataclass(frozen=True, eq=False)
class Drawn:
    """The map on display, and the log that it was made of, its sensors corrected as far as the mapper does.

    Only a map of the whole bag has `edits`, and its `result` without the walls among them.
    """

    layer: MapLayer
    graph: ShownGraph
    T_map_odom: SE2
    log: Recording
    result: SlamResult | None = None
    edits: Edits = Edits()  # noqa: RUF009 (frozen)

    @staticmethod
    def of(result: SlamResult, edits: Edits) -> Drawn:
        """The map of a whole bag, with the walls of the edits."""
        log, poses = result.session.recording, result.trajectory.poses
        grid, _ = with_walls(result.grid, result.confidence, edits.walls, poses)
        return Drawn(MapLayer(grid), graph_of(result), SE2.identity(), log, result, edits)

    @property
    def motion(self) -> SE2 | None:
        """That of the base during sweeps, where it is known."""
        return None if self.result is None else self.result.session.motion

    def with_walls(self, walls: tuple[WallEdit, ...]) -> Drawn:
        """With these walls instead."""
        if self.result is None or walls == self.edits.walls:
            return self
        again = Drawn.of(self.result, self.edits.model_copy(update={"walls": walls}))
        return replace(again, graph=self.graph)

    def wall(self, action: inputs.Wall) -> WallEdit:
        """A wall that is drawn or erased here, tied to the nearest key scan; InputError without a finished
        map."""
        if self.result is None:
            raise InputError(f"{action.do}: map the whole bag first")
        middle = np.mean(action.points, axis=0)
        key = int(np.linalg.norm(self.graph.graph.nodes[:, :2] - middle, axis=1).argmin())
        scan = int(self.graph.keys[key])
        x, y, yaw = self.result.trajectory.poses[scan].xyt.round(6).tolist()
        return WallEdit(
            do="draw" if action.do == "wall_draw" else "erase",
            points=tuple(action.points),
            width=action.width,
            scan=scan,
            pose=(x, y, yaw),
        )
