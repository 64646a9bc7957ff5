"""TUM files keep stamps exactly and poses to the last digit that matters."""

import csv

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.trajectories import (
    COVARIANCES,
    load_tum,
    save_covariances,
    save_tum,
    stamp_from_text,
    stamp_text,
)
from turtlebag.datasets.trajectories_3d import read_trajectory_3d
from turtlebag.datasets.types import Trajectory


@given(st.integers(0, 2**61))
def test_stamps_survive_text_exactly(stamp):
    text = stamp_text(stamp)
    assert stamp_from_text(text) == stamp
    assert len(text.partition(".")[2]) in (6, 9)


def test_carmen_stamps_keep_their_six_decimals():
    assert stamp_text(stamp_from_text("976052857.337530")) == "976052857.337530"


def test_round_trip(tmp_path):
    poses = SE2.from_xyt([0.0, 1.5], [-2.0, 1e-4], [3.1, -3.1])
    save_tum(Trajectory(np.array([0, 200_000_000]), poses), tmp_path / "t.tum")
    loaded = load_tum(tmp_path / "t.tum")
    np.testing.assert_array_equal(loaded.stamps_ns, [0, 200_000_000])
    np.testing.assert_allclose(loaded.poses.xyt, poses.xyt, atol=1e-9)


def test_poses_and_their_covariances_are_numbers_by_column(tmp_path):
    root = np.random.default_rng(1).standard_normal((2, 3, 3))
    covariance = root @ root.transpose(0, 2, 1)
    poses = SE2.from_xyt(np.array([1.0, 2.0]), np.array([-3.0, 0.5]), np.array([0.1, -3.0]))
    save_covariances(Trajectory(np.array([1_500_000_000, 2_000_000_001]), poses), covariance, tmp_path)
    with (tmp_path / COVARIANCES).open() as file:
        rows = list(csv.DictReader(file))
    assert [row.pop("stamp") for row in rows] == ["1.500000", "2.000000001"]
    assert list(rows[0]) == ["x", "y", "yaw", "xx", "xy", "xyaw", "yy", "yyaw", "yawyaw"]
    found = np.array([[float(value) for value in row.values()] for row in rows])
    np.testing.assert_allclose(found[:, :3], poses.xyt)
    np.testing.assert_allclose(found[:, 3:], covariance[:, *np.triu_indices(3)])


def test_stamps_out_of_order_stay_in_file_order(tmp_path):
    save_tum(Trajectory(np.array([5, 3]), SE2.identity(2)), tmp_path / "t.tum")
    np.testing.assert_array_equal(load_tum(tmp_path / "t.tum").stamps_ns, [5, 3])


def test_interpolation_is_linear_between_and_held_beyond_the_ends():
    trajectory = Trajectory(np.array([0, 10]), SE2.from_xyt([0.0, 1.0], [0.0, 0.0], [0.0, 1.0]))
    at = trajectory.at(np.array([-5, 0, 5, 10, 99]))
    np.testing.assert_allclose(at.x, [0, 0, 0.5, 1, 1])
    np.testing.assert_allclose(at.yaw, [0, 0, 0.5, 1, 1])


def test_interpolation_refuses_stamps_that_go_back():
    with pytest.raises(ValueError, match="increasing"):
        Trajectory(np.array([5, 3]), SE2.identity(2)).at(np.array([4]))


def test_a_single_pose_is_held_everywhere():
    assert Trajectory(np.array([5]), SE2.from_xyt([1.0], [2.0], [0.5])).at(np.array([0, 9])).x.tolist() == [
        1,
        1,
    ]


def tum_text(xyt, order="xyzw", tilt=0.0):
    lines = []
    for k, (x, y, yaw) in enumerate(xyt):
        q = {"x": tilt, "y": 0.0, "z": np.sin(yaw / 2.0), "w": np.cos(yaw / 2.0)}
        lines.append(f"{k} {x} {y} 0 {' '.join(str(q[axis]) for axis in order)}")
    return "\n".join(lines) + "\n"


YAWS = np.linspace(0.0, 3.0, 31)
ARC = [(2.0 * np.sin(yaw), 2.0 - 2.0 * np.cos(yaw), yaw) for yaw in YAWS]


@pytest.mark.parametrize("tilt", [0.0, 0.01])
def test_quaternions_with_w_first_are_noticed(tmp_path, tilt):
    path = tmp_path / "w_first.tum"
    path.write_text(tum_text(ARC, "wxyz", tilt))
    for read in (load_tum, lambda file: read_trajectory_3d(file, None, np.zeros(0, dtype=np.int64))):
        with pytest.raises(InputError, match=r"w_first\.tum: its quaternions have w first, as it seems"):
            read(path)


def test_no_file_with_w_last_is_taken_for_one_with_w_first(tmp_path):
    rng = np.random.default_rng(4)
    path = tmp_path / "a.tum"
    drives = [
        [(0.1 * k, 0.0, 0.0) for k in range(20)],
        [(-0.1 * k, 0.0, np.pi) for k in range(20)],
        [(0.0, 0.0, yaw) for yaw in np.linspace(-9.0, 9.0, 99)],
        [(1.0, 2.0, yaw) for yaw in (np.pi, -np.pi, 0.0)],
        ARC[:1],
        *(np.cumsum(rng.normal(0.0, 0.3, (40, 3)), axis=0) for _ in range(20)),
    ]
    for drive in drives:
        path.write_text(tum_text(drive))
        np.testing.assert_allclose(load_tum(path).poses.xyt[:, :2], np.array(drive)[:, :2])
    # Upside down and turning, and a body that rolls in a pipe along x.
    turned = [f"{k} {x} {y} 0 {np.cos(a / 2)} {np.sin(a / 2)} 0 0" for k, (x, y, a) in enumerate(ARC)]
    rolled = [f"{k} {0.1 * k} 0 0 {np.sin(a / 2)} 0 0 {np.cos(a / 2)}" for k, a in enumerate(YAWS)]
    for lines in (turned, rolled):
        path.write_text("\n".join(lines))
        assert len(read_trajectory_3d(path, None, np.zeros(0, dtype=np.int64))) == 31
