"""Maps of several lidars: each scan has its own mounting and geometry, the graph is one."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tests.helpers.slam_rooms import ROOM, around_the_room, drifted
from tests.helpers.two_lidars import HALF, REAR, WIDE, two_lidars
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.lidars import of_each_lidar
from turtlebag.datasets.se2 import SE2, wrap
from turtlebag.pipeline.slam.mapper import SlamConfig, run_slam
from turtlebag.pipeline.slam.online.mapper import Mapper
from turtlebag.pipeline.slam.progress import no_progress
from turtlebag.pipeline.slam.scans.clouds import make_clouds
from turtlebag.pipeline.slam.session_file import FILE, load_session, save_session
from turtlebag.pipeline.slam.sessions import joined_recording

POSES = around_the_room(200)


def off_m(found, poses=POSES):
    """How far found poses are from the true ones, from the first on [m]."""
    moved = (SE2(poses[0]) @ SE2(found.xyt[0]).inverse()) @ found
    return np.linalg.norm(moved.xy - poses[:, :2], axis=1)


def walls_of(walls, spacing=0.01):
    ends = walls.reshape(-1, 2, 2)
    share = np.linspace(0.0, 1.0, round(10.0 / spacing))[:, None]
    return cKDTree(np.concatenate([a + share * (b - a) for a, b in ends]))


def test_each_scan_is_placed_by_its_own_lidar():
    log = two_lidars(POSES[:20], front=WIDE, noise=0.0)
    clouds, tree = make_clouds(log, 8.0), walls_of(ROOM)
    assert log.lidar_of.tolist() == [0, 1] * 10
    for scan, pose in enumerate(POSES[:20]):
        distance, _ = tree.query(SE2(pose) @ clouds.of(scan))
        assert len(distance) > 150
        assert distance.max() < 0.01
    for number, (rows, part) in enumerate(log.parts()):
        alone = make_clouds(part, 8.0)
        assert part.lidar == (WIDE, HALF)[number]
        for k, row in enumerate(rows.tolist()):
            np.testing.assert_array_equal(clouds.of(row), alone.of(k))
            assert clouds.lines(row) == alone.lines(k)
    np.testing.assert_array_equal(clouds.origin[1], REAR.xy)
    assert log.scan(1).lidar == HALF
    assert log.scan(1).ranges.shape == (181,)
    assert log.scan(1).sensor == 1


@pytest.mark.parametrize("wait_s", [0.1, 0.01])
@pytest.mark.parametrize("wheels", [True, False])
def test_a_front_and_a_rear_lidar_of_half_a_view_make_one_map(wheels, wait_s, tmp_path):
    odometry = drifted(POSES, scale=1.01, bias=0.001) if wheels else None
    log = two_lidars(POSES, odometry=odometry, wait_s=wait_s)
    result = run_slam(log, SlamConfig(), no_progress)
    np.testing.assert_array_equal(result.trajectory.stamps_ns, log.stamps_ns)
    assert off_m(result.trajectory.poses).max() < (0.03 if wheels else 0.06)
    of_key = np.bincount(log.lidar_of[result.keys])
    assert of_key.min() > 0.4 * len(result.keys)
    assert result.check.reasons == ()
    save_session(tmp_path / FILE, result.session, SlamConfig())
    again, _ = load_session(tmp_path)
    assert all(
        a.same(b) and a.topic == b.topic for a, b in zip(again.recording.lidars, log.lidars, strict=True)
    )
    np.testing.assert_array_equal(again.recording.lidar_of, log.lidar_of)
    np.testing.assert_array_equal(again.key_scans.clouds.points, result.session.key_scans.clouds.points)


def test_while_driving_both_lidars_are_mapped():
    log = two_lidars(POSES, odometry=drifted(POSES, scale=1.01, bias=0.001))
    mapper = Mapper(log.lidar, log.T_base_lidar, others=log.others)
    for k in range(len(log)):
        mapper.add(log.scan(k), log.T_odom_base[k])
    assert off_m(mapper.trajectory.poses).max() < 0.05
    back = mapper.recording()
    np.testing.assert_array_equal(back.lidar_of, log.lidar_of)
    np.testing.assert_array_equal(back.ranges, log.ranges)


def test_what_is_corrected_of_a_lidar_is_said_of_it_and_the_scans_keep_their_order():
    log = two_lidars(POSES[:10], front=WIDE, odometry=POSES[:10])

    def noted(part):
        over = replace(part, lidar=part.lidar.turned_over(), notes=(*part.notes, "turned over"))
        return over if part.topic == "/scan_rear" else part

    found = of_each_lidar(log, noted)
    assert found.notes == ("/scan_rear: turned over",)
    assert (found.lidars[0].spec, found.lidars[1].spec) == (WIDE, HALF.turned_over())
    np.testing.assert_array_equal(found.ranges, log.ranges)
    np.testing.assert_array_equal(found.stamps_ns, log.stamps_ns)
    np.testing.assert_array_equal(found.T_odom_base.xyt, log.T_odom_base.xyt)


def test_a_recording_of_fewer_lidars_does_not_join():
    both = two_lidars(POSES[:4])
    with pytest.raises(InputError, match="its lidar differs from that of test"):
        joined_recording([both, both.parts()[0][1]])
    assert len(joined_recording([both, both]).lidar_of) == 8


def test_a_rear_lidar_that_sits_elsewhere_than_declared_is_found_by_its_own_scans():
    log = two_lidars(POSES, front=WIDE, rear=WIDE, odometry=POSES)
    declared = REAR.xyt + np.array([0.04, -0.03, 0.03])
    wrong = replace(log, others=(replace(log.others[0], T_base_lidar=SE2(declared)),))
    setup = run_slam(wrong, SlamConfig(), no_progress).session.setup
    found = [setup[f"lidar_{name}_2"] for name in ("x", "y", "yaw")]
    off = [one.value - true for one, true in zip(found, REAR.xyt.tolist(), strict=True)]
    assert np.abs(np.array(off[:2])).max() < 0.01
    assert abs(wrap(off[2])) < 0.01
    assert [one.declared for one in found] == pytest.approx(declared.tolist())
    assert setup.lidar_error is None
    np.testing.assert_allclose(setup.others[0], [-0.04, 0.03, -0.03], atol=0.01)
