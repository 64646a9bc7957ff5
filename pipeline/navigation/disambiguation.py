"""Two places look alike: the robot drives to where they would not, and believes what it sees there.

The drive is free under every hypothesis: what stops the robot at one of them, stops it. Where nothing
that can be reached tells them apart, or it takes too long, it says so and gives the goal up: to call a
goal reached, or to drive on, by the likelier one would be a guess that nobody could tell from knowledge.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Observation, Twist
from turtlebag.pipeline.localisation.pose_hypotheses import Contest, Rivals
from turtlebag.pipeline.navigation.goal_runner import GoalRunner, Tools
from turtlebag.pipeline.navigation.localiser import Localiser
from turtlebag.planners.control.goal_checker import GoalCheckerConfig
from turtlebag.planners.costmap import Costmap, Mask
from turtlebag.planners.live import LiveLayer
from turtlebag.planners.wavefront import wave

ALIKE = "two places on the map look alike, and no view was found that tells them apart"
# Rivals differ clearly where so large a share of the beams does; a place that did not help must be
# bettered by so much, and is not gone to again.
DIFFERENT, MORE, AGAIN_M = 0.1, 1.3, 0.6
# Places looked at are so far apart, and have this much room beside the robot's radius, better the first:
# beside a thing a view changes with every centimetre.
SPACING_M, ROOMS_M = 0.15, (0.15, 0.05)
# Filter updates in a row without a doubt after which the robot is sure of where it is, and how far [m, rad]
# from there it must find itself after a doubt to ask whether it is not in yet another place.
SURE, MOVED_M, MOVED_RAD = 10, 0.25, 0.25
PASSING = GoalCheckerConfig(xy_goal_tolerance=0.12, yaw_goal_tolerance=math.pi, stop=False, hold=0.0)
COVARIANCE = np.diag([0.05, 0.05, 0.05]) ** 2


class Telling:
    """Watches for rivals after a search, and drives until one is left; `contest` is None without."""

    def __init__(
        self,
        rivals: Rivals,
        tools: Tools,
        most_s: float,
        seed: int,
        publish_plan: Callable[[SE2], None],
    ) -> None:
        self.contest: Contest | None = None
        self._rivals, self._tools, self._most_ns = rivals, tools, round(most_s * 1e9)
        self._seed, self._publish_plan = seed, publish_plan
        self._examined = self._began_ns = self._updates = 0
        self._sure, self._sure_of, self._doubted = 0, SE2.identity(), False
        self._threshold = DIFFERENT
        self._visited: list[Array] = []
        self._runner: GoalRunner | None = None
        self._both = tools

    @property
    def live(self) -> LiveLayer:
        """The layer of what is seen on the way, over the map under all rivals."""
        return self._both.live

    def examine(self, now_ns: int, localiser: Localiser) -> bool:
        """Whether the estimate, found by a search, has rivals; it is moved to a clearly better one."""
        T_map_odom, glimpses = localiser.T_map_odom, localiser.glimpses
        if self.contest is not None or T_map_odom is None or not glimpses or localiser.amcl.lost:
            return self.contest is not None
        if self._doubtful(localiser, T_map_odom @ glimpses[-1].T_odom_base):
            found = self._rivals.find(glimpses, T_map_odom)
            if len(found) > 1:
                self._enter(found, now_ns, localiser)
            else:
                self._settle(found[0], localiser)
        elif localiser.updates > self._updates:
            self._sure, self._sure_of, self._updates = self._sure + 1, T_map_odom, localiser.updates
        return self.contest is not None

    def _doubtful(self, localiser: Localiser, T_map_base: SE2) -> bool:
        """Whether the estimate comes from a search over the map, or is not where the robot was sure to be.

        A robot that was never sure yet is told a pose and corrects it: whoever told it knows the place.
        """
        asked = localiser.searches == self._examined
        self._examined = localiser.searches
        if self._doubted and self._sure >= SURE and asked:
            x, y, yaw = (T_map_base.inverse() @ self._sure_of @ localiser.glimpses[-1].T_odom_base).xyt
            asked = bool(np.hypot(x, y) < MOVED_M and abs(yaw) < MOVED_RAD)
        if self._doubted:
            self._doubted, self._sure = False, 0
        return not asked

    def doubt(self) -> None:
        """The robot is lost: where it finds itself will be asked about, what was found before is void."""
        self._doubted = True
        if self.contest is not None:
            self.contest, self._runner, self._examined = None, None, -1

    def rest(self) -> None:
        """Someone else has driven meanwhile."""
        self._runner = None

    def begin_again(self, now_ns: int) -> None:
        """The time, and the places, for another goal."""
        self._began_ns, self._threshold, self._visited, self._runner = now_ns, DIFFERENT, [], None

    def step(
        self,
        observation: Observation,
        localiser: Localiser,
        last: Twist,
        points_base: Array,
        new_sweep: bool,
        moving_base: Array,
    ) -> Twist | None:
        """The command of a tick; None when nothing more can be done. See `contest` for what is left."""
        now, T_map_odom = observation.stamp_ns, localiser.T_map_odom
        if self.contest is None or T_map_odom is None:
            return None
        if localiser.updates > self._updates:
            self._updates = localiser.updates
            self.contest.judge(self._rivals.fits(self.contest.rivals, localiser.glimpses[-1], T_map_odom))
            if self.contest.decided:
                self._settle(self.contest.rivals[0], localiser)
                return self._tools.controller.brake(last)
        if now - self._began_ns > self._most_ns:
            return None
        pose = T_map_odom @ observation.odometry.T_odom_base
        if self._runner is None and not self._set_out(pose):
            return None
        assert self._runner is not None
        twist = observation.odometry.twist
        command, verdict = self._runner.step(now, pose, twist, last, points_base, new_sweep, moving_base)
        if verdict is not None:
            self._visited.append(self._runner.goal.xy)
            self._runner = None
        return command

    def _enter(self, rivals: Sequence[SE2], now_ns: int, localiser: Localiser) -> None:
        self.contest, self._updates = Contest(rivals), localiser.updates
        both = passable_under_all(self._tools.live.static, rivals)
        live = LiveLayer(both, self._tools.live.config)
        self._both = dataclasses.replace(self._tools, live=live, checker=PASSING)
        self.begin_again(now_ns)

    def _settle(self, rival: SE2, localiser: Localiser) -> None:
        """One is left: the estimate is moved there if it is not there."""
        self.contest, self._runner = None, None
        if not np.allclose(rival.xyt, 0.0):
            localiser.move(rival, COVARIANCE)

    def _set_out(self, pose: SE2) -> bool:
        """Go to the nearest place where two of the rivals differ clearly; whether there is one."""
        assert self.contest is not None
        radius, rivals = self._both.model.circumscribed_radius, self.contest.rivals
        for room in ROOMS_M:
            place = nearest_difference(
                self._rivals,
                rivals,
                self._both.live.static,
                radius + room,
                pose,
                self._threshold,
                self._visited,
            )
            if place is not None:
                break
        else:
            return False
        self._threshold = MORE * place[1]
        self._seed += 1
        self._runner = GoalRunner(self._both, place[0], self._seed, self._publish_plan)
        return True


def passable_under_all(costmap: Costmap, rivals: Sequence[SE2]) -> Costmap:
    """The map on which a cell stops the robot if it does so under any of the rivals (T_map_map)."""
    rows, cols = costmap.lethal.shape
    col, row = np.meshgrid(np.arange(cols) + 0.5, np.arange(rows) + 0.5)
    centres = costmap.T_map_grid @ (np.stack([col, row], axis=-1) * costmap.resolution)
    lethal = costmap.lethal.copy()
    for rival in rivals:
        lethal |= costmap.clearance_at(rival @ centres) <= 0.0
    return Costmap(lethal, costmap.resolution, costmap.T_map_grid)


def nearest_difference(
    comparison: Rivals,
    rivals: Sequence[SE2],
    costmap: Costmap,
    radius: float,
    pose: SE2,
    least: float,
    visited: Sequence[Array],
) -> tuple[SE2, float] | None:
    """The pose nearest along the floor where two rivals differ by `least` or more, and by how much.

    Only places that a disc of `radius` reaches count, and none about those `visited`.
    """
    free = costmap.clearance > radius
    start = _cell_near(free, costmap, pose)
    if start is None:
        return None
    way = wave(free, start[0], start[1], np.inf)
    step = max(1, round(SPACING_M / costmap.resolution))
    cells = np.argwhere(np.isfinite(way))
    cells = cells[(cells[:, 0] % step == 0) & (cells[:, 1] % step == 0)]
    xy = costmap.T_map_grid @ ((cells[:, ::-1] + 0.5) * costmap.resolution)
    for seen in visited:
        keep = np.linalg.norm(xy - seen, axis=1) > AGAIN_M
        cells, xy = cells[keep], xy[keep]
    if len(cells) == 0:
        return None
    poses = SE2(np.column_stack([xy, np.full(len(xy), float(pose.yaw))]))
    share = comparison.differences(rivals, poses)
    length = np.where(share >= least, way[cells[:, 0], cells[:, 1]], np.inf)
    best = int(length.argmin())
    return (poses[best], float(share[best])) if np.isfinite(length[best]) else None


def _cell_near(free: Mask, costmap: Costmap, pose: SE2) -> tuple[int, int] | None:
    """The free cell nearest to a pose, at most half a metre away."""
    cells = np.argwhere(free)
    if len(cells) == 0:
        return None
    at = (costmap.T_grid_map @ pose.xy)[::-1] / costmap.resolution
    gap = np.linalg.norm(cells + 0.5 - at, axis=1)
    near = int(gap.argmin())
    return (int(cells[near, 0]), int(cells[near, 1])) if gap[near] * costmap.resolution < 0.5 else None
