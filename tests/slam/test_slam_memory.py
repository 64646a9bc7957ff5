"""Memory of the mapper, and work that is not done twice: counted, not timed."""

import gc
import subprocess
import sys
import tracemalloc
import weakref
from pathlib import Path

import numpy as np
import pytest

from benchmarks.slam_cost import there_and_back
from tests.helpers.carmen_lines import carmen_text
from tests.helpers.exact_rays import rectangle
from tests.helpers.slam_rooms import LDS, ROOM, SICK, around_the_room, drifted, recording
from turtlebag.datasets.carmen import parse_carmen
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.slam.grid import OccupancyConfig, make_grid
from turtlebag.pipeline.slam.loops import submaps
from turtlebag.pipeline.slam.mapper import SlamConfig, run_slam
from turtlebag.pipeline.slam.odometry.line_icp import Lines
from turtlebag.pipeline.slam.odometry.track import TrackingConfig
from turtlebag.pipeline.slam.odometry.tracker import track_log
from turtlebag.pipeline.slam.scans.clouds import PER_POINT, make_clouds
from turtlebag.pipeline.slam.scans.scans import Scans

POSES = around_the_room(60)
LOG = recording(ROOM, POSES, LDS, odometry=drifted(POSES))


@pytest.mark.slow
def test_a_log_is_read_in_little_more_memory_than_its_text_and_its_numbers():
    line = carmen_text(recording(ROOM, POSES[:1], SICK, odometry=POSES[:1]))
    content = (line * 3000).encode()
    tracemalloc.start()
    try:
        read = parse_carmen(content, Path("log"), T_base_lidar=None, notes=[])
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    numbers = 8 * read.ranges.size
    assert read.ranges.shape == (3000, 180)
    assert peak < 2 * len(content) + 6 * numbers  # all words at once take 15 times the numbers


@pytest.mark.slow
def test_only_the_points_of_key_scans_stay_in_memory():
    result = run_slam(LOG, SlamConfig())
    kept, keys = result.session.key_scans.clouds, result.keys
    assert 0 < len(keys) < len(LOG)
    assert len(kept.points) == sum(len(make_clouds(LOG, 30.0).of(int(key))) for key in keys)
    assert np.count_nonzero(np.diff(kept.starts)) == len(keys)


def test_the_points_of_all_scans_go_once_the_log_is_tracked():
    """Not when Python next looks for circles, which is long after the graph is solved."""
    points = []

    def make(tracker):
        points.append(weakref.ref(tracker.clouds.points))
        return Lines(tracker)

    gc.disable()
    try:
        track_log(Scans.of(LOG, 30.0), TrackingConfig(), make)
        assert len(points) == 1
        assert points[0]() is None
    finally:
        gc.enable()


def test_a_log_tracked_with_few_scans_in_memory_has_the_same_track():
    held, tracks = [], []
    for ahead in (1000, 10):

        class Watching(Lines):
            def step(self, points, odometry_step, wait_s):
                held.append(len(self.tracker.clouds.points))
                return super().step(points, odometry_step, wait_s)

        held.clear()
        track = track_log(Scans.of(LOG, 30.0), TrackingConfig(), Watching, ahead=ahead)
        tracks.append((track.T_track_base.xyt, track.keys, track.information, track.usable, max(held)))
    (*whole, most), (*parts, fewer) = tracks
    for one, other in zip(whole, parts, strict=True):
        np.testing.assert_array_equal(one, other)
    assert fewer < 0.7 * most


def test_clouds_of_some_scans_are_those_of_all():
    scans, some = Scans.of(LOG, 30.0), np.array([0, 3, 4, 41])
    whole, (found, numbers) = scans.clouds(), scans.of_keys(some)
    assert numbers.tolist() == some.tolist()  # so that a matcher can tell which scans of the log these are
    assert found.points.shape == (sum(len(whole.of(scan)) for scan in some.tolist()), 2)
    for scan in some.tolist():
        rows, rows_of_all = (slice(*one.starts[scan : scan + 2]) for one in (found, whole))
        for name in PER_POINT:
            np.testing.assert_array_equal(getattr(found, name)[rows], getattr(whole, name)[rows_of_all])
        seen = whole.table[scan] >= 0
        np.testing.assert_array_equal(found.table[scan] >= 0, seen)
        np.testing.assert_array_equal(
            found.points[found.table[scan][seen]], whole.points[whole.table[scan][seen]]
        )


def test_a_map_that_is_surely_too_large_is_refused_before_it_is_drawn():
    """Its beams could be counted, which would take half a gigabyte, but all that they surely passed is too
    large already."""
    poses = np.tile([4.5, 4.3, 0.3], (3, 1))
    log, T = recording(rectangle(0.0, 0.0, 9.0, 8.6), poses, LDS), SE2.from_array(poses)
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=r"have \d{4} x \d{4} cells; choose a larger grid"):
            make_grid(log, T, OccupancyConfig(resolution_m=0.001), 30.0)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 20e6


def test_pictures_of_a_submap_are_kept_for_the_next_and_change_nothing():
    cloud, poses = make_clouds(LOG, 30.0), POSES
    a, b, c = (
        submaps.make_submap(cloud, np.arange(60), poses, k, np.arange(k - 5, k + 6)) for k in (10, 12, 30)
    )
    alone = [submaps.laid_on(a, other, {}) for other in (b, c)]
    pictures = {}
    found = submaps.laid_on(a, b, pictures)
    kept = dict(pictures)
    submaps.laid_on(a, b, pictures)
    assert pictures.keys() == kept.keys()
    other = submaps.laid_on(a, c, pictures)
    assert kept.keys() < pictures.keys()
    assert all(pictures[heading] is picture for heading, picture in kept.items())
    for (score, pose), (score_alone, pose_alone) in zip((found, other), alone, strict=True):
        assert score == score_alone
        np.testing.assert_array_equal(pose, pose_alone)


@pytest.mark.slow
def test_arrays_that_are_done_with_go_back_to_the_system():
    program = """
import sys
sys.argv = ["turtlebag", "--version"]
from contextlib import suppress
from turtlebag.pipeline.__main__ import run
with suppress(SystemExit):
    run()
import numpy as np
def resident():
    return next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmRSS"))
np.ones(4_000_000)
before = resident()
large = [np.ones(1_000_000) for _ in range(12)]
small = [bytes(100_000)]
del large
print(resident() - before)
"""
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert int(said.split()[-1]) < 20_000  # of 96,000 kB


def test_a_log_driven_there_and_back_goes_on_from_each_scan_to_its_neighbour():
    log = recording(ROOM, POSES[:5], SICK, odometry=POSES[:5])
    content = there_and_back(carmen_text(log).encode(), 14)
    longer = parse_carmen(content, Path("log"), T_base_lidar=None, notes=[])
    order = [0, 1, 2, 3, 4, 3, 2, 1, 0, 1, 2, 3, 4, 3]
    assert longer.T_odom_base is not None
    np.testing.assert_allclose(longer.T_odom_base.xyt, SE2.from_array(POSES[order]).xyt, atol=1e-6)
    np.testing.assert_allclose(longer.ranges, log.ranges[order], atol=0.006)
    np.testing.assert_array_equal(np.diff(longer.stamps_ns), 200_000_000)
