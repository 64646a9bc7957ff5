"""The mapper that works while the robot drives: what it keeps, what it drops, and that it repeats."""

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.slam_rooms import ROOM, around_the_room, drifted, recording
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import LidarSpec, MountedLidar, Trajectory
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind, Loop
from turtlebag.pipeline.slam.graph.drift import HONEST
from turtlebag.pipeline.slam.graph.isam2 import GrowingGraph, joined, without
from turtlebag.pipeline.slam.graph.pose_graph import optimise
from turtlebag.pipeline.slam.loops.by_distance import LoopConfig, step_lengths
from turtlebag.pipeline.slam.mapper import SlamConfig, run_slam
from turtlebag.pipeline.slam.odometry.track import TrackingConfig
from turtlebag.pipeline.slam.odometry.tracker import Tracker, track_log
from turtlebag.pipeline.slam.odometry.wheels import Wheels
from turtlebag.pipeline.slam.online.loops import GrowingLoops
from turtlebag.pipeline.slam.online.mapper import Kept, Mapper
from turtlebag.pipeline.slam.online.memory import GrowingLog, GrowingScans, heard
from turtlebag.pipeline.slam.scans.clouds import KeyScans, make_clouds
from turtlebag.pipeline.slam.scans.range_noise import RangeNoise
from turtlebag.pipeline.slam.scans.scans import Scans

TRUE = around_the_room(240, laps=3)
LOG = recording(ROOM, TRUE, odometry=drifted(TRUE))
NOISE = RangeNoise()


def driven(log, upto=None, config=None):
    """A mapper that has seen a log, and the poses it gave on the way (n, 3)."""
    mapper = Mapper(log.lidar, log.T_base_lidar, config)
    given = [mapper.add(log.scan(k), log.T_odom_base[k]).xyt for k in range(upto or len(log))]
    return mapper, np.array(given)


def first(n):
    """The first n scans of LOG."""
    return replace(LOG, stamps_ns=LOG.stamps_ns[:n], ranges=LOG.ranges[:n], T_odom_base=LOG.T_odom_base[:n])


@pytest.fixture(scope="module")
def whole():
    """The mapper that has seen all of LOG, the poses it gave, and how many keys it had after two laps."""
    mapper, given = driven(LOG, 160)
    keys = len(mapper.T_map_keys)
    later = [mapper.add(LOG.scan(k), LOG.T_odom_base[k]).xyt for k in range(160, len(LOG))]
    return mapper, np.vstack([given, later]), keys


def errors(poses, true):
    """Distances (n,) from the true positions."""
    return np.linalg.norm(SE2(poses).xy - true[: len(poses), :2], axis=1)


def grown(upto):
    growing = GrowingScans(8.0, NOISE)
    for k in range(upto):
        one = replace(
            LOG,
            stamps_ns=LOG.stamps_ns[k : k + 1],
            ranges=LOG.ranges[k : k + 1],
            T_odom_base=LOG.T_odom_base[k : k + 1],
        )
        growing.append(one, k)
    return growing


def test_clouds_grown_scan_by_scan_are_those_made_at_once():
    whole, found = make_clouds(LOG, 8.0, noise=NOISE), grown(len(LOG)).view()
    for name in whole._fields:
        np.testing.assert_array_equal(getattr(found, name), getattr(whole, name), err_msg=name)


def test_clouds_of_which_some_were_dropped_are_those_of_the_rest():
    stays = np.arange(60) % 7 < 3
    growing = grown(60)
    growing.keep(stays)
    some, found = make_clouds(LOG, 8.0, noise=NOISE, scans=np.flatnonzero(stays)), growing.view()
    for name in some._fields:
        np.testing.assert_array_equal(getattr(found, name), getattr(some, name), err_msg=name)


@pytest.mark.parametrize("late", [True, False])
def test_odometry_that_comes_with_some_scans_only_is_refused(late):
    mapper = Mapper(LOG.lidar, LOG.T_base_lidar)
    mapper.add(LOG.scan(0), None if late else LOG.T_odom_base[0])
    with pytest.raises(ValueError, match="those before were of stamp_ns, ranges"):
        mapper.add(LOG.scan(1), LOG.T_odom_base[1] if late else None)
    assert len(mapper) == 1


def test_the_map_begins_where_the_odometry_does():
    mapper = Mapper(LOG.lidar, LOG.T_base_lidar)
    begun = mapper.add(LOG.scan(0), LOG.T_odom_base[0])
    np.testing.assert_allclose(begun.xyt, LOG.T_odom_base.xyt[0], atol=1e-9)
    np.testing.assert_allclose(mapper.T_map_odom.xyt, 0.0, atol=1e-9)


