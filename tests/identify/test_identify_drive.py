"""Identification of a simulated robot with hidden parameters, from a bag to the files."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.recordings import load_recording
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.identify.identify import Streams, identified, identify
from turtlebag.pipeline.identify.robot_file import amcl_alphas, nav2_yaml, robot_of, transform_arguments
from turtlebag.pipeline.stages.record import Scene, record
from turtlebag.sim.robots import load_robot

STEPS = [{"wait": 2.0}, {"random_walk": 9.0}, {"spin": 1.0}, {"spin": -1.0}, {"wait": 1.0}]
TRUE = {
    "wheel_scale": 1.02, "turn_scale": 0.96, "turn_per_m": 0.02, "lidar_x": -0.01, "lidar_y": 0.015,
    "command_delay": 0.1, "max_dv": 0.5, "gyro_scale": 1.0, "sigma": 0.006, "lost": 0.05,
    "known_offset": -0.02, "known_square": 0.004,
}  # fmt: skip


def hidden():
    """A burger that has these parameters."""
    burger = load_robot("burger")
    wheels = burger.wheels.model_copy(update={
        "controller_radius": burger.wheels.radius / 1.02,
        "separation": 2.0 * burger.wheels.joint_y * 0.96 / 1.02,
        "turn_per_m": 0.02, "calibration_error": 0.0,
    })  # fmt: skip
    errors = burger.lidar.errors.model_copy(
        update={
            "sigma": 0.006,
            "lost": 0.05,
            "offset": 0.0,
            "square": 0.0,
            "known_offset": -0.02,
            "known_square": 0.004,
        }
    )
    lidar = burger.lidar.model_copy(update={"pose": (-0.01, 0.015, 0.0), "errors": errors})
    limits = burger.limits.model_copy(
        update={"command_delay": 0.1, "max_dv": 0.5, "wheel_acceleration": 10.0}
    )
    return burger.model_copy(update={"wheels": wheels, "lidar": lidar, "limits": limits})


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A record of it, in the world of the tutorial."""
    folder = tmp_path_factory.mktemp("identify")
    script = folder / "script.yaml"
    script.write_text(yaml.safe_dump({"name": "some", "v": 0.2, "w": 0.8, "steps": STEPS}))
    scene = Scene.load("turtlebot3_world", "burger", 5)
    robot = hidden()
    scene = replace(scene, robot=robot, sim=type(scene.sim)().resolved(robot))
    assert record(scene, str(script), Output(folder / "rec")) == 0
    return folder


@pytest.fixture(scope="module")
def found(drive):
    """What is found of it, if the lidar is said to sit where the burger's does."""
    base = load_robot("burger")
    recording = load_recording(drive / "rec", T_base_lidar=base.T_base_lidar)
    return identify(recording, base, Streams.of(drive / "rec"))


@pytest.mark.parametrize("name", TRUE)
def test_the_interval_holds_what_was_hidden(found, name):
    estimate = found[name]
    low, high = estimate.interval_95
    # one interval of twenty may miss; half as wide again, hardly one of three hundred does
    margin = 0.25 * (high - low)
    assert estimate.observable
    assert low - margin <= TRUE[name] <= high + margin
    assert high - low < 0.6 * max(abs(TRUE[name]), 0.02)


def test_the_robot_has_what_was_found_and_the_shape_of_its_base(found):
    robot, base = found.robot, load_robot("burger")
    assert robot.footprint == base.footprint
    assert robot.wheels.radius / robot.wheels.controller_radius == pytest.approx(found["wheel_scale"].value)
    assert robot.lidar.errors.sigma == found["sigma"].value
    assert found["command_delay"].value == pytest.approx(0.1, abs=0.006)  # a step is 0.033 s
    assert robot.limits.command_delay == pytest.approx(0.1)
    assert robot.wheels.calibration_error == 0.0


def test_numbers_that_are_known_together_are_drawn_together(found):
    names = "known_offset", "known_square"
    rng = np.random.default_rng(3)
    draws = [found.drawn(rng).lidar.errors for _ in range(300)]
    common = np.corrcoef([[getattr(one, name) for one in draws] for name in names])[0, 1]
    assert found.correlations[names] > 0.3
    assert common == pytest.approx(found.correlations[names], abs=0.15)


