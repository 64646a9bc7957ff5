"""Stage record: complete outputs, the same bytes for the same seed, and no truth in the wrong place."""

import hashlib
import itertools
import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.output_rules import MARKER
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.trajectories import load_tum
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.stages.record import Scene, record, record_drive
from turtlebag.sim.raycast import distance_to_point
from turtlebag.sim.robots import load_robot
from turtlebag.sim.simulator import SimConfig, Simulator
from turtlebag.sim.teleop_scripts import commands, load_script
from turtlebag.sim.worlds import load_world, world_names

SCRIPT = """name: short
v: 0.2
w: 1.0
steps:
  - {drive: 0.4}
  - {turn_deg: 90}
  - {repeat: 2, steps: [{spin: 0.25}, {wait: 0.2}]}
  - {through: [[-1.6, 0.2]]}
"""


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    path = tmp_path_factory.mktemp("scripts") / "short.yaml"
    path.write_text(SCRIPT)
    return str(path)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, script):
    out = tmp_path_factory.mktemp("record") / "rec"
    assert record(Scene.load("turtlebot3_world"), script, Output(out)) == 0
    return out


def hashes(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "manifest.json"
    }


@pytest.mark.slow
def test_outputs_are_the_contracts(recorded):
    assert set(hashes(recorded)) == {
        "bag/bag_0.mcap",
        "bag/metadata.yaml",
        "config.yaml",
        "truth/circles.yaml",
        "truth/map.pgm",
        "truth/map.yaml",
        "truth/trajectory.tum",
    }
    assert (recorded / "manifest.json").is_file()
    assert not recorded.with_name("rec.partial").exists()


@pytest.mark.slow
def test_truth_has_one_line_per_scan_at_the_scans_stamp_and_the_map_of_the_world(recorded):
    log = load_recording(recorded)
    truth = load_tum(recorded / "truth" / "trajectory.tum")
    np.testing.assert_array_equal(truth.stamps_ns, log.stamps_ns)
    grid, expected = (
        load_map(recorded / "truth" / "map.yaml"),
        load_world("turtlebot3_world").rasterize(0.182),
    )
    np.testing.assert_array_equal(grid.cells, expected.cells)
    assert log.lidar.n_beams == 360
    assert log.lidar.time_increment == pytest.approx(0.2 / 360.0)
    assert log.odometry is not None
    assert np.all(np.diff(log.odometry.stamps_ns) > 0)
    assert 5 * seconds(int(np.ptp(log.odometry.stamps_ns))) == pytest.approx(len(log), abs=2)


@pytest.mark.slow
def test_same_seed_same_bytes_here_and_in_another_process(recorded, script, tmp_path):
    code = "import sys, pathlib, turtlebag.pipeline.stages.record as r; "
    code += "r.record(r.Scene.load('turtlebot3_world'), sys.argv[1], r.Output(pathlib.Path(sys.argv[2])))"
    other = subprocess.Popen([sys.executable, "-c", code, script, str(tmp_path / "b")])
    assert record(Scene.load("turtlebot3_world"), script, Output(tmp_path / "a")) == 0
    assert other.wait() == 0
    assert hashes(tmp_path / "a") == hashes(recorded)
    assert hashes(tmp_path / "b") == hashes(recorded)
    assert record(Scene.load("turtlebot3_world", seed=2), script, Output(tmp_path / "c")) == 0
    assert hashes(tmp_path / "c")["bag/bag_0.mcap"] != hashes(recorded)["bag/bag_0.mcap"]


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_interrupt_closes_the_bag_and_keeps_it(tmp_path, number, code):
    out = tmp_path / "rec"

    def driver():
        for step in itertools.count():
            if step == 30:
                signal.raise_signal(number)
            yield Twist(0.1, 0.0)

    assert record_drive(Scene.load("turtlebot3_world"), driver(), "ahead", Output(out)) == code
    log = load_recording(out)
    assert len(log) == len(load_tum(out / "truth" / "trajectory.tum")) > 0
    assert log.duration() < 2.0


