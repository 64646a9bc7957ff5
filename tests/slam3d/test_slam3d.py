"""3D mapping by numbers: a drive around a room, with and without wheels, damaged, and with unknown
mounting."""

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.drives3d import Drive3d, changed, make_drive, without_wheels
from turtlebag.datasets import se3
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import FREE, OCCUPIED
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Cloud
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind
from turtlebag.pipeline.slam3d.loops import Loop3dConfig, close_loops
from turtlebag.pipeline.slam3d.slam3d import Slam3dConfig, run_slam_3d
from turtlebag.reports.metrics.trajectory import ate

pytestmark = [pytest.mark.slow, pytest.mark.longest]

FEW = Slam3dConfig.model_validate(
    {
        "loops": {"every": 8},
        "refine": {"rounds": 2},
    }
)
"""The whole pipeline, with less work in it."""


def hung_elsewhere(drive, T_base_lidar):
    """The log of a lidar mounted at `T_base_lidar` (4, 4) in a bag that does not say so."""
    T_new_old = se3.inverse(T_base_lidar) @ drive.recording.T_base_lidar
    moved = changed(drive, lambda _, cloud: Cloud(se3.moved(T_new_old, cloud.points), cloud.times))
    recording = replace(moved.recording, T_base_lidar=np.eye(4), mounted=False)
    return Drive3d(recording, drive.truth)


@pytest.fixture(scope="module")
def drive():
    """Seen by half the columns that such a lidar has, which show the room as well."""
    return make_drive("room", v=0.9, w=1.2, n_azimuths=180)


def shortened(drive):
    """Its first fourteen seconds."""
    return changed(drive, lambda k, cloud: cloud if k < 70 else None)


@pytest.fixture(scope="module")
def short(drive):
    return shortened(drive)


@pytest.fixture(scope="module")
def mapped(drive):
    return run_slam_3d(drive.recording, FEW)


def error(drive, result, align=False):
    return ate(result.trajectory, drive.truth, align=align)


def test_poses_are_right_to_millimetres_where_the_wheels_are_off_by_a_metre(drive, mapped):
    odometry = replace(drive.truth, poses=drive.recording.T_odom_base)
    assert ate(odometry, drive.truth, align=False)["max"] > 0.8
    assert error(drive, mapped)["rmse"] < 0.005
    assert error(drive, mapped)["max"] < 0.02
    np.testing.assert_array_equal(mapped.trajectory.stamps_ns, drive.recording.stamps_ns)
    assert np.abs(mapped.T_map_base[:, 2, 3]).max() < 0.02
    assert mapped.check.verdict == "good"
    assert any(loop.accepted for loop in mapped.loops)


def test_a_place_that_drift_has_carried_out_of_reach_is_recognised_by_its_looks(mapped):
    track, T = mapped.track, mapped.T_map_keys.matrix
    carried = T.copy()
    carried[41:] = se3.exp(np.array([0.0, 0.0, 0.5, 3.0, 2.0, 0.0])) @ T[41:]
    known = [1e6 if k != 40 else 0.02 for k in range(len(T) - 1)]
    steps = [
        Constraint(k, k + 1, se3.inverse(carried[k]) @ carried[k + 1], weight * np.eye(6), Kind.STEP)
        for k, weight in enumerate(known)
    ]
    finder, recognised = close_loops(track.places, carried, steps, mapped.setup.voxel, Loop3dConfig(every=4))
    assert sum(loop.accepted for loop in recognised) >= 2
    for loop in (one for one in recognised if one.accepted):
        assert np.abs(se3.log(loop.T_j_i) - se3.log(se3.inverse(T[loop.j]) @ T[loop.i])).max() < 0.02
    assert np.abs(se3.log(se3.inverse(T) @ finder.T)).max() < 0.05
    alone, unrecognised = close_loops(
        track.places, carried, steps, mapped.setup.voxel, Loop3dConfig(every=4, appearance=False)
    )
    assert unrecognised == []
    assert np.abs(se3.log(se3.inverse(T) @ alone.T)).max() > 1.0


def test_the_cloud_lies_on_the_true_surfaces(mapped):
    points = mapped.points + np.array([1.5, 1.2, 0.0])
    low = points[points[:, 2] < 0.6]
    x, y, z = low.T
    to_walls = np.min(np.abs([x, x - 8.0, y, y - 6.0]), axis=0)
    inside_room = to_walls[(x > 2.0) & (x < 7.5) & (z > 0.1) & (np.hypot(x - 6.5, y - 2.0) > 0.4)]
    assert np.abs(z[z < 0.05]).mean() < 0.005
    assert np.percentile(inside_room[inside_room < 0.5], 95) < 0.02