def test_the_command_writes_a_robot_that_drives(drive, found):
    out = drive / "out"
    assert main(["identify", str(drive / "rec"), "--robot", "burger", "--out", str(out), "-q"]) == 0
    told = json.loads((out / "identify.json").read_text())["parameters"]
    assert told["turn_scale"]["observable"]
    assert told["turn_scale"]["interval_95"][0] < told["turn_scale"]["value"]
    page = (out / "index.html").read_text()
    assert all(name in page for name in told)
    assert load_robot(str(out / "robot.yaml")).name == "burger_identified"
    assert "ros__parameters" in (out / "nav2.yaml").read_text()


def test_a_plot_shows_the_data_behind_each_estimate(drive, found):
    shown = {name for plot in found.plots.values() for name in plot.of}
    estimated = {one.name for one in found.estimates if one.observable and one.sigma > 0.0}
    assert estimated - shown == set()
    place = found.plots["place"].points["turns"]
    assert np.median(place, axis=1) == pytest.approx([-10.0, 15.0], abs=5.0)
    beams, times = found.plots["sweep"].points["parts of the array"]
    assert np.corrcoef(beams, times)[0, 1] > 0.9


def test_other_programs_get_their_numbers(found):
    values, base = found.values, found.base
    of_nav2 = nav2_yaml(values, base)["diff_drive_controller"]["ros__parameters"]
    share = values["wheel_scale"] / values["turn_scale"]
    assert of_nav2["wheel_separation_multiplier"] == pytest.approx(share, abs=1e-6)
    # what its odometry does not see turns it left: the right wheel is larger than it thinks
    assert of_nav2["right_wheel_radius_multiplier"] > of_nav2["left_wheel_radius_multiplier"]
    assert f"--x {values['lidar_x']:.4f}" in transform_arguments(values, base)
    assert amcl_alphas(values | {"turn_slip": 0.1}, base)["alpha1"] > amcl_alphas(values, base)["alpha1"]


def test_a_robot_that_stands_still_is_refused_in_one_line(tmp_path, capsys):
    readings = " ".join(["2.0"] * 180)
    lines = [f"FLASER 180 {readings} 0 0 0 0 0 0 {t} host {t}" for t in range(1, 40)]
    (tmp_path / "log.clf").write_text("\n".join(lines) + "\n")
    code = main(["identify", str(tmp_path / "log.clf"), "--out", str(tmp_path / "out"), "-q"])
    error = capsys.readouterr().err
    assert code == 2
    assert "does not move" in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_recording_without_odometry_or_scans_is_refused(found):
    log = found.recording
    with pytest.raises(InputError, match="no odometry"):
        identify(replace(log, T_odom_base=None, odometry=None), found.base)
    with pytest.raises(InputError, match="0 scans"):
        identify(replace(log, stamps_ns=log.stamps_ns[:0], ranges=log.ranges[:0]), found.base)


def test_without_commands_imu_and_joints_their_numbers_are_the_bases(found):
    rest = identified(replace(found.recording, imu=None), found.session, found.base)
    for name in ("command_delay", "max_dv", "gyro_scale", "gyro_noise", "encoder_ticks"):
        assert not rest[name].observable
    assert rest["gyro_noise"].why == "no IMU"
    assert rest.robot.limits.max_dv == found.base.limits.max_dv
    assert rest["slip"].value == found["slip"].value


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("world", ["empty", "turtlebot3_world"])
def test_a_few_seconds_or_a_place_without_walls_show_little_and_break_nothing(world, tmp_path, capsys):
    (tmp_path / "short.yaml").write_text("name: short\nsteps: [{drive: 0.6}, {turn_deg: 60}]\n")
    words = ["--world", world, "--teleop", str(tmp_path / "short.yaml"), "--seed", "2", "-q"]
    assert main(["record", *words, "--out", str(tmp_path / "rec")]) == 0
    assert main(["identify", str(tmp_path / "rec"), "-q", "--out", str(tmp_path / "out")]) == 0
    told = json.loads((tmp_path / "out" / "identify.json").read_text())["parameters"]
    assert told["gyro_noise"]["why"] == "too few samples of the IMU"
    assert not told["known_square"]["observable"]
    assert np.isfinite([one["value"] for one in told.values()]).all()
    assert load_robot(str(tmp_path / "out" / "robot.yaml")).lidar.n_beams == 360


def test_a_recording_of_which_no_robot_can_be_made_is_refused(found):
    with pytest.raises(InputError, match=r"its robot: lidar\.range_max: must be less than"):
        robot_of({**found.values, "range_max": 1e9}, found.recording, found.base)