@pytest.mark.slow
def test_world_show_draws_and_refuses_to_overwrite(tmp_path, capsys):
    picture = tmp_path / "world.png"
    assert main(["world", "show", "turtlebot3_world", "--out", str(picture)]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert main(["world", "show", "turtlebot3_world", "--out", str(picture)]) == 2
    assert "already exists" in capsys.readouterr().err


def drive(name, world, seed=1, scripts=load_script):
    """True poses, clearances and contacts of a scripted drive."""
    world, robot = load_world(world), load_robot(load_world(world).robot)
    poses, clearances, contacts = [], [], 0
    with Simulator(world, robot, SimConfig(lidar={"noise": "none"}), seed) as simulator:
        simulator.reset()
        driver = commands(scripts(name), world, robot, seed)
        next(driver)
        for_sending = simulator.truth
        while True:
            try:
                command = driver.send(for_sending)
            except StopIteration:
                break
            simulator.step(command)
            for_sending = simulator.truth
            poses.append(for_sending.T_world_base.xyt)
            clearances.append(simulator.clearance())
            contacts += for_sending.contact_visible or for_sending.contact_low
    return np.array(poses), np.array(clearances), contacts


def test_script_actions_do_what_they_say(script):
    poses, _, contacts = drive(script, "turtlebot3_world")
    assert contacts == 0
    # 0.4 m ahead of (-2, -0.5), then 90 degrees, then twice a quarter turn, then to a point.
    assert np.abs(poses[:, :2] - [-1.6, -0.5]).sum(axis=1).min() < 0.02
    np.testing.assert_allclose(poses[-1, :2], [-1.6, 0.2], atol=0.02)
    turned = np.abs(np.diff(np.unwrap(poses[:, 2]))).sum()
    assert turned == pytest.approx(np.pi / 2 + np.pi + np.pi, abs=0.15)


@pytest.mark.slow
def test_tour_is_slow_turns_on_the_spot_and_touches_nothing():
    poses, clearances, contacts = drive("tour", "turtlebot3_world")
    assert contacts == 0
    assert clearances.min() > 0.15
    assert 150.0 < len(poses) / 30.0 < 250.0
    speed = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1) * 30.0
    rate = np.abs(np.diff(np.unwrap(poses[:, 2]))) * 30.0
    assert speed.max() < 0.21
    assert rate.max() < 0.8
    # Either it turns or it drives: hardly ever both.
    assert np.mean((speed > 0.1) & (rate > 0.3)) < 0.01
    # It comes back to where it was.
    assert np.linalg.norm(poses[-1, :2] - [-2.0, -0.5]) < 0.05


@pytest.mark.parametrize("name", world_names())
def test_every_route_keeps_clear_of_everything_the_robot_could_touch(name):
    world = load_world(name)
    robot = load_robot(world.robot)
    outlines = world.touchable(robot.height)
    for route in world.routes.values():
        points = np.vstack([world.spawn.xy, route])
        for a, b in itertools.pairwise(points):
            for x, y in a + np.linspace(0.0, 1.0, 60)[:, None] * (b - a):
                room = distance_to_point(x, y, outlines.segments, outlines.circles)
                assert room > robot.model.circumscribed_radius + 0.1, f"{name}: {x:.2f}, {y:.2f}"


@pytest.mark.slow
def test_a_robot_that_gets_stuck_ends_the_recording_with_complete_outputs(tmp_path):
    path = tmp_path / "into_the_wall.yaml"
    path.write_text("name: wall\nsteps: [{turn_deg: 180}, {drive: 3.0}]\n")
    assert record(Scene.load("turtlebot3_world"), str(path), Output(tmp_path / "rec")) == 1
    assert len(load_recording(tmp_path / "rec")) > 20


