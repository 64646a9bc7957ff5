"""3D scans: points, their times, and where the robot was."""

import numpy as np
import pytest

from tests.helpers.bag_samples import LINKS, observation, pose, stamp
from tests.helpers.foreign_bags import CLOUD, FIELD, TYPES, header, write_foreign
from tests.helpers.ros1_bags import to_ros1_bag
from turtlebag.datasets.bags.point_clouds import load_clouds
from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.types import Cloud


def test_what_is_written_is_read_back(tmp_path):
    rng = np.random.default_rng(0)
    clouds = [rng.normal(size=(50 + k, 3)).astype(np.float32) for k in range(4)]
    with BagWriter(tmp_path / "bag", custom={}) as writer:
        writer.static_transforms(0, LINKS)
        for step in range(1, 26):
            writer.observation(observation(step))
            if step % 6 == 0:
                cloud = clouds[step // 6 - 1]
                times = np.linspace(0.0, 0.1, len(cloud))
                writer.cloud(stamp(step), stamp(step - 3), Cloud(cloud, times), "base_scan")
    to_ros1_bag(tmp_path / "bag", tmp_path / "a.bag")
    for path in (tmp_path / "bag", tmp_path / "a.bag"):
        recording = load_clouds(path)
        assert recording.stamps_ns.tolist() == [stamp(step - 3) for step in (6, 12, 18, 24)]
        for cloud, expected in zip(recording.clouds, clouds, strict=True):
            np.testing.assert_array_equal(cloud.points, expected)
            np.testing.assert_allclose(cloud.times, np.linspace(0.0, 0.1, len(expected)), atol=1e-8)
        np.testing.assert_allclose(recording.T_base_lidar[:3, 3], [-0.032, 0.0, 0.182])
        expected_poses = [pose(step - 3).xyt for step in (6, 12, 18, 24)]
        np.testing.assert_allclose(recording.T_odom_base.xyt, expected_poses, atol=1e-9)
        assert recording.notes == ()


@pytest.mark.parametrize(
    ("time_field", "kind", "values"),
    [
        ("time", "f4", [0.0, 0.05, 0.1]),
        ("t", "u4", [0, 50_000_000, 100_000_000]),
        ("timestamp", "f8", [9.0, 9.05, 9.1]),
    ],
)
@pytest.mark.parametrize("order", ["<", ">"])
def test_layouts_of_other_drivers(tmp_path, time_field, kind, values, order):
    """An organised cloud with padding, other fields, invalid points and the driver's own clock."""
    base = 1_700_000_000 if kind == "f8" else 0
    names = ["x", "y", "intensity", "z", time_field]
    offsets = [0, 4, 8, 12, 24]
    dtype = np.dtype(
        {"names": names, "formats": [order + "f4"] * 4 + [order + kind], "offsets": offsets, "itemsize": 40}
    )
    points = np.zeros(4, dtype=dtype)
    points["x"], points["y"], points["z"] = [1, 2, np.nan, 3], [4, 5, 0, 6], [7, 8, 0, 9]
    points[time_field] = np.array([*values[:2], 0, values[2]]) + base
    codes = {"f4": 7, "u4": 6, "f8": 8}
    fields = [
        TYPES[FIELD](name, offset, codes[code], 1)
        for name, offset, code in zip(names, offsets, ["f4"] * 4 + [kind], strict=True)
    ]
    data = np.frombuffer(points.tobytes(), dtype=np.uint8)
    rows = data.reshape(2, 80)
    padded = np.concatenate([rows, np.zeros((2, 8), dtype=np.uint8)], axis=1).ravel()
    stamp_ns = (base + 9) * 10**9 if kind == "f8" else 0
    message = TYPES[CLOUD](header(stamp_ns, "lidar"), 2, 2, fields, order == ">", 40, 88, padded, False)
    write_foreign(tmp_path / "bag", [("/velodyne_points", CLOUD, 0, message)])
    recording = load_clouds(tmp_path / "bag")
    np.testing.assert_array_equal(next(iter(recording.clouds)).points, [[1, 4, 7], [2, 5, 8], [3, 6, 9]])
    np.testing.assert_allclose(next(iter(recording.clouds)).times, [0.0, 0.05, 0.1], atol=1e-6)
    assert recording.T_odom_base is None
