"""The filter as a whole, in a synthetic room, by its errors."""

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.localisation_room import LIDAR, T_BASE_LIDAR, drive
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.localisation.amcl import Amcl
from turtlebag.pipeline.localisation.parameters import AmclConfig

TOUR = [(2.0, 2.0), (4.3, 2.2), (4.3, 0.5), (2.6, 0.5), (0.6, 0.6), (0.6, 2.4), (2.5, 3.4), (2.0, 2.0)]


@pytest.fixture(scope="module")
def log(room):
    return drive(room, TOUR, np.random.default_rng(7))


def make(room, seed=1, **settings):
    return Amcl(room.grid(), LIDAR, T_BASE_LIDAR, AmclConfig(**settings), np.random.default_rng(seed))


def errors(amcl, log):
    """(position, heading) error after each scan, (n, 2)."""
    out = []
    for step in log:
        amcl.update(step.scan, step.T_odom_base, step.T_odom_base_end)
        offset = step.T_room_base.inverse() @ amcl.T_map_base(step.T_odom_base)
        out.append((np.hypot(offset.x, offset.y), abs(float(offset.yaw))))
    return np.array(out)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.slow
def test_tracks_a_drifting_robot(room, log):
    drift = log[-1].T_room_base.inverse() @ log[-1].T_odom_base
    assert np.hypot(drift.x, drift.y) > 0.1
    amcl = make(room)
    amcl.initialise(log[0].T_room_base, np.diag([0.01, 0.01, 0.01]))
    found = errors(amcl, log)[5:]
    assert rms(found[:, 0]) < 0.015
    assert np.degrees(rms(found[:, 1])) < 0.4
    assert amcl.converged


def test_same_seed_same_estimate(room, log):
    runs = []
    for _ in range(2):
        amcl = make(room, seed=5)
        amcl.initialise(log[0].T_room_base)
        errors(amcl, log[:20])
        runs.append((amcl.T_map_odom.xyt, amcl.particles.xyt))
    assert np.array_equal(runs[0][0], runs[1][0])
    assert np.array_equal(runs[0][1], runs[1][1])


def test_a_robot_at_rest_is_not_updated(room, log):
    amcl = make(room)
    amcl.initialise(log[0].T_room_base)
    assert amcl.update(log[0].scan, log[0].T_odom_base)
    assert not amcl.update(log[0].scan, log[0].T_odom_base)


def test_finds_itself_from_nothing(room, log):
    amcl = make(room)
    amcl.initialise_globally()
    found = errors(amcl, log[:60])
    assert found[-1, 0] < 0.05
    assert amcl.converged


@pytest.mark.slow
def test_a_kidnapped_robot_recovers(room, log):
    amcl = make(room)
    amcl.initialise(log[0].T_room_base, np.diag([0.01, 0.01, 0.01]))
    errors(amcl, log[:30])
    # Carried from the middle of the room to a corner; the wheels have not turned.
    T_odom_moved = log[29].T_odom_base @ log[200].T_odom_base.inverse()
    carried = [
        replace(
            step,
            T_odom_base=T_odom_moved @ step.T_odom_base,
            T_odom_base_end=T_odom_moved @ step.T_odom_base_end,
        )
        for step in log[200:300]
    ]
    found = errors(amcl, carried)
    assert found[0, 0] > 1.0
    assert found[-1, 0] < 0.05


def test_a_bad_initial_pose_is_corrected(room, log):
    amcl = make(room)
    amcl.initialise(log[0].T_room_base @ SE2.from_xyt(0.4, -0.3, np.radians(30.0)))
    assert errors(amcl, log[:60])[-1, 0] < 0.05


@pytest.mark.slow
def test_a_third_of_the_view_blocked_does_not_move_the_estimate(room, log):
    amcl = make(room)
    amcl.initialise(log[0].T_room_base, np.diag([0.01, 0.01, 0.01]))
    errors(amcl, log[:20])
    blocked = []
    for step in log[20:150]:
        ranges = step.scan.ranges.copy()
        ranges[:120] = np.minimum(ranges[:120], 0.3)
        blocked.append(replace(step, scan=replace(step.scan, ranges=ranges)))
    assert errors(amcl, blocked)[:, 0].max() < 0.08


