"""Robots with several lidars: each takes its own scans, from where it sits, on a topic of its own."""

import numpy as np
import pytest
import yaml
from scipy.spatial import cKDTree

from turtlebag.datasets.bags.contents import Contents
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.trajectories import load_tum
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.stages.record import Scene, record
from turtlebag.sim.robots import FOLDER, load_robot
from turtlebag.sim.simulator import SimConfig, Simulator
from turtlebag.sim.worlds import load_world

ROBOT = load_robot("waffle_pi_two_lidars")
EXACT = {"noise": "none"}


def scans_of(config, robot=ROBOT, ticks=60):
    with Simulator(load_world("turtlebot3_world"), robot, config, 4) as simulator:
        seen = [simulator.reset()]
        poses = [simulator.scan_truth]
        for _ in range(ticks):
            seen.append(simulator.step(Twist(0.1, 0.5)))
            poses.append(simulator.scan_truth)
    return [(one.scan, pose) for one, pose in zip(seen, poses, strict=True) if one.scan is not None]


def test_each_lidar_measures_from_where_it_sits():
    scans = scans_of(SimConfig(lidar={**EXACT, "turning": False}))
    assert {scan.sensor for scan, _ in scans} == {0, 1}
    stamps = [scan.stamp_ns for scan, _ in scans]
    assert stamps == sorted(set(stamps))
    clouds = {0: [], 1: []}
    for scan, T_world_base in scans:
        T = T_world_base @ ROBOT.mounted(turning=False)[scan.sensor].T_base_lidar
        clouds[scan.sensor].append(T @ scan.points_lidar())
    front, rear = (np.concatenate(clouds[k]) for k in (0, 1))
    distance, _ = cKDTree(front).query(rear)
    # both see the sides, and there the same walls
    assert np.mean(distance < 0.03) > 0.5


def test_a_recording_has_a_topic_and_a_frame_for_each(tmp_path):
    script = tmp_path / "hop.yaml"
    script.write_text("name: hop\nsteps: [{turn_deg: 60}]\n")
    assert record(Scene.load("turtlebot3_world", ROBOT.name), str(script), Output(tmp_path / "rec")) == 0
    contents = Contents(open_bag(tmp_path / "rec" / "bag"))
    frames = {name: {scan.frame for _, scan in scans} for name, scans in contents.scans.items()}
    assert frames == {"/scan": {"base_scan"}, "/scan_rear": {"base_scan_rear"}}
    found = load_recording(tmp_path / "rec")
    for read, said in zip(found.lidars, ROBOT.mounted(), strict=True):
        np.testing.assert_allclose(read.T_base_lidar.xyt, said.T_base_lidar.xyt, atol=1e-9)
        np.testing.assert_allclose(read.spec.angles, said.spec.angles, atol=1e-4)
        assert read.topic == said.topic
    truth = load_tum(tmp_path / "rec" / "truth" / "trajectory.tum")
    np.testing.assert_array_equal(truth.stamps_ns, found.stamps_ns)


def test_another_name_or_rate_of_a_lidar_is_refused_where_it_cannot_be(tmp_path):
    text = yaml.safe_load((FOLDER / "waffle_pi_two_lidars.yaml").read_text())
    lidar = text["more_lidars"].pop("rear")
    path = tmp_path / "robot.yaml"
    for name, rate_hz, why in (("Rear View", 5.0, "more_lidars"), ("rear", 7.0, "must be a whole multiple")):
        path.write_text(yaml.safe_dump({**text, "more_lidars": {name: {**lidar, "rate_hz": rate_hz}}}))
        with pytest.raises(InputError, match=why):
            load_robot(str(path))


def test_lidars_whose_sweeps_end_together_are_delivered_one_after_the_other(tmp_path):
    text = yaml.safe_load((FOLDER / "waffle_pi_two_lidars.yaml").read_text())
    text["more_lidars"]["rear"]["rate_hz"] = 10.0
    path = tmp_path / "robot.yaml"
    path.write_text(yaml.safe_dump(text))
    scans = scans_of(SimConfig(lidar={**EXACT, "turning": False}), load_robot(str(path)), 90)
    counts = np.bincount([scan.sensor for scan, _ in scans])
    assert counts.tolist() == pytest.approx([15, 30], abs=1)
