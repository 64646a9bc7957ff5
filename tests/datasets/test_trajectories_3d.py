"""Trajectories of other systems: three formats with one content; other files are refused in one line."""

import numpy as np
import pytest

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.other_systems import SystemFiles, coverage, gaps, load_system
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.se3 import exp, inverse, lifted, quaternions
from turtlebag.datasets.trajectories import save_tum_3d
from turtlebag.datasets.trajectories_3d import Trajectory3D, read_trajectory_3d

NO_SCANS = np.zeros(0, dtype=np.int64)
STAMPS = 1_403_636_579_758_555_392 + np.arange(8, dtype=np.int64) * 50_000_000
POSES = exp(np.linspace([0.1, -0.4, 0.0, 0, 0, 0], [0.7, 0.2, 3.0, 5, -2, 1], 8))


def write_kitti(path, T):
    path.write_text("".join(" ".join(f"{x:.9f}" for x in pose[:3].ravel()) + "\n" for pose in T))


def write_euroc(path, stamps, T):
    rows = ["#timestamp [ns],p_x,p_y,p_z,q_w,q_x,q_y,q_z,v_x"]
    for stamp, xyz, (x, y, z, w) in zip(stamps, T[:, :3, 3], quaternions(T), strict=True):
        rows.append(",".join([str(stamp), *(f"{v:.9f}" for v in (*xyz, w, x, y, z)), "0.5"]))
    path.write_text("\n".join(rows) + "\n")


def test_tum_kitti_and_euroc_hold_the_same_poses(tmp_path):
    save_tum_3d(STAMPS, POSES, tmp_path / "a.tum")
    write_kitti(tmp_path / "a.txt", POSES)
    write_euroc(tmp_path / "a.csv", STAMPS, POSES)
    (tmp_path / "times").write_text("".join(f"{s // 10**9}.{s % 10**9:09d}\n" for s in STAMPS.tolist()))
    found = [
        read_trajectory_3d(tmp_path / "a.tum", None, NO_SCANS),
        read_trajectory_3d(tmp_path / "a.csv", None, NO_SCANS),
        read_trajectory_3d(tmp_path / "a.txt", tmp_path / "times", NO_SCANS),
        read_trajectory_3d(tmp_path / "a.txt", None, STAMPS),
    ]
    for track in found:
        np.testing.assert_array_equal(track.stamps_ns, STAMPS)
        np.testing.assert_allclose(track.T, POSES, atol=1e-8)


def test_times_have_to_fit_their_poses(tmp_path):
    write_kitti(tmp_path / "a.txt", POSES)
    (tmp_path / "times").write_text("1\n2\n")
    with pytest.raises(InputError, match="2 times for the 8 poses"):
        read_trajectory_3d(tmp_path / "a.txt", tmp_path / "times", STAMPS)
    (tmp_path / "times").write_text("1 2\n" * 8)
    with pytest.raises(InputError, match="line 1: expected one time"):
        read_trajectory_3d(tmp_path / "a.txt", tmp_path / "times", STAMPS)
    save_tum_3d(STAMPS, POSES, tmp_path / "a.tum")
    with pytest.raises(InputError, match="leave out --system-times"):
        read_trajectory_3d(tmp_path / "a.tum", tmp_path / "times", STAMPS)


def driven(n=40):
    angle = np.linspace(0.0, 3.0, n)
    return lifted(SE2.from_xyt(5.0 * np.sin(angle), 3.0 - 3.0 * np.cos(angle), angle))


def test_a_camera_s_axes_a_place_on_the_robot_and_a_clock_are_undone(tmp_path):
    stamps = np.arange(40, dtype=np.int64) * 10**8
    T_base = driven()
    base = SE2.from_xyt(0.2, -0.1, 0.3)
    T_sensor = inverse(lifted(base)) @ T_base @ lifted(base)  # its own start is its origin
    forward, left, up = np.eye(3)
    T_camera_robot = np.eye(4)
    T_camera_robot[:3, :3] = np.stack([-left, -up, forward])  # rows: x right, y down, z forward
    T_camera = T_camera_robot @ T_sensor @ T_camera_robot.T
    save_tum_3d(stamps - 7 * 10**9, T_camera, tmp_path / "camera.tum")
    system = load_system(SystemFiles("c", tmp_path / "camera.tum", base=tuple(base.xyt), shift_s=7.0), stamps)
    np.testing.assert_array_equal(system.track.stamps_ns, stamps)
    np.testing.assert_allclose(system.track.T, inverse(lifted(base)) @ T_base, atol=1e-8)
    assert [word in " ".join(system.notes) for word in ("7 s", "as a camera's does", "0.2, -0.1 m")] == [
        True
    ] * 3
    save_tum_3d(stamps, T_base, tmp_path / "plain.tum")
    assert load_system(SystemFiles("p", tmp_path / "plain.tum"), stamps).notes == ()


def test_gaps_are_stretches_longer_than_usual_and_do_not_count_as_covered():
    stamps = np.array([*range(0, 50), *range(100, 150)], dtype=np.int64) * 200_000_000
    assert gaps(stamps) == [(49 * 200_000_000, 100 * 200_000_000)]
    assert coverage(stamps, 0, 149 * 200_000_000) == pytest.approx(98 / 149)
    assert coverage(stamps, 0, 298 * 200_000_000) == pytest.approx(49 / 149)
    sparse = np.arange(10, dtype=np.int64) * 3_000_000_000
    assert gaps(sparse) == []
    assert coverage(sparse, 0, 27_000_000_000) == 1.0


def test_repeated_stamps_are_left_out_and_the_rest_is_put_in_order():
    track = Trajectory3D(np.array([30, 10, 30, 20], dtype=np.int64), POSES[:4]).in_time()
    assert track.stamps_ns.tolist() == [10, 20, 30]
    np.testing.assert_array_equal(track.T, POSES[[1, 3, 0]])


def test_what_is_corrected_in_another_systems_trajectory_is_noted(tmp_path):
    file = tmp_path / "a.tum"
    file.write_text("".join(f"{t} {t} 0 0 0 0 0 1\n" for t in (1, 2, 2, 3)))
    system = load_system(SystemFiles("a", file, base=(0.5, 0.0, 0.0)), np.arange(4))
    assert system.track is not None
    np.testing.assert_allclose(system.track.T[:, 0, 3], [0.5, 1.5, 2.5])
    assert system.notes == (
        "1 of its poses repeat a stamp and were left out.",
        "It tracks a point at 0.5, 0 m, 0 rad on the robot; moved to the base.",
    )
