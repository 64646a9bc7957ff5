"""Odometry that is late, early or mirrored: found, corrected and reported."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.known_logs import integrate
from tests.helpers.made_drives import Drive, Lie, Sensor, Wheels, lds, make_log, sick
from tests.helpers.made_logs import arena, office_plan
from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.sensor_times import SensorTimes
from turtlebag.datasets.types import ImuLog, Odometry, Trajectory, Twist
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.slam.mapper import SlamConfig, run_slam
from turtlebag.pipeline.slam.sensors.corrected import in_step
from turtlebag.pipeline.slam.times.timing import Timing, compared_times
from turtlebag.pipeline.slam.times.turn_comparison import DELAYS_S, Turns, delay_of

ROUTE = np.array(
    [(14.7, 7.0), (10.1, 7.0), (10.1, 10.5), (10.1, 7.0), (14.7, 7.0), (14.7, 10.5), (14.7, 7.0)]
)
LONG = np.array([(16, 7), (27, 7), (27, 12), (27, 7), (10.1, 7), (10.1, 10.5), (10.1, 7)])
DRIVE = Drive(v=0.7, w=1.2)
IN_STEP = Timing()


def drive(spec, *, lies=(), route=ROUTE):
    wheels = Wheels(0.01, 0.03, 0.002)
    return make_log("late", office_plan(1), route, Sensor(spec, 0.2), drive=DRIVE, wheels=wheels, lies=lies)


@pytest.fixture(scope="module")
def turning():
    """A lidar that turns, with odometry at 30 Hz."""
    return drive(replace(lds(), range_max=8.0))


@pytest.fixture(scope="module")
def turning_long():
    """The same lidar on a longer way."""
    return drive(replace(lds(), range_max=8.0), route=LONG)


@pytest.fixture(scope="module")
def paired():
    """A lidar that sees at once, each scan with its odometry, as CARMEN logs have them."""
    return drive(sick(180, 30.0))


def late(recording, seconds):
    """The recording with odometry that much behind (negative: ahead of) its scans."""
    ns = round(seconds * 1e9)
    stream = recording.odometry or Trajectory(recording.stamps_ns, recording.T_odom_base)
    moved = recording.odometry and Trajectory(stream.stamps_ns + ns, stream.poses)
    return replace(recording, T_odom_base=stream.at(recording.stamps_ns - ns), odometry=moved)


def compared(recording):
    """What the comparison of times corrects."""
    return compared_times(recording)._replace(times=SensorTimes())


@pytest.mark.parametrize(
    ("side", "late_s", "told"), [(0, 0.0, (0.0, False)), (0, -0.3, (-0.3, False)), (1, 0.1, (0.0, True))]
)
def test_odometry_is_late_or_turned_over_by_the_delay_at_which_all_turns_agree(side, late_s, told):
    off = np.random.default_rng(1).normal(0.0, 0.3, (2, len(DELAYS_S), 32))
    off[side, np.abs(DELAYS_S - late_s).argmin()] = 0.0
    assert delay_of(Turns(off, np.repeat(np.arange(8), 4))) == pytest.approx(told)


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.08, -0.06])
def test_a_delay_that_is_too_unsure_to_be_undone_is_told_as_it_is(paired, seconds):
    """It was told as none, with the interval of another."""
    timing = compared_times(late(paired.recording, seconds))
    delay = timing.times.delay_s
    assert timing.late_s == 0.0
    assert delay.value == pytest.approx(seconds, abs=3.0 * delay.sigma)
    assert delay.value == pytest.approx(seconds, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.1, -0.5, 1.0])
def test_a_delay_is_found_and_undone(turning, seconds):
    recording = late(turning.recording, seconds)
    timing = compared(recording)
    found = timing.late_s
    assert timing[:4] == (pytest.approx(seconds, abs=0.03), False, None, True)
    fixed = in_step(recording, timing)
    inside = slice(10, -10)  # beyond its ends the odometry is held
    expected = turning.recording.T_odom_base[inside]
    np.testing.assert_allclose(fixed.T_odom_base[inside].xy, expected.xy, atol=0.03)
    assert fixed.odometry_late_s == found
    side = "behind" if seconds > 0.0 else "ahead of"
    assert fixed.notes == (
        f"the odometry runs {abs(found):.2f} s {side} the scans (judged by the turns of both); corrected",
    )


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [-0.4, 0.8])
def test_a_delay_of_odometry_that_comes_with_the_scans_is_found(paired, seconds):
    assert compared(late(paired.recording, seconds))[0] == pytest.approx(seconds, abs=0.06)


@pytest.mark.slow
@pytest.mark.parametrize("log", ["turning", "paired"])
def test_odometry_in_time_stays_as_it_is(log, request):
    recording = request.getfixturevalue(log).recording
    assert compared(recording) == IN_STEP
    assert in_step(recording, IN_STEP) is recording
    assert compared(replace(recording, T_odom_base=None, odometry=None)) == IN_STEP
    assert compared(late(recording, 0.02)) == IN_STEP


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["freeze", "spin", "jump", "reverse"])
def test_odometry_that_lies_is_not_called_late(kind):
    log = drive(sick(180, 30.0), lies=tuple(Lie(kind, start, 2.0) for start in (5.0, 14.0, 28.0)))
    assert compared(log.recording) == IN_STEP


def test_a_robot_that_never_turns_shows_no_delay():
    log = drive(replace(lds(), range_max=8.0), route=np.array([(10.0, 7.0), (26.0, 7.0)]))
    assert compared(late(log.recording, 0.5)) == IN_STEP


def test_odometry_that_jumps_by_as_much_as_it_turns_is_its_own():
    """Jumps change the turning most, so they were compared first: like the odometry of another drive."""
    log = drive(replace(lds(), range_max=8.0), route=LONG[:3])
    steps = log.recording.T_odom_base.steps()
    steps[12::40] += [1.0, 1.0, 1.5]
    jumpy = SE2.from_array(integrate(log.recording.T_odom_base.xyt[0], steps))
    assert compared(replace(log.recording, T_odom_base=jumpy, odometry=None)) == IN_STEP


def test_the_odometry_of_another_drive_is_known_by_its_turns():
    log = drive(replace(lds(), range_max=8.0), route=LONG[:3])
    own = log.recording.T_odom_base
    for other in (own[::-1], SE2(np.zeros_like(own.xyt)), SE2(own.xyt * [1.0, 1.0, -0.5])):
        timing = compared(replace(log.recording, T_odom_base=other, odometry=None))
        assert timing == Timing(alike=False)
    late_and_off = late(log.recording, 0.4)
    assert compared(late_and_off).alike
    # scans a second apart lose turns when they are tracked alone
    slow, thin = log.recording, slice(None, None, 5)
    slow = replace(slow, stamps_ns=slow.stamps_ns[thin], ranges=slow.ranges[thin], odometry=None)
    assert compared(replace(slow, T_odom_base=own[::-1][thin])).alike


@pytest.mark.slow
@pytest.mark.parametrize("log", ["turning", "paired"])
@pytest.mark.parametrize("seconds", [0.0, 0.4])
def test_a_lidar_said_to_hang_the_wrong_way_up_is_turned_over(log, seconds, request):
    recording = request.getfixturevalue(log).recording
    wrong = late(replace(recording, lidar=recording.lidar.turned_over()), seconds)
    timing = compared(wrong)
    assert timing[:4] == (pytest.approx(seconds, abs=0.06), True, None, True)
    fixed = in_step(wrong, timing)
    np.testing.assert_allclose(fixed.lidar.angles, recording.lidar.angles)
    assert fixed.notes[0].startswith("scans and odometry turn in opposite directions")


@pytest.mark.slow
def test_scans_a_second_apart_are_no_judge_of_how_a_lidar_sweeps():
    log = arena(2, "spiral").recording
    slow = slice(None, None, 5)
    odometry = log.T_odom_base[slow]
    recording = replace(log, stamps_ns=log.stamps_ns[slow], ranges=log.ranges[slow], T_odom_base=odometry)
    assert compared(recording) == IN_STEP


@pytest.mark.slow
def test_late_odometry_makes_no_map_worse(turning):
    log = turning.with_scans(slice(175))

    def worst(recording):
        result = run_slam(recording, SlamConfig())
        return np.linalg.norm(result.trajectory.poses.xy - log.truth.poses.xy, axis=1).max()

    assert worst(late(log.recording, 0.5)) < 1.2 * worst(log.recording)


@pytest.mark.slow
def test_map_and_localise_say_it(turning, tmp_path, capsys):
    recording = late(turning.recording, 0.3)
    with BagWriter(tmp_path / "bag", custom={}) as writer:
        writer.static_transforms(0, [("base_footprint", "base_scan", (0.0, 0.0, 0.1), 0.0)])
        for stamp, pose in zip(recording.odometry.stamps_ns, recording.odometry.poses.xyt, strict=True):
            writer.odometry(Odometry(int(stamp), SE2(pose), Twist()))
        for k in range(len(recording)):
            scan = recording.scan(k)
            writer.scan(scan.stamp_ns, scan)
    assert main(["map", str(tmp_path / "bag"), "--out", str(tmp_path / "map")]) == 0
    said = capsys.readouterr().err
    assert "note: the odometry runs 0.30 s behind the scans (judged by the turns of both); corrected" in said
    assert json.loads((tmp_path / "map" / "metrics.json").read_text())["odometry_late_s"] == 0.3
    start = ",".join(f"{value:.3f}" for value in turning.truth.poses.xyt[0])
    args = ["localise", str(tmp_path / "bag"), "--map", str(tmp_path / "map"), f"--initial-pose={start}"]
    assert main([*args, "--out", str(tmp_path / "loc")]) == 0
    assert "the odometry runs 0.30 s behind the scans" in capsys.readouterr().err
    assert json.loads((tmp_path / "loc" / "metrics.json").read_text())["odometry_late_s"] == 0.3


@pytest.mark.parametrize(("sign", "sure"), [(1.0, True), (-1.0, False), (None, False)])
def test_a_gyro_tells_whether_scans_or_odometry_are_mirrored(turning, sign, sure):
    recording = turning.recording
    if sign is not None:
        stream = recording.odometry
        rate = sign * np.gradient(np.unwrap(stream.poses.yaw), stream.stamps_ns * 1e-9)
        turned = np.stack([0.0 * rate, 0.0 * rate, rate], axis=1)
        recording = replace(recording, imu=ImuLog(stream.stamps_ns, turned, 0.0 * turned))
    assert in_step(recording, Timing(over=True)).turned_over is not sure
    assert not in_step(recording, IN_STEP).turned_over