def test_a_log_heard_with_a_stream_of_odometry_is_the_log_it_was_and_keeps_the_newest_of_it():
    log, rng = first(30), np.random.default_rng(2)
    log = replace(log, lidar=replace(log.lidar, time_increment=0.15 / 359))
    stamps = np.arange(log.stamps_ns[0], log.stamps_ns[-1] + 1, 50_000_000)
    stream = Trajectory(stamps, SE2(rng.normal(size=(len(stamps), 3))))
    growing = GrowingLog([MountedLidar(log.lidar, log.T_base_lidar)])
    for scan, odometry in heard(replace(log, odometry=stream)):
        growing.append(scan, odometry, [])
        assert odometry.stamps_ns[-1] == min(scan.stamp_ns + 150_000_000, stamps[-1])
    found = growing.recording()
    np.testing.assert_array_equal(found.ranges, log.ranges)
    np.testing.assert_allclose(found.T_odom_base.xyt, stream.poses.xyt[::4], atol=1e-9)
    growing.keep(np.arange(30) >= 28)
    logs = (found, 30, len(stamps)), (growing.last(), 1, 64), (growing.recording(), 2, 64)
    for some, scans, samples in logs:
        np.testing.assert_array_equal(some.stamps_ns, log.stamps_ns[-scans:])
        np.testing.assert_array_equal(some.odometry.stamps_ns, stamps[-samples:])
        np.testing.assert_array_equal(some.odometry.poses.xyt, stream.poses.xyt[-samples:])


def chain(n, rng):
    """Steps of a drive and one loop, with information of all kinds."""
    constraints = []
    for k in range(n - 1):
        root = rng.normal(size=(3, 3))
        step = np.array([0.3, 0.02, 0.1]) + 0.05 * rng.normal(size=3)
        constraints.append(Constraint(k, k + 1, step, root @ root.T * 400.0 + 50.0 * np.eye(3), Kind.STEP))
    return constraints


def test_two_steps_joined_say_what_both_say_together():
    rng = np.random.default_rng(3)
    a, b = chain(3, rng)
    both = joined(a, b)
    draws = 40_000
    noise_a = rng.multivariate_normal(np.zeros(3), np.linalg.inv(a.information), draws)
    noise_b = rng.multivariate_normal(np.zeros(3), np.linalg.inv(b.information), draws)
    ends = (SE2(a.T_i_j) @ SE2(noise_a)) @ (SE2(b.T_i_j) @ SE2(noise_b))
    error = (SE2(both.T_i_j).inverse() @ ends).xyt
    expected = np.linalg.inv(both.information)
    np.testing.assert_allclose(np.cov(error.T), expected, atol=0.05 * np.trace(expected))
    assert (both.i, both.j) == (0, 2)


@pytest.mark.parametrize(("gone", "off_m"), [([4, 5, 7], 2e-3), ([4, 5, 7, 10], 0.02)])
def test_a_graph_without_some_keys_puts_the_others_where_the_whole_one_does(gone, off_m):
    # where the end of a loop goes, what the loop pulls at is told of its neighbour
    rng = np.random.default_rng(5)
    steps, n = chain(12, rng), 12
    start = [np.zeros(3)]
    for c in steps:
        start.append((SE2(start[-1]) @ SE2(c.T_i_j)).xyt)
    T = SE2(np.array(start))
    off = (T[2].inverse() @ T[10]) @ SE2.from_xyt(0.03, -0.05, 0.02)
    loop = Constraint(2, 10, off.xyt, 300.0 * np.eye(3), Kind.LOOP)
    whole = optimise(T, [*steps, loop])
    stays = ~np.isin(np.arange(n), gone)
    less = without([*steps, loop], stays, whole.xyt)
    assert len([c for c in less if c.kind == "step"]) == max(max(c.i, c.j) for c in less) == n - len(gone) - 1
    found = optimise(whole[stays], less)
    np.testing.assert_allclose(found.xy, whole[stays].xy, atol=off_m)
    np.testing.assert_allclose(found.yaw, whole[stays].yaw, atol=off_m)


