"""The parts of 3D mapping, each against plain NumPy or a known answer."""

import gtsam
import numpy as np
import pytest
from scipy.linalg import expm

from tests.helpers.full_disks import files_below
from turtlebag.datasets import se3
from turtlebag.datasets.open3d_loader import open3d
from turtlebag.datasets.ply import read_ply
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind
from turtlebag.pipeline.slam.graph.cost import residuals
from turtlebag.pipeline.slam.graph.pose_graph import optimise, write_g2o
from turtlebag.pipeline.slam3d.cloud_map import CloudMap, finished, save_ply
from turtlebag.pipeline.slam3d.floor import find_floor, levelled
from turtlebag.pipeline.slam3d.loops import MIN_OVERLAP
from turtlebag.pipeline.slam3d.open3d_match import featured, pose_by_features
from turtlebag.pipeline.slam3d.scan_context import Contexts, descriptor, dissimilarity
from turtlebag.pipeline.slam3d.slices import SliceConfig, SliceGrid
from turtlebag.pipeline.slam3d.surfels import Seen, fit, make_surfels, normal_equations, observable
from turtlebag.reports.g2o import read_g2o

RNG = np.random.default_rng(7)


def room_points(n=20_000, noise=0.01):
    """A room of 6 x 4 x 2 m without ceiling, a post in it."""
    u, v = RNG.uniform(size=(2, n))
    floor = np.stack([6 * u, 4 * v, 0 * u], axis=-1)
    walls = [np.stack(x, axis=-1) for x in ((0 * u, 4 * u, 2 * v), (0 * u + 6, 4 * u, 2 * v),
                                            (6 * u, 0 * u, 2 * v), (6 * u, 0 * u + 4, 2 * v))]  # fmt: skip
    a = 2 * np.pi * u
    post = np.stack([2 + 0.3 * np.cos(a), 1.5 + 0.3 * np.sin(a), 1.5 * v], axis=-1)
    points = np.vstack([floor, *walls, post])
    return points + noise * RNG.normal(size=points.shape) - np.array([3.0, 2.0, 0.4])


def place(points, voxel=0.3):
    """Surfels of points seen from the middle."""
    return make_surfels(points, np.zeros_like(points), voxel)


