"""The twin of a recording: its files, its drive, and what tells real from simulated."""

import json
import shutil

import numpy as np
import pytest
import yaml

import turtlebag as tb
from tests.helpers.report_fakes import unrendered
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Trajectory, Twist
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.stages.requests.drives import RecordRequest
from turtlebag.pipeline.stages.requests.studio import StudioRequest
from turtlebag.pipeline.studio.robot import TUTORIAL, Robot
from turtlebag.pipeline.studio.setup import StudioSetup
from turtlebag.pipeline.studio.visuals import EventLog
from turtlebag.pipeline.twin.comparison import cliffs_delta, compare, holm
from turtlebag.pipeline.twin.driver import Drive
from turtlebag.sim.robots import load_robot
from turtlebag.sim.simulator import Simulator
from turtlebag.sim.worlds import load_world

SCRIPT = """
name: short
steps:
  - {drive: 0.6}
  - {turn_deg: 180}
  - {drive: 0.6}
  - {spin: 1}
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    place = tmp_path_factory.mktemp("twin")
    (place / "short.yaml").write_text(SCRIPT)
    words = ["--world", "turtlebot3_world", "--teleop", str(place / "short.yaml"), "--seed", "3", "-q"]
    assert main(["record", *words, "--out", str(place / "rec")]) == 0
    with unrendered():
        assert main(["twin", str(place / "rec"), "--drives", "1", "-q", "--out", str(place / "out")]) == 0
    return place


@pytest.fixture(scope="module")
def twin(place):
    return place / "out"


def test_a_twin_is_a_map_a_world_a_robot_and_a_page(twin):
    files = ("map/map.yaml", "map/trajectory.tum", "map/metrics.json", "robot.yaml", "identify.json")
    for name in (*files, "identify/index.html", "index.html", "manifest.json"):
        assert (twin / name).is_file(), name
    grid, world = load_map(twin / "map" / "map.yaml"), load_world(str(twin / "world.yaml"))
    assert world.spawn.xy == pytest.approx([-2.0, -0.5], abs=0.05)
    walls = np.argwhere(grid.cells == 100)
    assert np.mean(world.rasterize(0.18).value_at(grid.center_of(walls)) == 100) > 0.99
    assert load_robot(str(twin / "robot.yaml")).lidar.n_beams == 360


def twin_of(robot, place):
    """What `twin` finds of a robot file's drive."""
    (place / "short.yaml").write_text(SCRIPT)
    words = ["--robot", robot, "--teleop", str(place / "short.yaml"), "--seed", "3", "-q"]
    assert main(["record", "--world", "turtlebot3_world", *words, "--out", str(place / "rec")]) == 0
    words = ["--robot", robot, "--drives", "1", "-q", "--out", str(place / "out")]
    assert main(["twin", str(place / "rec"), *words]) == 0
    return json.loads((place / "out" / "identify.json").read_text()), load_robot(
        str(place / "out" / "robot.yaml")
    )


def test_a_lidar_that_turns_the_other_way_does_so_in_the_twin(tmp_path):
    burger = load_robot("burger")
    lidar = burger.lidar.model_copy(update={"sweep": -0.8})
    told = burger.model_copy(update={"lidar": lidar}).model_dump(mode="json")
    (tmp_path / "reversed.yaml").write_text(yaml.safe_dump(told))
    found, robot = twin_of(str(tmp_path / "reversed.yaml"), tmp_path)
    low, high = found["parameters"]["sweep"]["interval_95"]
    assert low < -0.8 < high < -0.7
    assert robot.lidar.sweep == pytest.approx(-0.8, abs=0.05)


def test_the_first_of_two_lidars_is_the_twins(tmp_path):
    found, robot = twin_of("waffle_pi_two_lidars", tmp_path)
    assert (found["lidar"], found["other_lidars"]) == ("/scan", ["/scan_rear"])
    assert robot.lidar.pose[0] == pytest.approx(0.03, abs=0.01)
    assert robot.lidar.n_beams == 271