def test_the_growing_graph_ends_where_the_batch_does():
    rng = np.random.default_rng(7)
    steps = chain(30, rng)
    start = [np.zeros(3)]
    for c in steps:
        start.append((SE2(start[-1]) @ SE2(c.T_i_j)).xyt)
    poses, T = np.array(start), SE2(np.array(start))
    loops = [
        Constraint(
            j, i, (T[j].inverse() @ T[i] @ SE2.from_xyt(0.02, 0.03, 0.01)).xyt, 200.0 * np.eye(3), Kind.LOOP
        )
        for j, i in ((0, 12), (3, 18), (1, 29))
    ]
    graph, known, now = GrowingGraph(), 0, poses[:1]
    for loop in loops:
        rest = poses[len(now) : loop.j + 1]
        move = SE2(now[-1]) @ SE2(poses[len(now) - 1]).inverse()
        now = np.vstack([now, (move @ SE2(rest)).xyt])
        now = graph.update(now, [*steps[known : loop.j], loop])
        known = loop.j
    np.testing.assert_allclose(now, optimise(T, [*steps, *loops]).xyt, atol=2e-3)
    assert now.flags.c_contiguous  # as all others that kernels are compiled for


@pytest.mark.slow
def test_odometry_that_drifts_does_not_carry_the_robot_off(whole):
    mapper, given, _ = whole
    assert errors(LOG.T_odom_base.xyt, TRUE).max() > 0.5
    assert errors(given, TRUE).max() < 0.06
    assert errors(mapper.trajectory.poses.xyt, TRUE).max() < 0.04
    closed = optimise(mapper.T_map_keys, mapper.constraints)
    np.testing.assert_allclose(mapper.T_map_keys.xyt, closed.xyt, atol=5e-3)
    assert mapper.jumps
    assert not mapper.lost
    assert 0.0 < mapper.sigma_m < 0.2


@pytest.mark.slow
def test_without_odometry_the_scans_alone_carry_the_robot():
    mapper = Mapper(LOG.lidar, LOG.T_base_lidar)
    given = np.array([mapper.add(LOG.scan(k), None).xyt for k in range(100)])
    assert errors((SE2(TRUE[0]) @ SE2(given)).xyt, TRUE).max() < 0.06


THERE = np.array([9.0, 9.0, 0.0])


class Hindsight(Wheels):
    """A user's front end that knows at the 20th scan where the ones before were."""

    def __init__(self, tracker):
        super().__init__(tracker)
        self.tracker = tracker

    def step(self, points, odometry_step, wait_s):
        late = tuple((k, THERE) for k in range(20)) if self.tracker.scan == 20 else ()
        return replace(super().step(points, odometry_step, wait_s), revised=late)


def test_scans_that_a_later_one_tells_more_of_move_on_the_trajectory_as_on_the_track():
    mapper, given = driven(LOG, 30, SlamConfig(front_end=f"{__name__}:Hindsight"))
    moved = np.flatnonzero((np.abs(mapper.trajectory.poses.xyt - given) > 1e-6).any(axis=1))
    assert moved.tolist() == [k for k in range(20) if k not in mapper.keys]
    np.testing.assert_allclose(mapper.trajectory.poses.xyt[moved], np.tile(THERE, (len(moved), 1)), atol=1e-6)


def test_the_odometry_is_calibrated_whenever_the_key_scans_have_doubled_and_at_the_end():
    calibrated = []
    config = TrackingConfig(key_distance_m=0.1)
    clouds = make_clouds(LOG, 8.0, noise=NOISE)
    tracker = Tracker(clouds, LOG, config, 8.0, Wheels)
    for _ in range(len(LOG) - 1):
        before = tracker.calibration
        tracker.step(0.2)
        if tracker.calibration is not before:
            calibrated.append(len(tracker.keys))
    assert 128 < len(tracker.keys) < 256
    assert calibrated == [2, 4, 8, 16, 32, 64, 128]
    track = track_log(Scans(LOG, 8.0, NOISE, None), config, Wheels)
    assert track.calibration.pairs > tracker.calibration.pairs > 0


def growing_loops(n, information):
    """The loops of n keys, every fourth of which waits, and their clouds."""
    clouds, every = make_clouds(first(n), 8.0, noise=NOISE), np.arange(n)
    loops = GrowingLoops(clouds, TRUE[0], LoopConfig(every=4))
    for k, step in enumerate(SE2(TRUE[:n]).steps()):
        scans = KeyScans(clouds, every[: k + 2])
        loops.add_key(scans, step, [Constraint(0, 1, step, information, Kind.STEP)])
    return loops, clouds


def test_a_key_is_as_unsure_as_all_steps_from_the_first_together():
    sigma_m = 0.01
    sure_of_yaw = HONEST * np.diag([sigma_m**-2, sigma_m**-2, 1e10])
    loops, _ = growing_loops(5, sure_of_yaw)
    loops.work()
    assert loops.sigma_m == pytest.approx(2.0 * sigma_m, rel=1e-3)  # four steps


