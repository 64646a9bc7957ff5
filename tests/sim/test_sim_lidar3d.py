"""The 3D lidar: sides, tops, undersides and the floor; as the planar one at its height; in the bag."""

import dataclasses
from contextlib import closing

import numpy as np
import pytest

from turtlebag.datasets.bags.point_clouds import load_clouds
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.stages.record import Scene, record
from turtlebag.sim import bullet
from turtlebag.sim.lidar import Lidar, LidarConfig
from turtlebag.sim.lidar3d import Lidar3d
from turtlebag.sim.movers import Mover
from turtlebag.sim.physics import Physics, PhysicsConfig
from turtlebag.sim.robots import load_robot
from turtlebag.sim.shapes import ball, box, cylinder, mesh
from turtlebag.sim.simulator import SimConfig, Simulator
from turtlebag.sim.worlds import load_world

ROBOT = load_robot("waffle_pi_3d")
MOUNT = ROBOT.lidar3d


def sensor(solids, mount=MOUNT):
    return Lidar3d(solids, mount, 0.0, np.random.default_rng(0))


@pytest.mark.slow
def test_beams_meet_floor_side_top_and_underside():
    h = MOUNT.position[2]
    mount = MOUNT.model_copy(update={"position": (0.0, 0.0, h), "elevation_deg": (-45.0, 45.0), "n_rings": 3})
    still = np.zeros((1, 3))
    floor = sensor([], mount).true_ranges(still)
    assert floor[0] == pytest.approx([h * np.sqrt(2.0), np.inf, np.inf])
    wall = sensor([box("w", (2.0, 0.0), (1.0, 8.0), 0.0, (0.0, 2.5))], mount).true_ranges(still)
    assert wall[0] == pytest.approx([h * np.sqrt(2.0), 1.5, 1.5 * np.sqrt(2.0)])
    slab = sensor([box("s", (0.3, 0.0), (0.5, 0.5), 0.0, (0.0, 0.2))], mount).true_ranges(still)
    assert slab[0, 0] == pytest.approx((h - 0.2) * np.sqrt(2.0))
    table = sensor([box("t", (0.6, 0.0), (1.0, 1.0), 0.0, (0.7, 0.75))], mount).true_ranges(still)
    assert table[0, 1:] == pytest.approx([np.inf, (0.7 - h) * np.sqrt(2.0)])


def test_level_beams_agree_with_the_planar_lidar():
    world = load_world("turtlebot3_house")
    planar = Lidar(world.shapes, ROBOT, LidarConfig(noise="none"), np.random.default_rng(0))
    update = {
        "position": (*ROBOT.lidar.pose[:2], ROBOT.lidar.height),
        "elevation_deg": (0.0, 1.0),
        "n_rings": 2,
        "n_azimuths": 360,
    }
    level = sensor(world.shapes, MOUNT.model_copy(update=update))
    poses = np.array([[-3.0, 1.0, 0.1], [-2.9, 1.02, 0.3]])
    near, _ = planar.true_ranges(poses)
    ok = np.isfinite(near)
    np.testing.assert_allclose(level.true_ranges(poses)[ok, 0], near[ok], atol=1e-9)


def test_beams_agree_with_bullets_rays():
    world = load_world("turtlebot3_house")
    lidar, pose = sensor(world.shapes), np.array([[-4.0, 3.4, 0.7]])
    ranges = lidar.true_ranges(pose)
    elevations = np.deg2rad(np.linspace(-15, 15, 16))
    azimuths = pose[0, 2] + np.arange(720) * (2 * np.pi / 720)
    c, s = np.cos(pose[0, 2]), np.sin(pose[0, 2])
    x, y, z = MOUNT.position
    origin = np.array([pose[0, 0] + c * x - s * y, pose[0, 1] + s * x + c * y, z])
    directions = np.stack(
        [
            np.cos(azimuths)[:, None] * np.cos(elevations),
            np.sin(azimuths)[:, None] * np.cos(elevations),
            np.broadcast_to(np.sin(elevations), (720, 16)),
        ],
        axis=-1,
    )[::8].reshape(-1, 3)
    tall = ROBOT.model_copy(
        update={"height": 9.0}
    )  # so that lintels and table tops are in Bullet's world too
    with closing(Physics(world.shapes, [], tall, PhysicsConfig())) as physics:
        physics.reset(world.spawn)
        hits = bullet.rayTestBatch(
            np.tile(origin, (len(directions), 1)).tolist(),
            (origin + 20.0 * directions).tolist(),
            physicsClientId=physics.client,
        )
    expected = np.array([20.0 * hit[2] if hit[0] >= 0 else np.inf for hit in hits])
    got = ranges[::8].reshape(-1)
    got = np.where(got > 20.0, np.inf, got)
    agree = np.isclose(got, expected, atol=5e-3) | (np.isinf(got) & np.isinf(expected))
    assert agree.mean() > 0.985  # grazing beams, and the robot itself at its spawn
    assert np.isfinite(expected).mean() > 0.8  # the rest leaves over the walls


