"""The filter's compiled loops, beside plain NumPy."""

import math

import numpy as np
import pytest

from tests.helpers.localisation_room import T_BASE_LIDAR
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import LidarSpec, Scan
from turtlebag.pipeline.localisation import estimate, motion_model, resampling
from turtlebag.pipeline.localisation.deskewed_beams import evenly_spaced, prepare


def wrapped(angle):
    return (np.asarray(angle) + np.pi) % (2.0 * np.pi) - np.pi


@pytest.mark.parametrize("seed", range(4))
def test_moments_are_those_of_the_particles_within_reach(seed):
    rng = np.random.default_rng(seed)
    poses = np.column_stack([rng.normal(0.0, 0.4, (60, 2)), rng.uniform(-9.0, 9.0, 60)])
    weights, centre = rng.random(60), np.array([0.1, -0.1, 3.0])
    off = poses - centre
    off[:, 2] = wrapped(off[:, 2])
    for reach_xy, reach_yaw in ((0.5, 1.2), (0.3, 4.0), (np.inf, np.inf)):
        near = (np.hypot(off[:, 0], off[:, 1]) <= reach_xy) & (np.abs(off[:, 2]) <= reach_yaw)
        w, d = weights[near], off[near]
        mass, mean, second = estimate.moments(poses, weights, centre, reach_xy, reach_yaw)
        assert mass == pytest.approx(w.sum())
        np.testing.assert_allclose(mean, centre + w @ d / w.sum())
        np.testing.assert_allclose(second, (w[:, None] * d).T @ d / w.sum(), atol=1e-12)
    mass, mean, second = estimate.moments(poses, weights, centre + 90.0, 0.5, 0.5)
    assert mass == 0.0
    np.testing.assert_array_equal(mean, centre + 90.0)
    np.testing.assert_array_equal(second, np.zeros((3, 3)))


def test_particles_just_within_reach_count():
    poses = np.array([[0.5, 0.0, 0.0], [0.0, 0.0, 0.25]])
    assert estimate.moments(poses, np.full(2, 0.5), np.zeros(3), 0.5, 0.25)[0] == 1.0
    assert estimate.moments(poses, np.full(2, 0.5), np.zeros(3), 0.49, 0.24)[0] == 0.0


def test_a_cluster_is_settled_on_its_mean_from_its_edge():
    rng = np.random.default_rng(5)
    poses = np.array([1.0, 2.0, -3.1]) + rng.normal(0.0, 0.1, (400, 3))
    poses = np.vstack([poses, np.array([3.0, 0.0, 1.0]) + rng.normal(0.0, 0.05, (100, 3))])
    weights = np.full(500, 1.0 / 500)
    mass, mean, core = estimate.settled(poses, weights, np.array([1.35, 2.2, -3.3]))
    assert mass == pytest.approx(0.8)
    np.testing.assert_allclose(mean, poses[:400].mean(axis=0), atol=2e-4)
    np.testing.assert_allclose(core, np.cov(poses[:400].T, bias=True), atol=1e-3)
    found = estimate.main_cluster(poses, weights)
    np.testing.assert_allclose(found.core, core + 1e-6 * np.eye(3), atol=1e-6)
    np.testing.assert_allclose(wrapped(found.T_map_base.xyt - mean), 0.0, atol=2e-4)
    whole = estimate.moments(poses, weights, found.T_map_base.xyt, np.inf, np.inf)[2]
    np.testing.assert_allclose(found.covariance, whole, atol=1e-3)
    alone = estimate.main_cluster(poses[:400], np.full(400, 1.0 / 400))
    np.testing.assert_allclose(alone.covariance, alone.core - 1e-6 * np.eye(3), atol=1e-12)


