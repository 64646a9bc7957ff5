"""The checks of parts: ours pass them, and each way to break a contract is told in one line."""

from dataclasses import replace

import numpy as np
import pytest

from turtlebag import testing
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.localisation.amcl import Amcl
from turtlebag.pipeline.navigation.driver import Driver
from turtlebag.pipeline.navigation.drivers import make_avoider
from turtlebag.pipeline.slam.front_end import Placed
from turtlebag.pipeline.slam.front_ends import FRONT_ENDS
from turtlebag.pipeline.slam.loop_search import MATCHERS
from turtlebag.pipeline.slam.open3d_icp import Open3dMatch
from turtlebag.pipeline.slam.pose_graph import Gtsam
from turtlebag.pipeline.slam.wheels import Wheels
from turtlebag.planners.control.dwa import Dwa, DwaConfig
from turtlebag.planners.control.pursuit import Pursuit
from turtlebag.planners.global_plan import OmplPlanner
from turtlebag.planners.planner import NoPath
from turtlebag.sim.worlds import load_world

pytestmark = pytest.mark.slow


class Named:
    """Our worlds by their names."""

    def __init__(self, options):
        self.options = options

    def world(self):
        return load_world(self.options)


@pytest.mark.parametrize("name", FRONT_ENDS)
def test_our_front_ends_keep_the_contract(name):
    testing.check_front_end(FRONT_ENDS[name], without_odometry=name == "lines")


@pytest.mark.parametrize("name", MATCHERS)
def test_our_loop_matchers_keep_the_contract(name):
    testing.check_loop_match(MATCHERS[name])


@pytest.mark.parametrize(
    "check",
    [
        lambda: testing.check_back_end(Gtsam),
        lambda: testing.check_localiser(Amcl),
        lambda: testing.check_planner(OmplPlanner),
        lambda: testing.check_controller(Pursuit),
        lambda: testing.check_controller(lambda model, period: Dwa(model, DwaConfig(), period)),
        lambda: testing.check_task(lambda kit, mission: make_avoider(kit, 60.0, lambda line: None)),
        lambda: testing.check_world(Named, "turtlebot3_world"),
        lambda: testing.check_world(Named, "maze:3"),
    ],
    ids=["back end", "localiser", "planner", "pursuit", "dwa", "task", "world", "maze"],
)
def test_our_other_parts_keep_their_contracts(check):
    check()


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
        return Placed(self._course.pose, np.zeros((3, 3)), 1.0)


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
    def __init__(self, course):
        pass


class Anywhere(Open3dMatch):
    def match(self, clouds, query, place, start, limits):
        found = super().match(clouds, query, place, start, limits)
        return replace(found, overlap=0.9, T_map_base=SE2(start))


class Everywhere(Open3dMatch):
    def match(self, clouds, query, place, start, limits):
        return replace(super().match(clouds, query, place, start, limits), overlap=0.9)


class Denies(Open3dMatch):
    def confirms(self, clouds, query, place, pose):
        return False


class Mumbles(Open3dMatch):
    def confirms(self, clouds, query, place, pose):
        return "no"


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
    pushes = None


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


def front_end(part):
    testing.check_front_end(part, without_odometry=False)


def world(part):
    testing.check_world(part, "")


