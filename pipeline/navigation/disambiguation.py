"""Active disambiguation: the robot drives to where a wall is that is not there under all pose hypotheses.

The path must be free under every hypothesis. If no reachable place distinguishes them, it roams without a
map. If it takes too long, the goal is given up with that reason: to report a goal as reached, or to drive
on, by the likelier hypothesis would be a guess.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
import scipy

from turtlebag.datasets.durations import nanoseconds
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.localisation.global_search import PATH_SLACK_M
from turtlebag.pipeline.localisation.pose_hypotheses import Aliasing, PoseHypotheses
from turtlebag.pipeline.navigation.goal_runner import GoalRunner, Tick, Tools
from turtlebag.pipeline.navigation.online_localiser import OnlineLocaliser
from turtlebag.planners.control.collision_monitor import PADDING_M
from turtlebag.planners.control.goal_checker import PASSING
from turtlebag.planners.costmap import Costmap, distance_field, ways_from
from turtlebag.planners.obstacle_layer import ObstacleLayer
from turtlebag.planners.tasks.frontier import SPENT_M

SEEN_M = 1.0
"""From so near a wall is seen. Three kidnapped robots in the arena are 26 s on these drives; with 1.5 m 33,
with 2.5 m 53."""


class Disambiguation:
    """One drive, from the first set of hypotheses until one of them is left."""

    def __init__(self, aliasing: Aliasing, poses: Sequence[SE2], tools: Tools, now_ns: int) -> None:
        both = passable_under_all(tools.obstacles.static, poses)
        self._walls = walls_of(tools.obstacles.static)
        self.tools = dataclasses.replace(
            tools, obstacles=ObstacleLayer(both, tools.obstacles.marking), checker=PASSING
        )
        """With a layer of what is seen on the way, over the map under all hypotheses."""
        self._aliasing = aliasing
        self._hypotheses = PoseHypotheses(poses)
        self._seed = tools.seed
        self.begin_again(now_ns)

    def begin_again(self, now_ns: int) -> None:
        """The time, and the places, for another goal."""
        self._began_ns = now_ns
        self._visited: list[Array] = []
        self._runner: GoalRunner | None = None
        self._in_vain: Array | None = None  # where there was no place to go to (2,)

    def rest(self) -> None:
        """A teleop override has ended."""
        self._runner = None

    def judge(self, localiser: OnlineLocaliser) -> SE2 | None:
        """Take in the scan that the filter has just used; the motion of the map to the one that is left."""
        assert localiser.T_map_odom is not None
        poses = self._hypotheses.poses
        fits = self._aliasing.fits(poses, localiser.keyframes[-1], localiser.T_map_odom)
        return self._hypotheses.judge(fits)

    def over(self, now_ns: int, most_s: float) -> bool:
        """Whether it has taken more than `most_s` seconds."""
        return now_ns - self._began_ns > nanoseconds(most_s)

    def command(self, tick: Tick) -> Twist | None:
        """The command of a tick; None where no place that distinguishes the hypotheses can be reached.

        Recovery manoeuvres do not help where the map under another hypothesis bars a free way.
        """
        here = tick.pose.xy
        if self._in_vain is not None and np.linalg.norm(here - self._in_vain) < SPENT_M:
            return None
        runner = self._runner or self._set_out(tick.pose)
        if runner is None:
            self._in_vain = here
            return None
        command, verdict = runner.step(tick)
        over = verdict is not None or runner.recovering
        if over:
            self._visited.append(runner.goal.xy)
        self._runner = None if over else runner
        self._in_vain = here if runner.recovering else None
        return None if runner.recovering else command

    def _set_out(self, pose: SE2) -> GoalRunner | None:
        """To the nearest place where the hypotheses differ; None when there is none."""
        floor, radius = self.tools.obstacles.static, self.tools.model.circumscribed_radius + PADDING_M
        poses = self._hypotheses.poses
        place = nearest_difference(self._walls, poses, floor, radius, pose, self._visited)
        if place is None:
            return None
        self._seed += 1
        return GoalRunner(self.tools, place, self._seed)


def passable_under_all(costmap: Costmap, hypotheses: Sequence[SE2]) -> Costmap:
    """The map on which a cell stops the robot if it does so under any of the hypotheses (T_map_map)."""
    lethal = costmap.lethal | (clearances(costmap, hypotheses) <= 0.0).any(axis=0)
    keepout = None
    if costmap.keepout is not None:
        keepout = lethal & ~passable_under_all(walls_of(costmap), hypotheses).lethal
    return Costmap(lethal, costmap.resolution, costmap.T_map_grid, keepout)


def walls_of(costmap: Costmap) -> Costmap:
    """The map without its keep-out areas, which no lidar sees."""
    if costmap.keepout is None:
        return costmap
    return Costmap(costmap.lethal & ~costmap.keepout, costmap.resolution, costmap.T_map_grid)


def clearances(costmap: Costmap, hypotheses: Sequence[SE2]) -> Array:
    """Clearance at each cell under each hypothesis [m], (n, rows, cols)."""
    rows, cols = costmap.lethal.shape
    col, row = np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5)
    centres = costmap.T_map_grid @ (np.stack([col, row], axis=-1) * costmap.resolution)
    return np.array([costmap.clearance_at(T_map_map @ centres) for T_map_map in hypotheses])


def nearest_difference(
    walls: Costmap,
    hypotheses: Sequence[SE2],
    floor: Costmap,
    radius: float,
    pose: SE2,
    visited: Sequence[Array],
) -> SE2 | None:
    """The pose nearest along the `floor` from which a wall is seen that there is not under all hypotheses.

    It is not there with as much room as the likelihood of a scan tells ranges apart by.

    Only places that a disc of `radius` reaches count, and none about those `visited`.
    """
    ways = ways_from(floor, pose, radius)
    under = clearances(walls, hypotheses)
    differs = (under.min(axis=0) <= 0.0) & (under.max(axis=0) > PATH_SLACK_M)
    if ways is None or not differs.any():
        return None
    near = distance_field(differs, floor.resolution) <= SEEN_M
    # Only over floor of all hypotheses, by four neighbours: a wall of all hides what differs behind it.
    steps = math.ceil(math.sqrt(2.0) * SEEN_M / floor.resolution)
    near &= scipy.ndimage.binary_dilation(differs, iterations=steps, mask=under.min(axis=0) > 0.0)
    cells = np.argwhere(np.isfinite(ways) & near)
    xy = floor.T_map_grid @ np.asarray((cells[:, ::-1] + 0.5) * floor.resolution, dtype=np.float64)
    for seen in visited:
        keep = np.linalg.norm(xy - seen, axis=1) > SPENT_M
        cells, xy = cells[keep], xy[keep]
    if len(cells) == 0:
        return None
    x, y = xy[ways[cells[:, 0], cells[:, 1]].argmin()]
    return SE2.from_xyt(x, y, float(pose.yaw))