@pytest.mark.slow
def test_transforms_are_those_of_the_matrix_exponential():
    for angle in (0.0, 1e-8, 1e-3, 1.0, 3.0):
        xi = RNG.normal(size=(20, 6))
        xi[:, :3] *= angle / np.linalg.norm(xi[:, :3], axis=1, keepdims=True)
        generators = np.zeros((20, 4, 4))
        generators[:, :3, :3], generators[:, :3, 3] = se3.skew(xi[:, :3]), xi[:, 3:]
        T = se3.exp(xi)
        np.testing.assert_allclose(T, [expm(one) for one in generators], atol=1e-9)
        np.testing.assert_allclose(se3.log(T), xi, atol=1e-8)
        np.testing.assert_allclose(se3.inverse(T) @ T, np.tile(np.eye(4), (20, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(gtsam.Pose3.Logmap(gtsam.Pose3(T[0])), se3.log(T[0]), atol=1e-9)
    planar = SE2.from_xyt(1.0, -2.0, 0.7)
    np.testing.assert_allclose(se3.planar(se3.lifted(planar)).xyt, planar.xyt, atol=1e-12)


def reference_equations(points, when, T, surfels, gate, width):
    """normal_equations in plain NumPy."""
    H, b = np.zeros((12, 12)), np.zeros(12)
    q = se3.moved(T, points)
    cell = np.floor((q - surfels.low) / surfels.voxel).astype(int)
    for p, at, c, f in zip(points, q, cell, when, strict=True):
        voxels = surfels.cells[tuple(slice(max(k - 1, 0), max(k + 2, 0)) for k in c)].ravel()
        near = surfels.pairs[voxels[voxels >= 0]].ravel()
        near = near[near >= 0]
        near = near[surfels.normals[near] @ (T[:3, 3] - at) > 0.0]
        away = at - surfels.means[near]
        r = np.sum(away * surfels.normals[near], axis=1)
        ok = (np.abs(r) <= gate) & (np.sum(away**2, axis=1) < 1.5 * surfels.voxel**2)
        if not ok.any():
            continue
        k = np.flatnonzero(ok)[np.argmin(np.sum(away[ok] ** 2, axis=1))]
        n = T[:3, :3].T @ surfels.normals[near[k]]
        J = np.concatenate([np.cross(p, n), n])
        J = np.concatenate([J, f * J])
        w = (width**2 / (width**2 + r[k] ** 2)) ** 2 / surfels.variances[near[k]]
        H, b = H + w * np.outer(J, J), b + w * r[k] * J
    return H, b


def test_the_compiled_normal_equations_are_those_of_numpy():
    surfels = place(room_points(2000))
    points, when = room_points(30), RNG.uniform(size=180)
    T = se3.exp(np.array([0.01, -0.02, 0.03, 0.05, 0.02, -0.03]))
    H, b, overlap, _ = normal_equations(Seen(points, np.zeros(3), when), T, surfels, 0.2, 0.05)
    expected_H, expected_b = reference_equations(points, when, T, surfels, 0.2, 0.05)
    np.testing.assert_allclose(H, expected_H, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(b, expected_b, rtol=1e-9, atol=1e-6)
    assert 0.6 < overlap <= 1.0


def test_alignment_finds_pose_and_motion_to_a_millimetre():
    surfels = place(room_points())
    T = se3.exp(np.array([0.02, -0.03, 0.1, 0.12, -0.08, 0.04]))
    seen = se3.moved(se3.inverse(T), room_points(800))
    found = fit(surfels, Seen(seen, np.zeros(3)), np.eye(4), gate=0.3, iterations=30)
    assert np.abs(se3.log(se3.inverse(T) @ found.T)).max() < 0.002
    motion, when = np.array([0.0, 0.0, 0.15, 0.08, 0.0, 0.0]), RNG.uniform(size=len(seen))
    poses = T @ se3.exp(when[:, None] * motion)
    world = room_points(800)
    taken = np.array([se3.moved(se3.inverse(P), p[None])[0] for P, p in zip(poses, world, strict=True)])
    sweep = Seen(taken, np.zeros(3), when)
    moving = fit(surfels, sweep, T, gate=0.3, motion=np.zeros(6), iterations=30)
    assert np.abs(moving.motion - motion).max() < 0.006
    assert np.abs(se3.log(se3.inverse(T) @ moving.T)).max() < 0.005


def test_along_a_corridor_nothing_is_claimed_to_be_known():
    u, v = RNG.uniform(size=(2, 6000))
    sides = [np.stack([20 * u, 0 * u + y, 2 * v], axis=-1) for y in (0.0, 2.0)]
    points = np.vstack([*sides, np.stack([20 * u, 2 * v, 0 * u], axis=-1)])
    points = points + 0.01 * RNG.normal(size=points.shape) - np.array([10.0, 1.0, 0.3])
    found = fit(place(points), Seen(points[::7].copy(), np.zeros(3)), np.eye(4), gate=0.2)
    known = observable(found.information)
    assert known[3, 3] < 1e-3 * known[4, 4]


def test_the_two_faces_of_a_thin_wall_are_told_apart():
    rng = np.random.default_rng(1)
    u, v = rng.uniform(size=(2, 4000))
    floor = np.stack([4 * u - 2, 4 * v - 2, 0 * u - 0.4], axis=-1)
    end = np.stack([4 * u - 2, 0 * u + 2, 2 * v - 0.4], axis=-1)
    faces = [np.stack([0 * u + x, 4 * u - 2, 2 * v - 0.4], axis=-1) for x in (0.0, 0.1)]
    points = np.vstack([floor, end, *faces])
    points += 0.005 * rng.normal(size=points.shape)
    left, right = np.array([-1.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])
    views = np.vstack(
        [np.where(points[:8000, :1] < 0.05, left, right), np.tile(left, (4000, 1)), np.tile(right, (4000, 1))]
    )
    surfels = make_surfels(points, views, 0.3)
    walls = np.abs(surfels.normals[:, 0]) > 0.9
    assert np.abs(surfels.means[walls & (surfels.normals[:, 0] < 0), 0]).max() < 0.01
    assert np.abs(surfels.means[walls & (surfels.normals[:, 0] > 0), 0] - 0.1).max() < 0.01
    T = se3.exp(np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0]))
    seen = se3.moved(
        se3.inverse(T), np.vstack([points[8000 * 1 + 4000 :], points[:8000][points[:8000, 0] > 0.1]])
    )
    # Started 7 cm too far to the left: the left face is the nearer one, but was never seen from there.
    start = se3.exp(np.array([0.0, 0.0, 0.0, 0.93, 0.0, 0.0]))
    found = fit(surfels, Seen(seen, np.zeros(3)), start, gate=0.3)
    assert np.abs(se3.log(se3.inverse(T) @ found.T)).max() < 0.005


def test_a_floor_is_found_and_the_sensor_levelled():
    T = se3.exp(np.array([0.08, -0.1, 0.0, 0.0, 0.0, 0.0]))
    points = se3.moved(se3.inverse(T), room_points() - np.array([0.0, 0.0, 0.2]))
    floor = find_floor(points, 3.0)
    assert floor.height == pytest.approx(0.6, abs=0.01)
    upright = se3.moved(levelled(floor), points)
    inside = np.abs(upright[:, :2]).max(axis=1) < 1.0
    assert np.abs(upright[inside & (upright[:, 2] < 0.05), 2]).mean() < 0.012
    assert find_floor(np.tile([1.0, 0.0, 0.0], (500, 1)), 3.0) is None


def test_a_place_is_recognised_whatever_the_heading():
    here, yaw = room_points(4000), 1.9
    turned = se3.moved(se3.inverse(se3.exp(np.array([0, 0, yaw, 0, 0, 0]))), here)
    elsewhere = here * np.array([0.5, 1.7, 1.0]) + np.array([1.5, 2.0, 0.0])
    all_ = [descriptor(points, 8.0) for points in (here, turned, elsewhere)]
    near = dissimilarity(all_[0], all_[1])
    assert near < 0.1
    assert dissimilarity(all_[0], all_[2]) > near + 0.15
    assert Contexts(all_).like(1, np.array([0, 2]), 1, 0.5) == [0]


@pytest.mark.slow
def test_features_find_the_pose_from_nothing_and_another_room_does_not_fit():
    here = room_points(1500)
    T = se3.exp(np.array([0.0, 0.0, 2.2, 0.6, -0.4, 0.0]))
    other = room_points(1500) * np.array([1.6, 0.5, 1.0])

    def found(seen):
        start = pose_by_features(*(featured(points, 0.3) for points in (seen, here)), 0.3, seed=5)
        return fit(place(here), Seen(seen, np.zeros(3)), start, gate=0.2, iterations=8)

    for seen in (here, room_points(1500)):
        assert np.abs(se3.log(se3.inverse(T) @ found(se3.moved(se3.inverse(T), seen)).T)).max() < 0.02
    assert found(other).overlap < MIN_OVERLAP < found(se3.moved(se3.inverse(T), here)).overlap


def ring(n=12):
    """Keys around a circle with exact steps and one closing edge."""
    step = se3.exp(np.array([0.0, 0.01, 2 * np.pi / n, 1.0, 0.0, 0.02]))
    poses = [np.eye(4)]
    for _ in range(n - 1):
        poses.append(poses[-1] @ step)
    T = np.array(poses)
    edges = [Constraint(k, k + 1, step, np.diag([1e4] * 3 + [1e3] * 3), Kind.STEP) for k in range(n - 1)]
    loop = Constraint(0, n - 1, se3.inverse(T[0]) @ T[-1], 1e4 * np.eye(6), Kind.LOOP, cauchy=2.0)
    return T, [*edges, loop]


def test_the_graph_undoes_drift_and_shrugs_off_a_false_loop():
    T, edges = ring()
    drifted = T @ se3.exp(0.03 * RNG.normal(size=(len(T), 6)) * (np.arange(len(T)) > 0)[:, None])
    false = Constraint(2, 8, np.eye(4), 1e4 * np.eye(6), Kind.LOOP, cauchy=2.0)
    found = optimise(se3.SE3(drifted), [*edges, false]).matrix
    assert np.linalg.norm((found - T)[:, :3, 3], axis=1).max() < 0.05
    assert np.abs(residuals(se3.SE3(T), edges)).max() < 1e-9


def test_g2o_is_read_back_by_gtsam_and_by_the_reports(tmp_path):
    T, edges = ring()
    write_g2o(tmp_path / "g.g2o", se3.SE3(T), edges)
    graph, values = gtsam.readG2o(str(tmp_path / "g.g2o"), True)
    assert graph.size() == len(edges)
    np.testing.assert_allclose(values.atPose3(5).matrix(), T[5], atol=1e-7)
    assert graph.error(values) < 1e-6
    seen = read_g2o(tmp_path / "g.g2o")
    np.testing.assert_allclose(seen.T_map_keys.xyt, se3.planar(T).xyt, atol=1e-7)
    assert seen.edges == len(edges)


def test_the_cloud_map_holds_the_means_of_its_voxels_however_they_come():
    points = RNG.uniform(-1.0, 1.0, size=(60_000, 3))
    cloud = CloudMap(0.1, 10**6, at_once=20_000)
    for part in np.array_split(points, 7):
        cloud.add(part)
    means, counts = cloud.points()
    key = np.floor(points / 0.1).astype(int)
    _, inverse, expected = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    sums = np.zeros((len(expected), 3))
    np.add.at(sums, inverse.ravel(), points)
    np.testing.assert_array_equal(counts, expected)
    np.testing.assert_allclose(means, sums / expected[:, None], atol=1e-9)
    small = CloudMap(0.1, 2000)
    small.add(points)
    assert len(small.points()[0]) <= 2000
    assert small.voxel > 0.1


def test_the_file_of_a_cloud_has_the_same_bytes_again_and_no_lone_points(tmp_path):
    cloud = CloudMap(0.1, 10**6)
    cloud.add(np.vstack([room_points(3000), np.tile([30.0, 0.0, 5.0], (4, 1))]))
    points = finished(cloud)
    assert points[:, 0].max() < 5.0
    save_ply(tmp_path / "a.ply", points)
    save_ply(tmp_path / "b.ply", finished(cloud))
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()
    np.testing.assert_allclose(read_ply(tmp_path / "a.ply"), points, atol=1e-4)


@pytest.mark.slow
def test_open3d_adds_up_in_one_order():
    o3d, rng = open3d(), np.random.default_rng(0)
    registration = o3d.pipelines.registration
    flat = np.array([[1.0, 1.0, 0.01], [1.0, 0.01, 1.0], [0.01, 1.0, 1.0]])
    points = 5.0 * rng.uniform(-1.0, 1.0, (2, 9000, 3)) * np.repeat(flat, 3000, axis=0)
    source, target = (o3d.geometry.PointCloud(o3d.utility.Vector3dVector(xyz)) for xyz in points)
    target.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(0.8, 30))
    start = se3.exp(np.array([0.0, 0.0, 0.03, 0.2, 0.1, 0.05]))
    plane = registration.TransformationEstimationPointToPlane()
    found = {
        registration.registration_icp(source, target, 0.6, start, plane).transformation.tobytes()
        for _ in range(40)
    }
    assert len(found) == 1


def test_a_cloud_that_cannot_be_written_is_an_error_and_prints_nothing(tmp_path, capfd):
    with files_below(1000), pytest.raises(OSError, match="too large"):
        save_ply(tmp_path / "cut.ply", np.ones((100, 3)))
    assert capfd.readouterr() == ("", "")


def test_a_cloud_without_points_is_a_file_too(tmp_path):
    save_ply(tmp_path / "none.ply", np.zeros((0, 3)))
    assert read_ply(tmp_path / "none.ply").shape == (0, 3)


def test_a_beam_frees_only_the_part_of_its_way_that_lies_in_the_band():
    config = SliceConfig.model_validate({"low_m": 0.1, "high_m": 0.3, "grid": {"min_hits": 1}})
    grid = SliceGrid(config, np.array([-1.0, -1.0]), np.array([5.0, 1.0]))
    # From 0.5 m up down to the floor 2.5 m ahead: in the band between 1 m and 2 m.
    grid.add(np.array([[2.5, 0.02, 0.0], [4.02, -0.52, 0.2]]), np.array([0.0, 0.02, 0.5]), 0.0)
    drawn = grid.grid()
    along = drawn.value_at(np.stack([np.arange(0.125, 2.6, 0.25), np.full(10, 0.02)], axis=-1))
    assert along.tolist() == [-1] * 4 + [0] * 4 + [-1] * 2
    assert drawn.value_at(np.array([[4.02, -0.52]]))[0] == 100