@pytest.mark.slow
def test_a_recording_holds_clouds_with_times_in_their_own_frame(tmp_path):
    script = tmp_path / "s.yaml"
    script.write_text("name: s\nsteps: [{drive: 0.2}]\n")
    assert record(Scene.load("turtlebot3_house", "waffle_pi_3d"), str(script), Output(tmp_path / "rec")) == 0
    recording = load_clouds(tmp_path / "rec" / "bag")
    assert len(recording) > 5
    np.testing.assert_array_equal(np.diff(recording.stamps_ns), 200_000_000)
    cloud = next(iter(recording.clouds))
    assert cloud.points.shape[0] > 5000
    assert 0.0 <= cloud.times.min() < cloud.times.max() < 0.2
    assert recording.T_base_lidar[2, 3] == pytest.approx(0.36, abs=1e-6)
    # The floor is where it should be.
    low = cloud.points[cloud.points[:, 2] < -0.3]
    assert np.abs(low[:, 2] + 0.36).mean() < 0.01


def brick(name, center, size):
    """A box as a mesh of twelve triangles."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    corners = corners * np.array(size) + np.array(center)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    return mesh(name, corners[np.array(faces)])


@pytest.mark.slow
def test_a_mesh_is_seen_as_the_same_box_is():
    spots = [((2.0, 0.5, 0.4), (0.6, 0.8, 0.8)), ((-1.5, 1.0, 0.9), (0.5, 0.5, 0.3))]
    boxes = [box("b", c[:2], s[:2], 0.0, (c[2] - s[2] / 2, c[2] + s[2] / 2)) for c, s in spots]
    pose = np.array([[0.1, -0.2, 0.3]])
    expected = sensor(boxes).true_ranges(pose)
    found = sensor([brick("m", c, s) for c, s in spots]).true_ranges(pose)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert (expected < sensor([]).true_ranges(pose)).sum() > 500


def test_points_on_a_ball_lie_on_it():
    centre = np.array([1.5, 0.4, 0.5])
    lidar, pose = sensor([ball("b", tuple(centre), 0.4)]), np.zeros((1, 3))
    cloud = lidar.measure(pose)
    points = cloud.points + np.array(MOUNT.position)
    on = points[points[:, 2] > 0.01]
    assert len(on) > 300
    np.testing.assert_allclose(np.linalg.norm(on - centre, axis=1), 0.4, atol=1e-9)
    assert np.all((on - centre) @ (np.array(MOUNT.position) - centre) > 0.0)  # on this side of it


def test_a_mover_is_seen_where_it_stands_in_each_step():
    away = np.array([[0.0, 1.5], [0.0, 9.0]])
    person = Mover(solid=cylinder("person", (0.0, 0.0), 0.2, (0.0, 1.5)), path=away, speed=1.0)
    world = dataclasses.replace(load_world("empty"), movers=(person,))
    config = SimConfig(lidar=LidarConfig(noise="none"))
    seen = []
    with Simulator(world, ROBOT, config) as simulator:
        simulator.reset(SE2.from_xyt(0.0, 0.0, 0.0))
        for _ in range(24):
            cloud = simulator.step(Twist()).cloud
            if cloud is not None:
                points = cloud[1].points + np.array(MOUNT.position)
                seen.append(points[points[:, 2] > 0.3])
    # A quarter turn into each sweep, so 50 ms after its stamp: it has gone one control step by then.
    near = np.array([points[:, 1].min() for points in seen])
    np.testing.assert_allclose(near, 1.3 + 0.2 * np.arange(4) + 2 / 30, atol=0.04)
    np.testing.assert_allclose(np.diff(near), 0.2, atol=0.005)
    assert all(np.abs(points[:, 0]).max() < 0.21 and len(points) > 50 for points in seen)


def test_each_beam_sees_what_moves_where_it_stood_in_that_control_step():
    post = cylinder("post", (0.0, 0.0), 0.3, (0.0, 2.0))
    mover = Mover(post, np.array([[-1.5, -2.0], [-1.5, 2.0]]), speed=2.0)
    world = dataclasses.replace(load_world("empty"), movers=(mover,))
    with Simulator(world, ROBOT, SimConfig(sensors="clean"), 1) as simulator:
        simulator.reset()
        stood, cloud = [simulator.surroundings.movers[0].position], None
        while cloud is None:
            seen = simulator.step(Twist())
            stood.append(simulator.surroundings.movers[0].position)
            cloud = seen.cloud
    points = cloud[1].points
    lidar = np.array(MOUNT.position)
    on_it = points[:, 2] + lidar[2] > 0.05
    step = np.floor(cloud[1].times[on_it] * 30.0).astype(int)
    there = (simulator.truth.T_world_base @ (points[on_it, :2] + lidar[:2])) - np.array(stood)[step + 1]
    assert len(there) > 50
    np.testing.assert_allclose(np.hypot(*there.T), 0.3, atol=0.04)
