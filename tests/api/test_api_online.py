"""Simulator, mapper, localiser and planner step by step: what the whole steps make of the same."""

import numpy as np
import pytest

import turtlebag as tb
from turtlebag.datasets.bags.reader import read_commands
from turtlebag.datasets.recordings import load_recording
from turtlebag.pipeline.slam.online.memory import heard

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def recording(chain):
    return load_recording(chain / "record")


def test_the_simulator_driven_by_a_bags_commands_senses_what_the_bag_holds(chain, recording):
    _, v, w = read_commands(chain / "record")
    with tb.Simulator(chain / "room.yaml", seed=3) as sim:
        seen = [sim.observation, *(sim.step(*command) for command in zip(v[:-1], w[:-1], strict=True))]
        truth = sim.truth.T_world_base.xyt
        scans = [one.scan for one in seen if one.scan is not None]
        assert np.array_equal([scan.ranges for scan in scans], recording.ranges, equal_nan=True)
        assert [scan.stamp_ns for scan in scans] == recording.stamps_ns.tolist()
        assert np.hypot(*(truth - tb.Bag(chain / "record").truth[-1])[:2]) < 0.1
        assert sim.time_s == pytest.approx(seen[-1].stamp_ns * 1e-9)
        first = sim.reset()
        assert first.odometry.T_odom_base.xyt.tolist() == seen[0].odometry.T_odom_base.xyt.tolist()
        with pytest.raises(tb.InputError, match="start pose"):
            sim.reset((-0.7, 0.6, 0.0))


def test_the_mapper_places_scans_as_the_whole_map_does(chain, recording):
    m, mapper = tb.Map(chain / "map"), tb.Mapper("burger")
    with pytest.raises(tb.InputError, match="no scan yet"):
        _ = mapper.pose
    poses = np.array([mapper.add(scan, odometry) for scan, odometry in heard(recording)])
    assert len(mapper) == len(recording) == len(poses)
    assert np.abs(poses - m.trajectory).max() < 0.05
    assert not mapper.lost
    trajectory, grid = mapper.finish()
    assert np.abs(trajectory[:] - m.trajectory).max() < 0.02
    assert (grid.cells == 100).sum() > 100


def test_the_mapper_and_the_localiser_follow_a_robot_that_is_driven(chain):
    with tb.Simulator(chain / "room.yaml", seed=5) as sim:
        mapper, localiser = tb.Mapper(), tb.Localiser(chain / "map", initial_pose=(0, 0, 0))
        for k in range(60):
            seen = sim.step(0.1, 0.3) if k else sim.observation
            mapped, localised = mapper.observe(seen), localiser.observe(seen)
            assert (mapped is None) == (localised is None) == (seen.scan is None)
        truth = sim.truth.T_world_base
        assert np.hypot(*(mapper.T_map_odom @ seen.odometry.T_odom_base).xy - truth.xy) < 0.05
        assert np.hypot(*(localiser.T_map_odom @ seen.odometry.T_odom_base).xy - truth.xy) < 0.08


def test_the_localiser_says_what_localise_says(chain, recording):
    found = tb.localise(chain / "record", chain / "map", initial_pose=(0, 0, 0), seed=2)
    localiser = tb.Localiser(chain / "map", initial_pose=(0, 0, 0), seed=2)
    assert localiser.lost
    period = round(recording.lidar.n_beams * recording.lidar.time_increment * 1e9)
    ends = recording.odometry.at(recording.stamps_ns + period)
    starts = recording.T_odom_base
    poses = [localiser.add(recording.scan(k), starts[k], ends[k]) for k in range(len(recording))]
    assert np.abs(np.array(poses) - found.trajectory).max() < 1e-8
    assert localiser.particles.shape[1] == 3
    assert localiser.covariance.shape == (3, 3)
    with pytest.raises(tb.InputError, match="initial_pose: expected X,Y,YAW"):
        tb.Localiser(chain / "map", initial_pose="start")


def test_the_planner_finds_the_path_that_plan_finds(chain):
    planner = tb.Planner(chain / "map")
    poses = planner.plan((0, 0, 0), (0.5, 0, 0))
    assert np.abs(poses - tb.Plan(chain / "plan").poses).max() < 1e-5
    with pytest.raises(tb.InputError, match=r"^goal 1\.5,0,0: the robot would stand in an obstacle"):
        planner.plan((0, 0, 0), (1.5, 0, 0))
    with pytest.raises(tb.NoPath, match="not today"):
        tb.Planner(chain / "map", planner=Idle).plan((0, 0, 0), (0.5, 0, 0))


class Idle:
    """A global planner that finds nothing."""

    def __init__(self, config):
        pass

    def plan(self, costmap, model, T_map_start, T_map_goal, seed):
        raise tb.NoPath("not today")