def test_the_slice_shows_what_stands_in_the_band_and_is_free_below_tables_and_beams(mapped):
    def at(x, y):
        return int(mapped.grid.value_at(np.array([[x - 1.5, y - 1.2]]))[0])

    assert at(5.0, 6.02) == OCCUPIED or at(5.0, 5.98) == OCCUPIED
    assert at(4.0, 3.0) == FREE  # under the table
    assert at(3.0, 5.0) == FREE  # under the beam
    legs = [(3.6 + 0.8 * (k % 2), 2.6 + 0.8 * (k // 2)) for k in range(4)]
    near = [max(at(x + dx, y + dy) for dx in (-0.05, 0, 0.05) for dy in (-0.05, 0, 0.05)) for x, y in legs]
    assert near == [OCCUPIED] * 4


@pytest.mark.parametrize("scans", [6, 8, 11, 14, 17])
def test_few_keys_are_held_together_by_what_their_clouds_saw(drive, scans):
    """Wheels a fifth too long: refinement must not leave the way between keys to them."""
    log, first = drive.recording, slice(0, scans)
    long = np.array([1.2, 1.2, 1.0])
    short = replace(
        log,
        stamps_ns=log.stamps_ns[first],
        clouds=tuple(log.clouds)[first],
        T_odom_base=SE2(log.T_odom_base.xyt[first] * long),
        odometry=replace(log.odometry, poses=SE2(log.odometry.poses.xyt * long)),
    )
    result = run_slam_3d(short, FEW)
    off = result.trajectory.poses.xy - drive.truth.poses.xy[first]
    assert np.linalg.norm(off, axis=1).max() < 0.03, len(result.track.keys)


def test_the_clouds_alone_are_enough(short):
    alone = without_wheels(short)
    result = run_slam_3d(alone.recording, FEW)
    assert error(alone, result)["rmse"] < 0.03
    assert error(alone, result, align=True)["rmse"] < 0.02


def test_a_lidar_that_hangs_tilted_where_the_bag_does_not_say_stands_upright_in_the_map(short):
    T = se3.exp(np.array([0.05, 0.12, 0.0, 0.0, 0.0, 0.0]))
    T[2, 3] = 0.36
    hung = hung_elsewhere(without_wheels(short), T)
    result = run_slam_3d(
        hung.recording, FEW.model_copy(update={"refine": FEW.refine.model_copy(update={"rounds": 0})})
    )
    assert result.setup.T_base_lidar[2, 3] == pytest.approx(0.36, abs=0.02)
    assert "0.3" in result.setup.notes[0]
    assert error(hung, result, align=True)["rmse"] < 0.03
    tilt = np.arccos(np.clip(result.T_map_base[:, 2, 2], -1.0, 1.0))
    assert tilt.max() < 0.05


def test_missing_empty_and_foul_clouds_do_no_harm_beside_wheels(short):
    rng = np.random.default_rng(0)

    def foul(k, cloud):
        if 30 <= k < 45:
            return None  # three seconds
        if k % 9 == 4:
            return Cloud(cloud.points[:0], cloud.times[:0])
        if k % 9 == 6:
            far = rng.normal(size=cloud.points.shape) * 1e30
            return Cloud(np.vstack([cloud.points, far]), np.tile(cloud.times, 2))
        return cloud

    bad = changed(short, foul)
    result = run_slam_3d(bad.recording, FEW)
    assert len(result.trajectory) == len(bad.recording)
    assert error(bad, result)["rmse"] < 0.01
    assert np.all(np.isfinite(result.T_map_base))


def test_three_seconds_without_clouds_or_wheels_are_called_doubtful(short):
    """What follows is matched at a guess that is far off, and fits there."""
    gap = without_wheels(changed(short, lambda k, cloud: None if 30 <= k < 45 else cloud))
    result = run_slam_3d(gap.recording, FEW)
    assert error(gap, result, align=True)["max"] > 0.5
    assert [reason for reason in result.check.reasons if "before cloud 30" in reason]


def test_stamps_that_go_back_keep_file_order_and_the_map(short):
    recording = short.recording
    stamps = recording.stamps_ns.copy()
    stamps[40:] -= 5 * 10**9
    back = replace(recording, stamps_ns=stamps, odometry=None)
    result = run_slam_3d(
        back, FEW.model_copy(update={"loops": FEW.loops.model_copy(update={"enabled": False})})
    )
    np.testing.assert_array_equal(result.trajectory.stamps_ns, stamps)
    found = replace(result.trajectory, stamps_ns=short.truth.stamps_ns)
    assert ate(found, short.truth, align=False)["rmse"] < 0.05


def test_a_log_without_points_is_one_clear_line(drive):
    empty = changed(drive, lambda k, cloud: Cloud(cloud.points[:3], cloud.times[:3]))
    with pytest.raises(InputError, match="no cloud has enough points"):
        run_slam_3d(empty.recording, FEW)


def test_kiss_icp_may_place_the_clouds():
    """Sixteen rings matched against themselves leave it off by decimetres, with all of the columns, too."""
    short = shortened(make_drive("room", v=0.9, w=1.2))
    result = run_slam_3d(short.recording, FEW.model_copy(update={"front_end": "kiss_icp"}))
    assert len(result.trajectory) == len(short.recording)
    assert 0.01 < error(short, result)["rmse"] < 1.0


def test_odometry_alone_draws_along_the_wheels(short):
    result = run_slam_3d(short.recording, Slam3dConfig(sensors="odometry"))
    np.testing.assert_allclose(result.trajectory.poses.xyt, short.recording.T_odom_base.xyt, atol=1e-9)
    with pytest.raises(InputError, match="no odometry"):
        run_slam_3d(without_wheels(short).recording, Slam3dConfig(sensors="odometry"))
