"""The checks of parts: ours pass, and each way to break a contract is one row of a table and one line."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from turtlebag import testing
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.localisation.amcl import Amcl
from turtlebag.pipeline.navigation.driver import Driver
from turtlebag.pipeline.navigation.drivers import make_avoider
from turtlebag.pipeline.slam.graph.pose_graph import Gtsam
from turtlebag.pipeline.slam.loops.matchers import MATCHERS, Open3dMatch
from turtlebag.pipeline.slam.odometry.front_end import Placed
from turtlebag.pipeline.slam.odometry.front_ends import FRONT_ENDS
from turtlebag.pipeline.slam.odometry.wheels import Wheels
from turtlebag.planners.control.dwa import Dwa, DwaConfig
from turtlebag.planners.control.pursuit import Pursuit
from turtlebag.planners.global_plan import OmplPlanner
from turtlebag.planners.planner import NoPath
from turtlebag.sim.worlds import load_world

pytestmark = pytest.mark.slow


class Named:
    """A world part: ours by their names."""

    def __init__(self, options):
        self.options = options

    def world(self):
        return load_world(self.options)


class Stands(Driver):
    """A task that stands still."""

    def __init__(self, kit, mission):
        super().__init__(kit.sensing)

    def step(self, observation):
        self.stand_by(observation)
        return Twist()

    def stand_by(self, observation):
        self.sensing.observe(observation)


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


def other(base, method, change, **members):
    """A part like `base`, except that `change` makes something else of what a method returns, given its
    arguments; a dict is of attributes of the result. `members` are attributes of the class."""

    def answer(self, *given):
        found = getattr(base, method)(self, *given)
        return replace(found, **change) if isinstance(change, dict) else change(found, *given)

    return type("Broken", (base,), {"__module__": __name__, method: answer, **members})


front_end = partial(testing.check_front_end, without_odometry=False)
step = partial(other, Wheels, "step")
match = partial(other, Open3dMatch, "match")
optimise = partial(other, Gtsam, "optimise")
localiser = partial(other, Amcl, "update", lambda used, *_: used)
plan = partial(other, OmplPlanner, "plan")
command = partial(other, Pursuit, "command")


def drive(change=lambda command, *_: command, stand_by=Stands.stand_by, **said):
    def stepped(self, observation):
        for what, value in said.items():
            setattr(self, what, value)
        return change(Stands.step(self, observation))

    return type("Broken", (Stands,), {"__module__": __name__, "step": stepped, "stand_by": stand_by})


def world(**changes):
    changed = replace(load_world("turtlebot3_world"), **changes)
    return type("Broken", (Named,), {"__module__": __name__, "world": lambda self: changed})


def changed_points(placed, points, *_):
    points += 1e-9
    return placed


def straight(found, costmap, model, start, goal, seed):
    share = np.linspace(0.0, 1.0, 40)[:, None]
    return replace(found, poses=SE2((1.0 - share) * start.xyt + share * goal.xyt))


class Hopeful(OmplPlanner):
    """It says nothing of a goal that is walled in."""

    def plan(self, *given):
        try:
            return super().plan(*given)
        except NoPath:
            raise NoPath("") from None


class Gullible(Gtsam):
    """It trusts wrong loops."""

    def optimise(self, T_map_keys, constraints, iterations=30):
        return super().optimise(T_map_keys, [replace(c, cauchy=0.0) for c in constraints], iterations)


BROKEN = [
    (
        front_end,
        step({"T_track_base": np.zeros(2)}),
        "step: T_track_base must be an array of shape (3,), not an array of shape (2,)",
    ),
    (front_end, step({"T_track_base": np.full(3, np.nan)}), "step: T_track_base is not finite"),
    (front_end, step(lambda *_: None), "step: must return a Placed, not None"),
    (front_end, step(changed_points), "must not change the points, odometry or stamps"),
    (
        front_end,
        step(lambda placed, *_: replace(placed, rmse=float(np.random.default_rng().random()))),
        "the same log must give the same bytes",
    ),
    (
        front_end,
        step(lambda *_: Placed(np.zeros(3), np.zeros((3, 3)), 1.0)),
        "odometry: off by up to 3.",
    ),
    (front_end, step({"information": np.eye(3)}), "saw nothing: its information must be zero"),
    (front_end, step({"information": -np.eye(3)}), "information must not be negative in any direction"),
    (front_end, step({"sure": False}), "it must be sure of its poses where scans fit (Placed.sure)"),
    (front_end, step({"sure": np.array([True, False])}), "sure must be a bool, not an array of shape (2,)"),
    (front_end, step({"overlap": 7.0}), "step: overlap is 7, it must be 0 to 1"),
    (front_end, step({"source": 9}), "step: source must be 0 to 4"),
    (front_end, step({"revised": ((99, np.zeros(3)),)}), "step: revised must be scans before this one"),
    (front_end, step({"revised": ((-1, np.zeros(3)),)}), "step: revised must be scans before this one"),
    (front_end, step({"revised": (3,)}), "step: revised must be scans before this one"),
    (
        front_end,
        type("Broken", (), {"__module__": __name__, "__init__": lambda self, tracker: None}),
        "has no method step; the contract is FrontEnd.step(points, odometry_step, wait_s)",
    ),
    (
        testing.check_loop_match,
        match(lambda found, *given: replace(found, overlap=0.9, T_map_base=SE2(given[3]))),
        "match: from a near start: off by up to",
    ),
    (testing.check_loop_match, match({"overlap": 0.9}), "where nothing is seen overlap and information must"),
    (testing.check_back_end, optimise(lambda found, start, *_: start), "steps and loops that agree: 0."),
    (testing.check_back_end, Gullible, "a wrong loop under a Cauchy kernel"),
    (
        testing.check_back_end,
        optimise(lambda found, *_: SE2.from_xyt(0.3, 0.0, 0.0) @ found),
        "the first pose must be held",
    ),
    (
        testing.check_back_end,
        optimise(lambda found, *_: found[:-1]),
        "optimise: poses must be an array of shape (30, 3)",
    ),
    (testing.check_localiser, localiser(update=lambda self, *_: False), "has no pose yet"),
    (
        testing.check_localiser,
        other(Amcl, "update", lambda *_: None),
        "update: whether the scan was used must be a bool, not None",
    ),
    (testing.check_localiser, localiser(agreement=7.0), "agreement must be a share 0..1, not 7"),
    (testing.check_localiser, localiser(agreement=-0.01), "agreement must be a share 0..1, not -0.01"),
    (testing.check_localiser, localiser(particles=SE2.identity(0)), "particles must be poses (n,), at least"),
    (testing.check_localiser, localiser(lost=None), "lost must be a bool, not None"),
    (testing.check_localiser, localiser(covariance=np.full((3, 3), np.nan)), "covariance is not finite"),
    (
        testing.check_localiser,
        localiser(searches=property(lambda self: None, lambda self, count: None)),
        "searches must be an int, not None",
    ),
    (testing.check_planner, plan(straight), "plan: the footprint touches something at pose"),
    (testing.check_planner, plan({"length": -1.0}), "plan: length -1.00 m of a path of"),
    (
        testing.check_planner,
        plan(lambda found, *_: replace(found, poses=found.poses[:1])),
        "at least two",
    ),
    (testing.check_planner, Hopeful, "must raise NoPath with a reason where the goal is walled in"),
    (testing.check_controller, command(lambda *_: Twist(0.2, 0.0)), "is more than the robot can do in"),
    (testing.check_controller, command(lambda *_: Twist(np.nan, 0.0)), "command: v is not finite"),
    (
        testing.check_controller,
        command(lambda found, *_: found, brake=lambda self, last: last),
        "brake: must come to a standstill within 5 s",
    ),
    (testing.check_task, drive(lambda _: Twist(9.0, 0.0)), "is beyond the robot's limits"),
    (
        testing.check_task,
        type("Broken", (Stands,), {"__module__": __name__, "__init__": lambda self, kit, mission: None}),
        "has no sensing, which Task requires",
    ),
    (testing.check_task, drive(state=None), "state must be a str, not None"),
    (testing.check_task, drive(finished=None), "finished must be a bool, not None"),
    (testing.check_task, drive(goal_index="first"), "goal_index must be an int, not a str"),
    (testing.check_task, drive(estimate=np.zeros(3)), "estimate must be a SE2, not an array of shape (3,)"),
    (testing.check_task, drive(stand_by=lambda *_: None), "its sensing must get every observation"),
    (testing.check_task, drive(lambda _: None), "step: must return a Twist, not None"),
    (testing.check_world, world(spawn=SE2.identity()), "must be room for the robot where it starts"),
    (testing.check_world, world(bounds=(-1.0, 1.0, -1.0, 1.0)), "bounds must hold all shapes"),
    (testing.check_world, world(shapes=(1, 2)), "shape must be a Solid, not an int"),
    (testing.check_world, world(shapes=()), "needs at least one shape"),
    (testing.check_world, world(name=None), "name must be a str, not None"),
    (
        testing.check_world,
        world(routes={"there": [1.0, 2.0]}),
        "keepout or route must be an array of",
    ),
]


@pytest.mark.parametrize(("check", "part", "said"), BROKEN, ids=[said for *_, said in BROKEN])
def test_a_broken_contract_is_told_in_one_line(check, part, said):
    with pytest.raises(AssertionError) as error:
        check(part)
    assert said in str(error.value)
    assert str(error.value).startswith(f"{__name__}:{part.__name__}: ")
    assert "\n" not in str(error.value)


def test_what_is_no_class_and_a_robot_that_is_none_are_told_too():
    with pytest.raises(AssertionError, match="3: give a class, or a function that makes a FrontEnd"):
        testing.check_front_end(3)
    with pytest.raises(AssertionError, match="unknown robot 'nobody'"):
        testing.check_world(world(robot="nobody"))


class Reuses(Wheels):
    """Writes each pose into the same array."""

    def step(self, points, odometry_step, wait_s):
        placed = super().step(points, odometry_step, wait_s)
        self.pose = getattr(self, "pose", np.zeros(3))
        self.pose[:] = placed.T_track_base
        return replace(placed, T_track_base=self.pose)


def test_a_front_end_may_go_on_with_the_array_that_it_returned():
    front_end(Reuses)
