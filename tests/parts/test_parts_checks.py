"""The checks of parts: ours pass, and each way to break a contract gives one line."""

import pytest

from tests.parts import parts_that_break as parts
from turtlebag import testing
from turtlebag.pipeline.localisation.amcl import Amcl
from turtlebag.pipeline.navigation.drivers import make_avoider
from turtlebag.pipeline.slam.front_ends import FRONT_ENDS
from turtlebag.pipeline.slam.loop_search import MATCHERS
from turtlebag.pipeline.slam.pose_graph import Gtsam
from turtlebag.planners.control.dwa import Dwa, DwaConfig
from turtlebag.planners.control.pursuit import Pursuit
from turtlebag.planners.global_plan import OmplPlanner

pytestmark = pytest.mark.slow


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
        lambda: testing.check_world(parts.Named, "turtlebot3_world"),
        lambda: testing.check_world(parts.Named, "maze:3"),
    ],
    ids=["back end", "localiser", "planner", "pursuit", "dwa", "task", "world", "maze"],
)
def test_our_other_parts_keep_their_contracts(check):
    check()


def front_end(part):
    testing.check_front_end(part, without_odometry=False)


def world(part):
    testing.check_world(part, "")


@pytest.mark.parametrize(
    ("check", "part", "said"),
    [
        (
            front_end,
            parts.Crooked,
            "step: T_track_base must be an array of shape (3,), not an array of shape (2,)",
        ),
        (front_end, parts.Changes, "must not change the points, odometry or stamps"),
        (front_end, parts.Chance, "the same log must give the same bytes"),
        (front_end, parts.Stays, "with odometry: off by up to 3."),
        (front_end, parts.Boasts, "a scan without points saw nothing: its information must be zero"),
        (front_end, parts.Negative, "the information must not be negative in any direction"),
        (front_end, parts.Unsure, "it must be sure of its poses where scans fit (Placed.sure)"),
        (
            front_end,
            parts.NoStep,
            "has no method step; the contract is FrontEnd.step(points, odometry_step, wait_s)",
        ),
        (testing.check_loop_match, parts.Anywhere, "match: from a near start: off by up to"),
        (
            testing.check_loop_match,
            parts.Everywhere,
            "where nothing is seen overlap and information must be zero",
        ),
        (testing.check_back_end, parts.Idle, "steps and loops that agree: 0."),
        (testing.check_back_end, parts.Gullible, "a wrong loop under a Cauchy kernel"),
        (testing.check_back_end, parts.Floats, "the first pose must be held"),
        (testing.check_back_end, parts.Fewer, "optimise: poses must be an array of shape (30, 3)"),
        (testing.check_localiser, parts.Deaf, "not known after a scan: the filter has no pose yet"),
        (testing.check_localiser, parts.Silent, "update: must return whether the scan was used"),
        (testing.check_planner, parts.Through, "plan: the footprint touches something at pose"),
        (testing.check_planner, parts.Hopeful, "must raise NoPath with a reason where the goal is walled in"),
        (testing.check_controller, parts.Jerks, "is more than the robot can do in"),
        (testing.check_controller, parts.Rolls, "brake: must come to a standstill within 5 s"),
        (testing.check_task, parts.Rammer, "is beyond the robot's limits"),
        (testing.check_task, parts.Stateless, "has no state, which Task requires"),
        (world, parts.Tight, "there must be room for the robot where it starts"),
        (world, parts.Small, "bounds must hold all shapes"),
        (world, parts.Numbers, "shape must be a Solid, not an int"),
        (world, parts.Nameless, "name must be a str, not None"),
        (world, parts.Lost, "keepout or route must be an array of shape (2, 2), not a list"),
        (front_end, parts.TooMuch, "step: overlap is 7, it must be 0 to 1"),
        (front_end, parts.Ahead, "step: revised must be scans before this one"),
        (front_end, parts.Backwards, "step: revised must be scans before this one"),
        (front_end, parts.NoPairs, "step: revised must be scans before this one"),
        (front_end, parts.Perhaps, "step: sure must be a bool, not an array of shape (2,)"),
        (front_end, parts.Sources, "step: source must be 0 to 4"),
        (testing.check_localiser, parts.Boastful, "agreement must be a share 0..1, not 7"),
        (testing.check_localiser, parts.Empty, "particles must be poses (n,), at least one"),
        (testing.check_localiser, parts.Torn, "lost must be a bool, not None"),
        (testing.check_localiser, parts.Uncounted, "searches must be an int, not None"),
        (testing.check_planner, parts.Shorter, "length is negative"),
        (testing.check_task, parts.Mute, "state must be a str, not None"),
        (testing.check_task, parts.Unfinished, "finished must be a bool, not None"),
        (testing.check_task, parts.Goals, "goal_index must be an int, not a str"),
        (testing.check_task, parts.Somewhere, "estimate must be a SE2, not an array of shape (3,)"),
        (testing.check_task, parts.Blind, "its sensing must get every observation"),
        (testing.check_task, parts.Silly, "step: must return a Twist, not None"),
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
        testing.check_world(parts.Strange, "")


def test_a_front_end_may_go_on_with_the_array_that_it_returned():
    front_end(parts.Reuses)