@pytest.mark.slow
def test_what_a_killed_recording_left_is_set_aside_and_the_same_command_finishes(tmp_path, script):
    for number in range(2):
        left_over = tmp_path / "rec.partial" / "bag" / "bag_0.mcap"
        left_over.parent.mkdir(parents=True)
        left_over.write_bytes(b"what a killed process left %d" % number)
        (tmp_path / "rec.partial" / MARKER).write_text("turtlebag\n")
        assert record(Scene.load("turtlebot3_world"), script, Output(tmp_path / "rec", force=True)) == 0
    assert (tmp_path / "rec.unfinished" / "bag" / "bag_0.mcap").read_bytes().endswith(b"0")
    assert (tmp_path / "rec.unfinished-2" / "bag" / "bag_0.mcap").read_bytes().endswith(b"1")
    assert not (tmp_path / "rec.unfinished" / MARKER).exists()
    assert not (tmp_path / "rec.partial").exists()


def test_what_a_killed_run_left_is_set_aside_too_but_not_by_a_command_that_is_refused(tmp_path, capsys):
    left_over = tmp_path / "run.partial" / "bag" / "bag_0.mcap"
    left_over.parent.mkdir(parents=True)
    left_over.write_bytes(b"what a killed process left")
    (tmp_path / "run.partial" / MARKER).write_text("turtlebag\n")
    drive = ["navigate", "--world", "turtlebot3_world", "--task", "avoid", "--out", str(tmp_path / "run")]
    assert main([*drive, "--duration", "-1"]) == 2
    assert left_over.exists()
    assert main([*drive, "--duration", "1"]) == 0
    assert (tmp_path / "run.unfinished" / "bag" / "bag_0.mcap").read_bytes() == b"what a killed process left"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run", "run.unfinished"]
    assert "turtlebag bag recover" in capsys.readouterr().err


@pytest.mark.slow
def test_driving_a_bags_own_commands_again_gives_the_same_bag(recorded, tmp_path):
    for number, source in enumerate((recorded, recorded / "bag", recorded / "bag" / "bag_0.mcap")):
        out = tmp_path / str(number)
        assert record(Scene.load("turtlebot3_world"), str(source), Output(out)) == 0
        again, before = hashes(out), hashes(recorded)
        assert again.pop("config.yaml") != before.pop("config.yaml")  # it names another driver
        assert again == before


@pytest.mark.slow
def test_a_bags_commands_drive_another_robot_too(recorded, tmp_path):
    assert record(Scene.load("empty", "waffle_pi"), str(recorded), Output(tmp_path / "rec")) == 0
    path = load_tum(tmp_path / "rec" / "truth" / "trajectory.tum")
    assert path.length() == pytest.approx(load_tum(recorded / "truth" / "trajectory.tum").length(), rel=0.1)


def test_a_start_pose_may_be_given(tmp_path, script):
    arguments = ["record", "--world", "empty", "--teleop", script, "--start=-2.5,-0.5,0.5"]
    assert main([*arguments, "--out", str(tmp_path / "rec")]) == 0
    first = load_tum(tmp_path / "rec" / "truth" / "trajectory.tum").poses[0].xyt
    np.testing.assert_allclose(first, [-2.5, -0.5, 0.5], atol=0.01)


def test_the_manifest_holds_the_hashes_of_the_users_own_files(tmp_path, script):
    world = tmp_path / "w.yaml"
    world.write_text("name: w\nspawn: [-2, -0.5, 0]\nbounds: [-9, 9, -9, 9]\nshapes: []\n")
    assert record(Scene.load(str(world)), script, Output(tmp_path / "rec")) == 0
    inputs = json.loads((tmp_path / "rec" / "manifest.json").read_text())["inputs"]
    assert inputs["world"]["sha256"] == {"w.yaml": hashlib.sha256(world.read_bytes()).hexdigest()}
    assert set(inputs) == {"world", "teleop"}