@pytest.mark.parametrize(
    ("check", "part", "said"),
    [
        (front_end, Crooked, "step: T_track_base must be an array of shape (3,), not an array of shape (2,)"),
        (front_end, Changes, "must not change the points, odometry or stamps"),
        (front_end, Chance, "the same log must give the same bytes"),
        (front_end, Stays, "with odometry: off by up to 3."),
        (front_end, Boasts, "a scan without points saw nothing: its information must be zero"),
        (front_end, Negative, "the information must not be negative in any direction"),
        (front_end, Unsure, "it must be sure of its poses where scans fit (Placed.sure)"),
        (
            front_end,
            NoStep,
            "has no method step; the contract is FrontEnd.step(points, odometry_step, wait_s)",
        ),
        (testing.check_loop_match, Anywhere, "off from a near start"),
        (testing.check_loop_match, Everywhere, "where nothing is seen overlap and information must be zero"),
        (testing.check_loop_match, Denies, "confirms: must be true for the true pose"),
        (testing.check_back_end, Idle, "steps and loops that agree: 0."),
        (testing.check_back_end, Gullible, "a loop that lies, under a Cauchy kernel"),
        (testing.check_back_end, Floats, "the first pose must be held"),
        (testing.check_back_end, Fewer, "optimise: poses must be an array of shape (30, 3)"),
        (testing.check_localiser, Deaf, "not known after a scan: the filter has no pose yet"),
        (testing.check_localiser, Silent, "update: must return whether the scan was used"),
        (testing.check_planner, Through, "plan: the footprint touches something at pose"),
        (testing.check_planner, Hopeful, "must raise NoPath with a reason where the goal is walled in"),
        (testing.check_controller, Jerks, "is more than the robot can do in"),
        (testing.check_controller, Rolls, "brake: must come to a standstill within 5 s"),
        (testing.check_task, Rammer, "is beyond the robot's limits"),
        (testing.check_task, Stateless, "has no state, which a Task has"),
        (world, Tight, "there must be room for the robot where it starts"),
        (world, Small, "bounds must hold all shapes"),
        (world, Numbers, "shape must be a Solid, not a int"),
        (world, Nameless, "name must be a str, not None"),
        (world, Lost, "keepout or route must be an array of shape (2, 2), not a list"),
        (front_end, TooMuch, "step: overlap is 7, it must be 0 to 1"),
        (front_end, Ahead, "step: revised must be scans before this one"),
        (front_end, Backwards, "step: revised must be scans before this one"),
        (front_end, NoPairs, "step: revised must be scans before this one"),
        (front_end, Perhaps, "step: sure must be a bool, not an array of shape (2,)"),
        (front_end, Sources, "step: source must be 0 to 3"),
        (testing.check_loop_match, Mumbles, "confirms: must be true for the true pose"),
        (testing.check_localiser, Boastful, "agreement must be a share 0..1, not 7"),
        (testing.check_localiser, Empty, "particles must be poses (n,), one at least"),
        (testing.check_localiser, Torn, "lost must be a bool, not None"),
        (testing.check_localiser, Uncounted, "pushes must be a int, not None"),
        (testing.check_planner, Shorter, "length is below 0"),
        (testing.check_task, Mute, "state must be a str, not None"),
        (testing.check_task, Unfinished, "finished must be a bool, not None"),
        (testing.check_task, Goals, "goal_index must be a int, not a str"),
        (testing.check_task, Somewhere, "estimate must be a SE2, not an array of shape (3,)"),
        (testing.check_task, Blind, "its sensing must be shown every observation"),
        (testing.check_task, Silly, "step: must return a Twist, not None"),
    ],
    ids=lambda value: value.__name__ if isinstance(value, type) else "",
)
def test_a_broken_contract_is_told_in_one_line(check, part, said):
    with pytest.raises(AssertionError) as error:
        check(part)
    assert said in str(error.value)
    assert f":{part.__name__}: " in str(error.value)
    assert "\n" not in str(error.value)


def test_what_is_no_class_and_a_robot_that_is_none_are_told_too():
    with pytest.raises(AssertionError, match="3: give a class, or a function that makes a FrontEnd"):
        testing.check_front_end(3)
    with pytest.raises(AssertionError, match="unknown robot 'nobody'"):
        testing.check_world(Strange, "")


class Reuses(Wheels):
    """Writes each pose into the same array."""

    def __init__(self, course):
        super().__init__(course)
        self._pose = np.zeros(3)

    def step(self, points, odometry_step, wait_s):
        placed = super().step(points, odometry_step, wait_s)
        self._pose[:] = placed.T_track_base
        return replace(placed, T_track_base=self._pose)


def test_a_front_end_may_go_on_with_the_array_that_it_returned():
    front_end(Reuses)
