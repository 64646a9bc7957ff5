"""The localise stage: a small CARMEN log of the synthetic room, through the command line."""

import json
import shutil

import numpy as np
import pytest

from tests.helpers.localisation_room import STILL_LIDAR, Step, drive, l_shaped_room
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import FREE, OCCUPIED
from turtlebag.datasets.maps import save_map
from turtlebag.datasets.outputs import write_manifest
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.trajectories import load_tum, save_tum
from turtlebag.datasets.types import LidarSpec, Recording, Trajectory
from turtlebag.pipeline.cli import main as cli
from turtlebag.pipeline.stages.localise import checked_odometry, load_localise_config, sweep_ends
from turtlebag.reports.metrics.references import truth_folder

# What a CARMEN log can say: 181 beams over half a turn, the laser on the robot's centre.
LASER = LidarSpec(181, -np.pi / 2.0, np.pi / 180.0, 0.0, 3.5)


def carmen_line(step: Step, ranges) -> str:
    pose = " ".join(f"{value:.6f}" for value in step.T_odom_base.xyt)
    t = 100.0 + step.scan.stamp_ns * 1e-9
    text = " ".join(f"{r:.3f}" for r in np.where(np.isfinite(ranges), ranges, 81.83))
    return f"FLASER {len(ranges)} {text} {pose} {pose} {t:.6f} host {t:.6f}\n"


@pytest.fixture(scope="module")
def room_log(tmp_path_factory):
    """Folder with log.clf, map.yaml and truth/trajectory.tum."""
    folder = tmp_path_factory.mktemp("room")
    room, rng = l_shaped_room(), np.random.default_rng(3)
    steps = drive(room, [(2.0, 2.0), (4.3, 2.2), (4.3, 1.2)], rng, lidar=STILL_LIDAR)
    with (folder / "log.clf").open("w") as file:
        for step in steps:
            ranges = room.ranges(SE2(step.T_room_base.xyt[None]), LASER.angles, LASER.range_max)
            file.write(carmen_line(step, ranges + 0.01 * rng.standard_normal(len(ranges))))
    save_map(room.grid(), folder)
    (folder / "truth").mkdir()
    stamps = np.array([100 * 10**9 + step.scan.stamp_ns for step in steps]) // 1000 * 1000
    truth = Trajectory(stamps, SE2.stack([step.T_room_base for step in steps]))
    save_tum(truth, folder / "truth" / "trajectory.tum")
    return folder


def run(room_log, out, *more):
    return cli.main(
        ["localise", str(room_log / "log.clf"), "--map", str(room_log / "map.yaml"), "--out", str(out), *more]
    )


@pytest.mark.slow
@pytest.mark.parametrize("start", ["2,2,0", "global"])
def test_a_log_is_localised(room_log, tmp_path, start):
    out = tmp_path / "out"
    code = run(room_log, out, f"--initial-pose={start}", "--truth", str(room_log / "truth"))
    assert code == 0
    metrics = json.loads((out / "metrics.json").read_text())
    truth = load_tum(room_log / "truth" / "trajectory.tum")
    assert len(load_tum(out / "trajectory.tum")) == metrics["scans"] == len(truth)
    assert metrics["localisation_error_m"]["rmse"] < 0.02
    assert metrics["localisation_error_rad"]["rmse"] < 0.01
    assert metrics["converged"]["share"] > 0.9
    assert (out / "config.yaml").is_file()
    assert (out / "manifest.json").is_file()