def test_the_way_driven_is_that_of_all_steps_so_far():
    loops, _ = growing_loops(7, np.eye(3))
    np.testing.assert_allclose(loops.path, np.append(0.0, np.cumsum(step_lengths(TRUE[:7]))))


@pytest.mark.parametrize("found", [False, True])
def test_keys_that_wait_and_the_loop_found_are_the_same_when_others_have_gone(found):
    loops, clouds = growing_loops(12, 1e4 * np.eye(3))
    every = np.arange(12)
    assert list(loops.waiting) == [4, 8]
    if found:
        loops.found = Loop(10, 2, np.zeros(3), 1.0, 1.0, 0.0, np.eye(3), "accepted")
    stays = loops.needed() | (every == 11)
    loops.keep(stays, KeyScans(clouds, every[stays]))
    np.testing.assert_allclose(loops.poses, TRUE[:12][stays], atol=1e-6)
    kept = loops.scans.keys
    assert kept[list(loops.waiting)].tolist() == [4, 8]
    assert (loops.found and kept[[loops.found.i, loops.found.j]].tolist()) == ([10, 2] if found else None)
    assert kept.tolist() == ([0, 2, 4, 8, 10, 11] if found else [0, 4, 8, 11])


@pytest.mark.slow
def test_finish_gives_what_the_offline_mapper_gives():
    mapper, _ = driven(LOG, 120)
    mapper.map()
    trajectory, grid = mapper.finish()
    offline = run_slam(first(120), mapper.config)
    np.testing.assert_array_equal(grid.cells, offline.grid.cells)
    np.testing.assert_array_equal(trajectory.poses.xyt, offline.trajectory.poses.xyt)


@pytest.mark.slow
def test_memory_is_that_of_the_area_and_the_map_stays_right(whole):
    kept = Kept(tidy_scans=32, last_scans=16, place_keys=1, log_scans=150)
    mapper, given = Mapper(LOG.lidar, LOG.T_base_lidar, kept=kept), []
    for k in range(len(LOG)):
        given.append(mapper.add(LOG.scan(k), LOG.T_odom_base[k]).xyt)
        np.testing.assert_allclose(mapper.trajectory.poses.xyt[-1], given[-1], atol=1e-9)
    given = np.array(given)
    assert len(mapper) < 200 < len(LOG)
    assert len(mapper.T_map_keys) < 1.3 * whole[2]
    assert errors(given, TRUE).max() < 0.06
    stamps, poses = mapper.trajectory.stamps_ns, mapper.trajectory.poses.xyt
    assert errors(poses, TRUE[np.searchsorted(LOG.stamps_ns, stamps)]).max() < 0.05
    trajectory, grid = mapper.finish()
    assert errors(trajectory.poses.xyt, TRUE[np.searchsorted(LOG.stamps_ns, stamps)]).max() < 0.03
    free = run_slam(first(100), mapper.config).grid.cells == 0
    assert np.count_nonzero(grid.cells == 0) == pytest.approx(np.count_nonzero(free), rel=0.02)


@pytest.mark.slow
def test_a_robot_carried_to_another_place_is_lost_and_says_so():
    mapper, _ = driven(LOG, 60)
    assert not mapper.lost
    elsewhere = np.array(
        [[-60.0, -51.0, -40.0, -51.2], [-41.0, -60.0, -41.2, -40.0], [-60, -48.7, -40, -48.1]]
    )
    poses = np.tile([-50.0, -50.0, 0.3], (12, 1))
    away = recording(elsewhere, poses, LidarSpec(360, 0.0, np.pi / 180.0, 0.12, 8.0), odometry=poses)
    for k in range(len(away)):
        mapper.add(away.scan(k), LOG.T_odom_base[59])
    assert mapper.lost
    assert mapper.fit < 0.6


@pytest.mark.slow
@pytest.mark.parametrize("wheels", [True, False])
def test_scans_without_a_return_leave_the_robot_lost_only_where_nothing_carries_it(wheels):
    mapper = Mapper(LOG.lidar, LOG.T_base_lidar)
    assert mapper.sigma_m is None
    for k in range(40):
        scan = LOG.scan(k)
        if k >= 30:
            scan = replace(scan, ranges=np.full_like(scan.ranges, np.inf))
        mapper.add(scan, LOG.T_odom_base[k] if wheels else None)
    assert mapper.lost != wheels


@pytest.mark.slow
def test_the_same_scans_give_the_same_poses(whole):
    np.testing.assert_array_equal(driven(LOG, 150)[1], whole[1][:150])