@unrendered()
def test_a_report_shows_robot_and_twin_and_verify_makes_them_again(place, tmp_path, capsys):
    """A changed number is found, too."""
    robot, twin = tmp_path / "robot", tmp_path / "twin"
    assert main(["identify", str(place / "rec"), "-q", "--out", str(robot)]) == 0
    shutil.copytree(place / "out", twin)
    report = tmp_path / "report"
    assert main(["report", str(robot), str(twin), "-q", "--out", str(report)]) == 0
    page = (report / "index.html").read_text()
    assert "parameters are shown by the recording" in page
    assert "true turn by that of the odometry" in page
    assert "Real beside simulated" in page
    capsys.readouterr()
    assert main(["verify", str(report)]) == 0
    assert "not run" not in capsys.readouterr().out
    told = json.loads((twin / "metrics.json").read_text())
    told["quantities"]["silent"]["ks"] += 0.1
    (twin / "metrics.json").write_text(json.dumps(told))
    assert main(["verify", str(report), "--quick"]) == 1
    assert "metrics.json" in capsys.readouterr().out


def test_no_quantity_is_the_same_everywhere(twin):
    """The entropy of a map's parts once was."""
    for name in ("entropy", "walls", "residual_0", "silent", "localisation", "wander"):
        ends = json.loads((twin / "metrics.json").read_text())["quantities"].get(name, {}).get("real")
        assert ends is None or ends["p95"] > 1.01 * ends["p05"], name


def test_python_has_the_twins_parts(twin):
    found = tb.Twin(twin)
    assert found.world.is_file()
    assert found.robot.is_file()
    assert found.map.is_file()
    assert [*found.quantities["name"]] == [*found.metrics["quantities"]]


def test_the_page_says_what_differs_and_what_does_not(twin):
    metrics = json.loads((twin / "metrics.json").read_text())
    assert metrics["drives"] == 1
    assert {"residual_0", "lost_0", "silent", "jitter", "localisation", "agreement"} <= {
        *metrics["quantities"]
    }
    page = (twin / "index.html").read_text()
    for name, quantity in metrics["quantities"].items():
        assert quantity["told_apart"] == (name in metrics["told_apart"])
    assert "What cannot" in page
    assert "Kolmogorov" in page


def test_the_robot_navigates_in_its_twin(twin, tmp_path):
    words = ["--world", str(twin), "--map", str(twin / "map" / "map.yaml"), "--initial-pose", "start", "-q"]
    words += ["--task", "goal", "--goal", "-1.6,-0.5,0", "--out", str(tmp_path / "run")]
    assert main(["navigate", *words]) == 0
    assert json.loads((tmp_path / "run" / "metrics.json").read_text())["goals"][0]["status"] == "reached"
    manifest = json.loads((tmp_path / "run" / "manifest.json").read_text())
    assert {"world", "world_map", "world_map_image", "robot"} <= {*manifest["inputs"]}


def test_the_folder_of_a_twin_stands_for_its_world_its_robot_and_in_the_studio_its_map(twin):
    asked = StudioRequest.checked(world=str(twin))
    assert (asked.world, asked.robot) == (str(twin / "world.yaml"), str(twin / "robot.yaml"))
    assert asked.map == twin / "map" / "map.yaml"
    assert RecordRequest.checked(world=f"{twin}+clutter:1", robot="burger").robot == "burger"
    session = StudioSetup(asked.world, asked.robot, 1, asked.map)
    assert session.scene().world == "twin_of_rec"
    assert session.header().map == str(asked.map.resolve())


def test_the_studio_offers_the_tutorials_waypoints_only_where_they_belong(twin, tmp_path):
    worlds = (str(twin / "world.yaml"), TUTORIAL)
    folders = [tmp_path / "of_twin", tmp_path / "of_tutorial"]
    for folder in folders:
        folder.mkdir()
    robots = [
        Robot(StudioSetup(world), folder, EventLog(print))
        for world, folder in zip(worlds, folders, strict=True)
    ]
    try:
        assert [robot.library.waypoint_files for robot in robots] == [(), ("",)]
        assert len(robots[1].library.load_waypoints("")) == 8
        with pytest.raises(InputError, match="another world"):
            robots[0].library.load_waypoints("")
    finally:
        for robot in robots:
            robot.simulator.close()