@pytest.mark.slow
def test_on_the_map_of_another_place_it_is_lost_and_says_so(room_log, tmp_path, capsys):
    grid = l_shaped_room().grid()
    rng = np.random.default_rng(5)
    grid.cells[:] = FREE
    grid.cells[rng.random(grid.cells.shape) < 0.01] = OCCUPIED
    save_map(grid, tmp_path, "other")
    scans = (room_log / "log.clf").read_text().splitlines(keepends=True)
    (tmp_path / "half.clf").write_text("".join(scans[: len(scans) // 2]))
    words = ["localise", f"{tmp_path}/half.clf", "--map", f"{tmp_path}/other.yaml", "--initial-pose=2,2,0"]
    words += ["--set", "amcl.max_particles=500"]  # a lost robot weighs all of them by the paths of the beams
    assert cli.main([*words, "--out", f"{tmp_path}/out"]) == 1
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert (metrics["success"], metrics["status"]) == (False, "lost")
    assert metrics["reason"] == "the last scans disagree with the map"
    assert metrics["agreement"] < 0.6
    assert (tmp_path / "out" / "manifest.json").is_file()
    assert "lost (the last scans disagree with the map): " in capsys.readouterr().err


@pytest.mark.slow
def test_a_robot_that_only_believes_to_be_localised_is_a_failure(room_log, tmp_path, capsys):
    truth = load_tum(room_log / "truth/trajectory.tum")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    moved = Trajectory(truth.stamps_ns, SE2.from_xyt(0.0, 1.5, 0.0) @ truth.poses)
    save_tum(moved, elsewhere / "trajectory.tum")
    assert run(room_log, tmp_path / "out", "--initial-pose=2,2,0", "--truth", str(elsewhere)) == 1
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert (metrics["success"], metrics["true_success"]) == (True, False)
    assert metrics["last_error_m"] == pytest.approx(1.5, abs=0.02)
    assert "not localised: 1.5" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(("elsewhere", "code"), [(False, 0), (True, 1)])
def test_the_exit_code_of_a_map_follows_the_truth(room_log, tmp_path, capsys, elsewhere, code):
    """Turned as a whole, the truth is of the same drive; mirrored, of another that the self-check misses."""
    truth = load_tum(room_log / "truth/trajectory.tum")
    poses = SE2.from_xyt(1.0, 2.0, 3.0) @ truth.poses
    if elsewhere:
        poses = SE2(poses.xyt * [1.0, -1.0, -1.0])
    (tmp_path / "truth").mkdir()
    save_tum(Trajectory(truth.stamps_ns, poses), tmp_path / "truth/trajectory.tum")
    words = ["map", room_log / "log.clf", "--truth", tmp_path / "truth", "--out", tmp_path / "out"]
    assert cli.main([str(word) for word in words]) == code
    assert f"{'bad' if elsewhere else 'good'} map of " in capsys.readouterr().err
    check = json.loads((tmp_path / "out/metrics.json").read_text())["self_check"]
    assert check["verdict"] == "good"


@pytest.mark.slow
def test_the_truth_of_another_time_is_one_line(room_log, tmp_path, capsys):
    truth = load_tum(room_log / "truth/trajectory.tum")
    later = tmp_path / "later"
    later.mkdir()
    save_tum(Trajectory(truth.stamps_ns + 10**15, truth.poses), later / "trajectory.tum")
    assert run(room_log, tmp_path / "out", "--initial-pose=2,2,0", "--truth", str(later)) == 2
    assert (
        capsys.readouterr().err == f"turtlebag: --truth {later}: the estimate and the truth share no time\n"
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_same_seed_writes_the_same_bytes_and_a_line_sums_them_up_unless_quiet(room_log, tmp_path, capsys):
    for name, quiet in (("a", []), ("b", ["-q"])):
        assert run(room_log, tmp_path / name, "--initial-pose=2,2,0", "--seed", "4", *quiet) == 0
        said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("localised: ")]
        assert len(said) == (0 if quiet else 1)
    for name in ("trajectory.tum", "metrics.json", "config.yaml"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    metrics = json.loads((tmp_path / "a" / "metrics.json").read_text())
    assert metrics["agreement"] > 0.8
    assert "reason" not in metrics


def test_without_an_initial_pose_it_is_rejected_with_complete_outputs(room_log, tmp_path):
    assert run(room_log, tmp_path / "out") == 1
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert (metrics["status"], metrics["reason"]) == ("rejected", "no initial pose")
    assert (tmp_path / "out" / "trajectory.tum").is_file()
    assert (tmp_path / "out" / "manifest.json").is_file()


@pytest.mark.parametrize("verb", ["map", "localise"])
def test_an_estimate_is_no_truth_and_a_run_with_both_has_one(room_log, tmp_path, capsys, verb):
    estimate = tmp_path / "estimate"
    estimate.mkdir()
    save_tum(load_tum(room_log / "truth/trajectory.tum"), estimate / "trajectory.tum")
    write_manifest(estimate, "map", [], {}, wall_s=1.0)
    on = ["--map", str(room_log / "map.yaml"), "--initial-pose=2,2,0"] if verb == "localise" else []
    words = [verb, str(room_log / "log.clf"), *on, "--truth", str(estimate), "--out", str(tmp_path / "out")]
    assert cli.main(words) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"turtlebag: {estimate}: holds an estimate, not the truth ")
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()
    shutil.copytree(room_log / "truth", estimate / "truth")
    assert truth_folder(estimate) == estimate / "truth"


def test_a_nav2_parameter_file_configures_the_filter(tmp_path):
    path = tmp_path / "nav2.yaml"
    path.write_text(
        "amcl:\n  ros__parameters:\n    max_particles: 1500\n    pf_z: 0.99\n    scan_topic: scan\n"
    )
    config = load_localise_config(path, ["amcl.min_particles=300"])
    assert (config.amcl.max_particles, config.amcl.kld_z, config.amcl.min_particles) == (1500, 0.99, 300)


def test_a_parameter_file_of_ros_1_has_no_sections(tmp_path):
    path = tmp_path / "amcl.yaml"
    path.write_text("odom_alpha1: 0.3\nlaser_z_hit: 0.6\nkld_err: 0.04\nodom_frame_id: odom\n")
    amcl = load_localise_config(path, ["amcl.min_particles=300"]).amcl
    assert (amcl.alpha1, amcl.z_hit, amcl.kld_err, amcl.min_particles) == (0.3, 0.6, 0.04, 300)


def recording(**changes):
    parts = {
        "source": "log",
        "stamps_ns": np.arange(3) * 200_000_000,
        "ranges": np.full((3, 360), 2.0, dtype=np.float32),
        "lidar": LidarSpec(360, 0.0, np.pi / 180.0, 0.1, 3.5, time_increment=0.1 / 360),
        "T_base_lidar": SE2.identity(),
        "T_odom_base": SE2.identity(3),
    }
    return Recording(**(parts | changes))


def test_odometry_must_be_there_and_finite():
    with pytest.raises(InputError, match="no odometry"):
        checked_odometry(recording(T_odom_base=None))
    broken = np.zeros((3, 3))
    broken[1, 0] = np.nan
    with pytest.raises(InputError, match="scan 1 is not finite"):
        checked_odometry(recording(T_odom_base=SE2(broken)))


def test_the_sweep_ends_where_odometry_was_then():
    moving = Trajectory(np.array([0, 10**9]), SE2(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])))
    ends = sweep_ends(recording(odometry=moving))
    assert ends is not None
    assert np.allclose(ends.x, [0.1, 0.3, 0.5])
    assert sweep_ends(recording()) is None
