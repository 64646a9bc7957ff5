"""`turtlebag map` on point clouds: which scans are used, what is written, the same bytes again."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.drives3d import changed, make_drive, without_wheels
from tests.helpers.foreign_bags import CLOUD, FIELD, SCAN, TYPES, header, laser_scan, write_foreign
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.ply import read_ply
from turtlebag.datasets.trajectories import load_tum
from turtlebag.pipeline.stages.map import build_map
from turtlebag.pipeline.stages.requests.maps import MapRequest


def message(stamp_ns, cloud):
    """As a driver sends it: float32 x, y, z and times in seconds, no return as NaN."""
    rows = np.column_stack([cloud.points, cloud.times]).astype("<f4")
    rows = np.vstack([rows, [[np.nan] * 3 + [0.0]]]).astype("<f4")
    fields = [TYPES[FIELD](name, 4 * k, 7, 1) for k, name in enumerate(("x", "y", "z", "time"))]
    data = np.frombuffer(rows.tobytes(), dtype=np.uint8)
    return TYPES[CLOUD](
        header(stamp_ns, "velodyne"), 1, len(rows), fields, False, 16, 16 * len(rows), data, False
    )


@pytest.fixture(scope="module")
def drive():
    """Five seconds, nothing but clouds."""
    return changed(without_wheels(make_drive("room", v=0.8)), lambda k, c: c if 4 < k < 30 else None)


@pytest.fixture(scope="module")
def bag(drive, tmp_path_factory):
    recording = drive.recording
    folder = tmp_path_factory.mktemp("bags") / "foreign"
    stamps = recording.stamps_ns.tolist()
    clouds = zip(stamps, recording.clouds, strict=True)
    return write_foreign(
        folder, [("/velodyne_points", CLOUD, stamp, message(stamp, cloud)) for stamp, cloud in clouds]
    )


def files(folder):
    return {path.name: path.read_bytes() for path in Path(folder).iterdir() if path.name != "manifest.json"}


@pytest.mark.slow
def test_a_bag_of_clouds_alone_is_mapped_in_3d_and_again_to_the_same_bytes(bag, drive, tmp_path):
    assert build_map(MapRequest(source=bag, explain=True), Output(tmp_path / "a")) == 0
    named = MapRequest(source=bag, topic=("/velodyne_points",), explain=True)
    assert build_map(named, Output(tmp_path / "b")) == 0
    assert files(tmp_path / "a") == files(tmp_path / "b")
    names = (
        "config.yaml explain.json graph.g2o graph.json map.pgm map.ply map.yaml metrics.json trajectory.tum"
    )
    assert sorted(files(tmp_path / "a")) == names.split()
    trajectory = load_tum(tmp_path / "a" / "trajectory.tum")
    np.testing.assert_array_equal(trajectory.stamps_ns, drive.recording.stamps_ns)
    metrics = json.loads((tmp_path / "a" / "metrics.json").read_text())
    assert metrics["scans"] == len(drive.recording)
    assert {"keyframes", "loops", "log_s", "self_check"} <= metrics.keys()
    assert (load_map(tmp_path / "a" / "map.yaml").cells == 100).sum() > 100
    assert len(read_ply(tmp_path / "a" / "map.ply")) > 5000


def test_planar_scans_come_first_and_a_topic_chooses(bag, drive, tmp_path):
    stamps = drive.recording.stamps_ns.tolist()[:3]
    both = [
        ("/points", CLOUD, s, message(s, c)) for s, c in zip(stamps, drive.recording.clouds, strict=False)
    ]
    both += [("/scan", SCAN, stamp, laser_scan(stamp, [2.0] * 360)) for stamp in stamps]
    path = write_foreign(tmp_path / "both", both)
    assert build_map(MapRequest(source=path), Output(tmp_path / "flat")) == 0
    assert "map.ply" not in files(tmp_path / "flat")
    assert build_map(MapRequest(source=path, topic=("/points",)), Output(tmp_path / "deep")) == 0
    assert "map.ply" in files(tmp_path / "deep")