def test_a_cloud_is_binned_as_wide_in_place_and_heading_as_kld_sampling_does():
    """A cluster is begun from a few of the heaviest bins: six of five particles each hide one of eight,
    unless more than five of these share a bin."""
    bins = np.array([resampling.BIN_M, resampling.BIN_M, resampling.BIN_RAD])
    fives = np.repeat([[4.0 * k + 0.01, 0.01, 0.01] for k in range(1, 7)], 5, axis=0)

    def found(eight):
        poses = np.vstack([fives, eight])
        return estimate.main_cluster(poses, np.full(len(poses), 1.0 / len(poses))).T_map_base

    # in the corners of one bin, and so at most four in any narrower one
    corners = np.array([[x, y, a] for x in (0.05, 0.95) for y in (0.05, 0.95) for a in (0.05, 0.95)]) * bins
    np.testing.assert_allclose(found(corners).xyt, 0.5 * bins, atol=1e-9)
    # four each in two bins, which wider ones would join
    for axis in range(3):
        row = np.tile(0.5 * bins, (8, 1))
        row[:, axis] = np.repeat([0.95, 1.05], 4) * bins[axis]
        assert found(row).x > 3.0


def test_the_heaviest_cluster_wins_though_the_heaviest_bin_is_another_s():
    """Four bins share the heavier cluster, each lighter than the bin of the other."""
    corners = np.array([[x, y, 0.1] for x in (-0.05, 0.05) for y in (-0.05, 0.05)])
    poses = np.vstack([np.repeat(corners, 15, axis=0), np.tile([2.1, 2.1, 0.1], (40, 1))])
    found = estimate.main_cluster(poses, np.full(100, 0.01))
    np.testing.assert_allclose(found.T_map_base.xyt, [0.0, 0.0, 0.1], atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_the_comb_picks_what_the_cumulative_weights_say(seed):
    rng = np.random.default_rng(seed)
    weights = rng.random(25) ** 4
    weights /= weights.sum()
    for count, offset in ((40, 0.3), (7, 0.0), (1, 0.99), (25, 0.5)):
        teeth = (np.arange(count) + offset) / count
        expected = np.searchsorted(np.cumsum(weights), teeth, side="left")
        np.testing.assert_array_equal(resampling.low_variance(weights, count, offset), expected)
    # weights that rounding leaves short of one
    np.testing.assert_array_equal(resampling.low_variance(np.array([0.5, 0.3]), 4, 0.9), [0, 0, 1, 1])
    assert resampling.effective_size(np.array([0.5, 0.25, 0.25])) == pytest.approx(1.0 / 0.375)


@pytest.mark.parametrize("n", [1, 2, 7, 600, 5000])
@pytest.mark.parametrize("offset", [0.0, 0.4, 0.9999])
def test_scattered_values_are_each_there_once_and_neighbours_far_apart(n, offset):
    found = resampling.scattered(np.arange(n), offset)
    np.testing.assert_array_equal(np.sort(found), np.arange(n))
    assert found[0] == int(offset * n)
    # of any beginning, every tenth of the values has its share, nearly
    for much in range(0, n, 50) if n >= 600 else ():
        shares = np.histogram(found[:much], 10, (0, n))[0]
        assert np.abs(shares - much / 10).max() <= 6.0


def test_kld_counts_as_foxs_bound_says_draw_by_draw():
    for bins in (2, 3, 10, 77):
        k, z, err = bins - 1, 2.33, 0.05
        exact = k / (2 * err) * (1 - 2 / (9 * k) + math.sqrt(2 / (9 * k)) * z) ** 3
        assert resampling.kld_bound(bins, err, z) == math.ceil(exact)
    assert (resampling.kld_bound(1, 0.05, 2.33), resampling.kld_bound(0, 0.05, 2.33)) == (1, 1)
    rng = np.random.default_rng(6)
    for std_m, least in ((0.2, 10), (0.5, 30), (1.5, 5)):
        numbers = resampling.bin_numbers(rng.normal(0.0, std_m, (900, 3)), 0.25, 0.2)
        drawn = 0
        while drawn < 900:
            seen = len(set(numbers[:drawn].tolist()))
            if drawn >= max(least, resampling.kld_bound(seen, 0.1, 2.33) if seen else 0):
                break
            drawn += 1
        assert resampling.kld_count(numbers, 0.1, 2.33, least) == drawn


def test_bins_whose_hashes_meet_are_told_apart():
    grid = np.stack(np.meshgrid(*[np.arange(-6.0, 6.0)] * 3), axis=-1).reshape(-1, 3) + 0.5
    poses = np.vstack([grid, grid[::-1]])
    np.testing.assert_array_equal(
        resampling.bin_numbers(poses, 1.0, 1.0), np.r_[np.arange(len(grid)), np.arange(len(grid))[::-1]]
    )
    assert resampling.bin_numbers(poses[:1], 1.0, 1.0).tolist() == [0]


def test_each_particle_moves_by_its_own_noisy_copy():
    rng = np.random.default_rng(7)
    poses, noise, told = rng.uniform(-3.0, 3.0, (20, 3)), rng.normal(0.0, 0.3, (20, 3)), (0.4, -0.7, 2.9)
    expected = poses.copy()
    for k in range(20):
        rot1, trans, rot2 = np.array(told) + noise[k]
        expected[k] = (SE2(poses[k]) @ SE2.from_xyt(0, 0, rot1) @ SE2.from_xyt(trans, 0, rot2)).xyt
    motion_model.move(poses, told, noise)
    np.testing.assert_allclose(poses[:, :2], expected[:, :2], atol=1e-12)
    np.testing.assert_allclose(wrapped(poses[:, 2] - expected[:, 2]), 0.0, atol=1e-12)
    assert np.abs(poses[:, 2]).max() <= math.pi


def test_motions_of_less_than_a_centimetre_are_turns_and_backwards_ones_point_ahead():
    assert motion_model.decompose(SE2.from_xyt(0.006, 0.0079, 0.3)) == pytest.approx(
        (0.0, math.hypot(0.006, 0.0079), 0.3)
    )
    rot1, trans, rot2 = motion_model.decompose(SE2.from_xyt(0.03, 0.04, 0.3))
    assert (rot1, trans, rot2) == pytest.approx((math.atan2(4, 3), 0.05, 0.3 - math.atan2(4, 3)))
    rot1, trans, rot2 = motion_model.decompose(SE2.from_xyt(-0.03, -0.04, 3.0))
    assert (rot1, trans, rot2) == pytest.approx((math.atan2(4, 3), -0.05, 3.0 - math.atan2(4, 3)))
    sideways = motion_model.decompose(SE2.from_xyt(0.0, 0.05, 0.0))
    assert sideways == pytest.approx((0.5 * math.pi, 0.05, -0.5 * math.pi))


def test_beams_within_their_limits_become_points_and_silent_ones_directions():
    lidar = LidarSpec(6, 0.0, 0.5, 0.2, 3.5)
    ranges = np.array([0.2, 3.5, 0.19, 3.51, np.inf, 1.0], dtype=np.float32)
    for limits, kept in ((None, [0, 5]), ((0.5, 3.0), [5])):
        beams = prepare(Scan(0, ranges, lidar), T_BASE_LIDAR, SE2.from_xyt(9.0, 9.0, 1.0), limits)
        low, high = limits or (0.2, 3.5)
        assert [i for i in range(6) if low - 1e-6 <= ranges[i] <= high and ranges[i] < 3.5] == kept
        np.testing.assert_allclose(
            beams.points, T_BASE_LIDAR @ (lidar.directions[kept] * ranges[kept, None]), atol=1e-7
        )
        np.testing.assert_allclose(beams.origins, np.tile(T_BASE_LIDAR.xy, (len(kept), 1)))
        np.testing.assert_allclose(beams.silent_directions, lidar.directions[[1, 3, 4]])
    assert [evenly_spaced(7, 3).tolist(), evenly_spaced(3, 3).tolist(), evenly_spaced(4, 9).tolist()] == [
        [0, 2, 4],
        [0, 1, 2],
        [0, 1, 2, 3],
    ]