def test_a_drive_whose_map_has_no_place_to_stand_is_refused(place, tmp_path, capsys):
    """A wide robot in a narrow passage, by a recording of one that fits through."""
    (tmp_path / "wide.yaml").write_text(yaml.safe_dump(wide_burger()))
    capsys.readouterr()
    words = ["--robot", str(tmp_path / "wide.yaml"), "--drives", "1", "-q", "--out", str(tmp_path / "out")]
    assert main(["twin", str(place / "rec"), *words]) == 2
    assert "no place to stand where it drove" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def wide_burger():
    """A burger of three metres."""
    told = load_robot("burger").model_dump(mode="json")
    return told | {"name": "wide", "footprint": [[1.5, 1.5], [-1.5, 1.5], [-1.5, -1.5], [1.5, -1.5]]}


def test_a_drive_is_held_on_its_path_whatever_the_commands_say():
    """A quarter circle of half a metre; its commands are 10 % too fast, as those of worn wheels."""
    t = np.linspace(0.0, 8.0, 81)
    yaw = 0.25 * np.pi * t / 4.0
    path = SE2.from_xyt(0.5 * np.sin(yaw), 0.5 * (1.0 - np.cos(yaw)), yaw)
    stamps = np.round(5e9 + 1e9 * t).astype(np.int64)
    v, w = np.full(81, 1.1 * 0.5 * np.pi / 16.0), np.full(81, 1.1 * np.pi / 16.0)
    for commands in (None, (stamps, v, w)):
        with Simulator(load_world("empty"), load_robot("burger"), seed=1) as simulator:
            simulator.reset(path[0])
            driver = Drive.of(Trajectory(stamps, path), commands).driver()
            next(driver)
            while (command := next_of(driver, simulator.truth)) is not None:
                simulator.step(command)
            assert np.hypot(*(simulator.truth.T_world_base.xy - path[-1].xy)) < 0.03
            assert simulator.truth.stamp_ns == pytest.approx(8e9, abs=1e8)


def next_of(driver, truth) -> Twist | None:
    try:
        return driver.send(truth)
    except StopIteration:
        return None


def test_p_values_are_corrected_after_holm():
    assert holm(np.array([0.01, 0.04, 0.03])) == pytest.approx([0.03, 0.06, 0.06])
    assert holm(np.array([0.9, 0.8])) == pytest.approx([1.0, 1.0])


def test_the_effect_is_the_share_of_pairs_that_are_larger_less_those_that_are_smaller():
    rng = np.random.default_rng(1)
    a, b = rng.integers(0, 9, 40).astype(float), rng.integers(2, 11, 30).astype(float)
    pairs = b[None] - a[:, None]
    assert cliffs_delta(a, b) == pytest.approx(np.mean(pairs > 0) - np.mean(pairs < 0))


def test_more_noise_by_a_tenth_is_told_apart_and_named_first_and_the_same_noise_is_not():
    def drive(rng, sigma):
        residual = np.abs(rng.normal(0.0, sigma, 20_000))
        residual[::9] = np.nan  # a beam beside that was lost
        return {"residual_0": residual, "jitter": np.abs(rng.normal(0.0, 1e-3, 500))}

    apart, alike = 0, 0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        real = drive(rng, 0.01)
        first = compare(real, [drive(rng, 0.011)])[0]
        apart += first.differs and first.quantity.name == "residual_0" and first.effect > 0
        alike += not any(one.differs for one in compare(real, [drive(rng, 0.01)]))
    assert apart >= 8
    assert alike >= 8


def test_a_bag_that_cannot_have_a_twin_is_refused_in_a_line(tmp_path, capsys):
    (tmp_path / "still.yaml").write_text("name: still\nsteps: [{wait: 3.0}]\n")
    words = ["--world", "turtlebot3_world", "--teleop", str(tmp_path / "still.yaml"), "-q"]
    assert main(["record", *words, "--out", str(tmp_path / "rec")]) == 0
    capsys.readouterr()
    assert main(["twin", str(tmp_path / "rec"), "--out", str(tmp_path / "out")]) == 2
    assert "does not move" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
