"""Unusual numbers and angles of beams: the walls stay straight."""

import math

import numpy as np
import pytest

from tests.helpers.foreign_bags import SCAN, laser_scan, write_foreign
from turtlebag.datasets.recordings import load_recording

FULL_TURN = 2.0 * math.pi


@pytest.mark.parametrize(
    ("sizes", "changes", "note"),
    [
        ((360, 359, 360), {}, "another geometry"),
        ((360,), {"angle_max": FULL_TURN}, "imply 361"),
        ((360,), {"angle_max": FULL_TURN, "angle_increment": FULL_TURN / 359}, ""),
        ((360,), {"angle_increment": 0.0}, "angle_increment is 0"),
    ],
)
def test_fence_posts(tmp_path, sizes, changes, note):
    messages = [
        ("/scan", SCAN, k, laser_scan(k, np.arange(size) * 0.001 + 1.0, **changes))
        for k, size in enumerate(sizes)
    ]
    recording = load_recording(write_foreign(tmp_path / "bag", messages))
    assert recording.ranges.shape == (len(sizes), 360)
    assert any(note in line for line in recording.notes)
    for row, size in zip(recording.ranges, sizes, strict=True):
        np.testing.assert_allclose(row[:size], np.arange(size) * 0.001 + 1.0, rtol=1e-6)
        assert np.isnan(row[size:]).all()


def wall_ahead(angles, distance=1.5):
    """Ranges to the line x = distance, +inf where it is not seen."""
    with np.errstate(divide="ignore"):
        ranges = distance / np.cos(angles)
    return np.where((ranges > 0.0) & (ranges < 3.4), ranges, np.inf)


def test_a_motor_that_wavers_does_not_make_scans_different(tmp_path):
    messages = [
        (
            "/scan",
            SCAN,
            k * 1_000_000_000,
            laser_scan(
                k * 1_000_000_000, np.ones(360), time_increment=(1 + 0.01 * k) / 1800, scan_time=0.2 + k
            ),
        )
        for k in range(5)
    ]
    recording = load_recording(write_foreign(tmp_path / "bag", messages))
    assert recording.lidar.n_beams == 360
    assert recording.lidar.time_increment == pytest.approx(1.02 / 1800)
    assert not any("geometry" in note for note in recording.notes)


def test_angles_that_change_with_every_scan_keep_the_walls_straight(tmp_path):
    """The LDS-02 gives some 230 beams, their number, start and increment new in each turn."""
    rng = np.random.default_rng(0)
    messages = []
    for k in range(40):
        n = int(rng.integers(225, 235))
        start, step = float(rng.uniform(0.0, 0.02)), 2.0 * math.pi / n
        angles = (np.float32(start) + np.float32(step) * np.arange(n)).astype(float)
        scan = laser_scan(
            k, wall_ahead(angles), angle_min=start, angle_max=start + (n - 1) * step, angle_increment=step
        )
        messages.append(("/scan", SCAN, k, scan))
    recording = load_recording(write_foreign(tmp_path / "bag", messages))
    assert any("change from scan to scan" in note for note in recording.notes)
    seen = [recording.scan(index).points_lidar() for index in range(len(recording))]
    assert min(len(points) for points in seen) > 75
    points = np.concatenate(seen)
    near = np.abs(points[:, 1]) < 1.5
    assert np.abs(points[near, 0] - 1.5).max() < 0.006
    assert np.unique(np.isinf(recording.ranges).sum(axis=1)).min() > 100