@pytest.mark.parametrize("reading", [np.inf, np.nan, -np.inf])
def test_a_blind_scan_leaves_the_estimate_to_odometry(room, log, reading):
    amcl = make(room)
    amcl.initialise(log[0].T_room_base, np.diag([1e-4, 1e-4, 1e-4]))
    errors(amcl, log[:20])
    blind = np.full(360, reading, dtype=np.float32)
    seen = [replace(step, scan=replace(step.scan, ranges=blind)) for step in log[20:30]]
    assert errors(amcl, seen)[:, 0].max() < 0.06


@pytest.mark.parametrize("refine", [True, False])
def test_the_filter_tracks_with_and_without_the_fine_pose(room, log, refine):
    amcl = make(room, refine=refine)
    amcl.initialise(log[0].T_room_base, np.diag([0.01, 0.01, 0.01]))
    assert rms(errors(amcl, log[:150])[10:, 0]) < 0.05


def test_scans_that_agree_less_than_they_once_did_are_worth_a_second_look_now_and_then(room, log):
    amcl = make(room)
    amcl.initialise(log[0].T_room_base, np.diag([0.01, 0.01, 0.01]))
    errors(amcl, log[:30])
    assert amcl.watch.search_share() == 0.0
    amcl.watch.fast = 0.85 * amcl.watch.best  # an aliased place: no scan disagrees enough to be lost
    assert amcl.agrees
    shares = []
    for _ in range(70):
        amcl.watch.updates += 1
        shares.append(amcl.watch.search_share())
    looks = np.flatnonzero(shares)
    assert len(looks) == 3
    assert np.all(np.diff(looks) == 32)
    # The search finds no better place than the right one, and the estimate stays.
    assert errors(amcl, log[30:60])[:, 0].max() < 0.05


@pytest.mark.parametrize(
    ("alphas", "std"),
    [
        ({"alpha2": 0.04}, (0.0, 0.2 * 0.5)),  # turns in proportion to the way
        ({"alpha3": 0.04}, (0.2 * 0.5, 0.0)),  # the way in proportion to the way
    ],
)
def test_what_the_alphas_add_is_what_their_names_say(room, log, alphas, std):
    """Straight on by 0.5 m: standard deviations of the way and of the heading at its end, without a scan."""
    none = dict.fromkeys(("alpha1", "alpha2", "alpha3", "alpha4"), 0.0)
    amcl = make(room, refine=False, **{**none, **alphas})
    start = SE2.from_xyt(1.5, 1.5, 0.0)
    amcl.initialise(start, np.zeros((3, 3)), start)
    blind = replace(log[0].scan, ranges=np.full(360, np.nan, dtype=np.float32))
    amcl.update(blind, start)
    amcl.update(blind, start @ SE2.from_xyt(0.5, 0.0, 0.0))
    x, y, yaw = amcl.particles.xyt.T
    assert np.hypot(x - 1.5, y - 1.5).std() == pytest.approx(std[0], rel=0.1, abs=1e-9)
    # the turn before the way and the turn after it
    assert yaw.std() == pytest.approx(np.sqrt(2.0) * std[1], rel=0.1, abs=1e-9)


@pytest.mark.parametrize(("interval", "resampled"), [(1, True), (1000, False)])
def test_the_cloud_is_resampled_at_its_interval_only(room, log, interval, resampled):
    amcl = make(room, resample_interval=interval, selective_resampling=False)
    amcl.initialise(log[0].T_room_base, np.diag([0.01, 0.01, 0.01]))
    errors(amcl, log[:20])
    assert (np.ptp(amcl.cloud.weights) < 1e-12) == resampled
    # what is not resampled keeps the particles it was begun with, each once
    assert (amcl.size == amcl.config.max_particles) == (not resampled)


@pytest.mark.parametrize("push", [(0.19, 0.0, 0.0), (-0.05, 0.13, 0.0), (0.0, 0.0, 0.35), (0.12, -0.1, -0.2)])
def test_a_robot_that_was_pushed_while_it_stood_finds_itself_when_it_drives_on(room, log, push):
    amcl = make(room)
    sure_of = log[0].T_room_base @ SE2(np.array(push)).inverse()
    amcl.initialise(sure_of, np.diag([0.02, 0.02, 0.02]) ** 2)
    off, turned = errors(amcl, log[:20])[-1]
    assert off < 0.03
    assert turned < 0.03
