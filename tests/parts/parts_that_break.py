"""Parts that each break their contract in one way, and one that only looks as if it did."""

from dataclasses import replace

import numpy as np

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.localisation.amcl import Amcl
from turtlebag.pipeline.navigation.driver import Driver
from turtlebag.pipeline.slam.front_end import Placed
from turtlebag.pipeline.slam.open3d_icp import Open3dMatch
from turtlebag.pipeline.slam.pose_graph import Gtsam
from turtlebag.pipeline.slam.wheel_odometry import Wheels
from turtlebag.planners.control.pursuit import Pursuit
from turtlebag.planners.global_plan import OmplPlanner
from turtlebag.planners.planner import NoPath
from turtlebag.sim.worlds import load_world


class Named:
    """Our worlds by their names."""

    def __init__(self, options):
        self.options = options

    def world(self):
        return load_world(self.options)


class Crooked(Wheels):
    def step(self, points, odometry_step, wait_s):
        return Placed(np.zeros(2), np.zeros((3, 3)), 1.0)


class Changes(Wheels):
    def step(self, points, odometry_step, wait_s):
        placed = super().step(points, odometry_step, wait_s)
        points += 1e-9
        return placed


class Chance(Wheels):
    def step(self, points, odometry_step, wait_s):
        placed = super().step(points, odometry_step, wait_s)
        return replace(placed, rmse=float(np.random.default_rng().random()))


class Stays(Wheels):
    def step(self, points, odometry_step, wait_s):
        return Placed(self._tracker.pose, np.zeros((3, 3)), 1.0)


class Boasts(Wheels):
    def step(self, points, odometry_step, wait_s):
        return replace(super().step(points, odometry_step, wait_s), information=np.eye(3))


class Negative(Wheels):
    def step(self, points, odometry_step, wait_s):
        return replace(super().step(points, odometry_step, wait_s), information=-np.eye(3))


class Unsure(Wheels):
    def step(self, points, odometry_step, wait_s):
        return replace(super().step(points, odometry_step, wait_s), sure=False)


class Sees(Wheels):
    """Says something else of each scan than the wheels do."""

    def __init_subclass__(cls, **said):
        cls.said = said

    def step(self, points, odometry_step, wait_s):
        return replace(super().step(points, odometry_step, wait_s), **self.said)


class TooMuch(Sees, overlap=7.0):
    pass


class Ahead(Sees, revised=((99, np.zeros(3)),)):
    pass


class Backwards(Sees, revised=((-1, np.zeros(3)),)):
    pass


class NoPairs(Sees, revised=(3,)):
    pass


class Perhaps(Sees, sure=np.array([True, False])):
    pass


class Sources(Sees, source=np.zeros(3)):
    pass


class NoStep:
    def __init__(self, tracker):
        pass


class Anywhere(Open3dMatch):
    def match(self, clouds, query, place, start, limits):
        found = super().match(clouds, query, place, start, limits)
        return replace(found, overlap=0.9, T_map_base=SE2(start))


class Everywhere(Open3dMatch):
    def match(self, clouds, query, place, start, limits):
        return replace(super().match(clouds, query, place, start, limits), overlap=0.9)


class Idle(Gtsam):
    def optimise(self, T_map_keys, constraints, iterations=30):
        return T_map_keys


class Gullible(Gtsam):
    def optimise(self, T_map_keys, constraints, iterations=30):
        return super().optimise(T_map_keys, [replace(c, cauchy=0.0) for c in constraints], iterations)


class Floats(Gtsam):
    def optimise(self, T_map_keys, constraints, iterations=30):
        return SE2.from_xyt(0.3, 0.0, 0.0) @ super().optimise(T_map_keys, constraints, iterations)


class Fewer(Gtsam):
    def optimise(self, T_map_keys, constraints, iterations=30):
        return super().optimise(T_map_keys, constraints, iterations)[:-1]


class Deaf(Amcl):
    def update(self, scan, T_odom_base, T_odom_base_end=None):
        return False


class Silent(Amcl):
    def update(self, scan, T_odom_base, T_odom_base_end=None):
        super().update(scan, T_odom_base, T_odom_base_end)


class Boastful(Amcl):
    agreement = 7.0


class Empty(Amcl):
    particles = SE2.identity(0)


class Torn(Amcl):
    lost = None


class Uncounted(Amcl):
    searches = property(lambda self: None, lambda self, count: None)


class Shorter(OmplPlanner):
    def plan(self, costmap, model, T_map_start, T_map_goal, seed):
        return replace(super().plan(costmap, model, T_map_start, T_map_goal, seed), length=-1.0)


class Through(OmplPlanner):
    def plan(self, costmap, model, T_map_start, T_map_goal, seed):
        found = super().plan(costmap, model, T_map_start, T_map_goal, seed)
        share = np.linspace(0.0, 1.0, 40)[:, None]
        ends = (1.0 - share) * T_map_start.xyt + share * T_map_goal.xyt
        return replace(found, poses=SE2(ends))


class Hopeful(OmplPlanner):
    def plan(self, costmap, model, T_map_start, T_map_goal, seed):
        try:
            self.found = super().plan(costmap, model, T_map_start, T_map_goal, seed)
        except NoPath:
            raise NoPath("") from None
        return self.found


class Jerks(Pursuit):
    def __init__(self, model, period):
        super().__init__(model, period)

    def command(self, pose, last, costmap):
        return Twist(0.2, 0.0)


class Rolls(Jerks):
    def command(self, pose, last, costmap):
        return Pursuit.command(self, pose, last, costmap)

    def brake(self, last):
        return last


class Rammer:
    """A task that drives on whatever stands there."""

    def __init__(self, kit, mission):
        self.sensing, self.state, self.goal_index, self.finished = kit.sensing, "ram", -1, False
        self.estimate = None

    def step(self, observation):
        self.sensing.observe(observation)
        return Twist(9.0, 0.0)

    def stand_by(self, observation):
        pass

    def resume(self, last):
        pass


class Stateless(Rammer):
    def __init__(self, kit, mission):
        self.sensing = kit.sensing


class Stands(Driver):
    """A task that stands still for a while, and says something of itself."""

    def __init_subclass__(cls, **said):
        cls.said = said

    def __init__(self, kit, mission):
        super().__init__(kit.sensing)

    def step(self, observation):
        self.stand_by(observation)
        for what, value in self.said.items():
            setattr(self, what, value)
        return Twist()

    def stand_by(self, observation):
        self.sensing.observe(observation)


class Mute(Stands, state=None):
    pass


class Unfinished(Stands, finished=None):
    pass


class Goals(Stands, goal_index="first"):
    pass


class Somewhere(Stands, estimate=np.zeros(3)):
    pass


class Blind(Stands):
    def stand_by(self, observation):
        pass


class Silly(Stands):
    def step(self, observation):
        super().step(observation)


class Strange(Named):
    def world(self):
        return replace(load_world("turtlebot3_world"), robot="nobody")


class Numbers(Named):
    def world(self):
        return replace(load_world("turtlebot3_world"), shapes=(1, 2))


class Nameless(Named):
    def world(self):
        return replace(load_world("turtlebot3_world"), name=None)


class Lost(Named):
    def world(self):
        return replace(load_world("turtlebot3_world"), routes={"there": [1.0, 2.0]})


class Tight(Named):
    def world(self):
        return replace(load_world("turtlebot3_world"), spawn=SE2.identity())


class Small(Named):
    def world(self):
        return replace(load_world("turtlebot3_world"), bounds=(-1.0, 1.0, -1.0, 1.0))


class Reuses(Wheels):
    """Writes each pose into the same array."""

    def __init__(self, tracker):
        super().__init__(tracker)
        self._pose = np.zeros(3)

    def step(self, points, odometry_step, wait_s):
        placed = super().step(points, odometry_step, wait_s)
        self._pose[:] = placed.T_track_base
        return replace(placed, T_track_base=self._pose)
