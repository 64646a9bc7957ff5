"""CARMEN logs: the meaning of their lines, and damaged ones."""

import bz2
import gzip
import math
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.carmen_lines import flaser, write
from turtlebag.datasets.bags.convert import carmen_to_mcap
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.no_return_range import no_return_value
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.relations import load_relations
from turtlebag.pipeline.slam.mapper import SlamConfig

RADISH = Path(__file__).parents[3] / "shared" / "data" / "radish"
radish = pytest.mark.skipif(not RADISH.is_dir(), reason="the public logs are not beside the repository")


def test_stamp_pose_and_beams_of_a_line(tmp_path):
    ranges = np.linspace(1.0, 2.0, 180)
    path = write(tmp_path, flaser(ranges, (0.96, 2.0, 0.0), (1.0, 2.0, 0.0), "1071078718.462310"))
    recording = load_recording(path)
    assert recording.stamps_ns.tolist() == [1071078718462310000]
    np.testing.assert_allclose(recording.ranges[0], np.round(ranges, 2), atol=1e-6)
    np.testing.assert_allclose(recording.T_odom_base.xyt, [[1.0, 2.0, 0.0]])
    np.testing.assert_allclose(recording.T_base_lidar.xyt, [-0.04, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize(
    ("beams", "last_deg", "step_deg"),
    [(180, 89.0, 1.0), (181, 90.0, 1.0), (360, 89.5, 0.5), (361, 90.0, 0.5)],
)
def test_field_of_view_follows_from_the_number_of_beams(tmp_path, beams, last_deg, step_deg):
    found = load_recording(write(tmp_path, flaser(np.ones(beams))))
    lidar = found.lidar
    assert math.degrees(lidar.angles[0]) == pytest.approx(-90.0)
    assert math.degrees(lidar.angles[-1]) == pytest.approx(last_deg)
    assert math.degrees(lidar.angle_increment) == pytest.approx(step_deg)
    assert not any("assumed" in note for note in found.notes)


def test_half_a_circle_is_assumed_and_said_of_a_number_of_beams_that_no_sick_has(tmp_path):
    found = load_recording(write(tmp_path, flaser(np.ones(91)) * 2 + flaser(np.ones(90))))
    np.testing.assert_allclose(np.degrees(found.lidar.angles), np.arange(-90.0, 91.0, 2.0), atol=1e-9)
    assert "91 beams: a field of view of 180 degrees is assumed" in found.notes
    assert "1 scan with other than 91 beams skipped" in found.notes


def test_robotlaser_line_states_its_field_of_view(tmp_path):
    readings = " ".join(["1.5"] * 5)
    line = (
        f"ROBOTLASER1 0 -2.0 4.0 1.0 30.0 0.01 0 5 {readings} 2 7 8 "
        "0.1 0.0 0.0 0.0 0.0 0.0 0.2 0.3 0.1 0.1 0.5 99.5 host 1.0\n"
    )
    recording = load_recording(write(tmp_path, line))
    np.testing.assert_allclose(recording.lidar.angles, [-2.0, -1.0, 0.0, 1.0, 2.0])
    np.testing.assert_allclose(recording.T_base_lidar.xyt, [0.1, 0.0, 0.0])
    assert recording.stamps_ns.tolist() == [99_500_000_000]


def test_far_readings_become_no_return_and_bad_ones_nan(tmp_path):
    ranges = np.full(180, 3.0)
    ranges[:4] = [81.83, 81.91, 0.0, 26.4]
    recording = load_recording(write(tmp_path, flaser(ranges)))
    assert np.isposinf(recording.ranges[0, :2]).all()
    assert np.isnan(recording.ranges[0, 2])
    assert recording.lidar.range_max == 27.0


def test_a_lidar_that_sees_far_is_not_cut_below_what_it_measures(tmp_path):
    ranges = np.full(180, 3.0)
    ranges[:3] = [49.99, 79.5, 81.83]
    recording = load_recording(write(tmp_path, flaser(ranges)))
    np.testing.assert_allclose(recording.ranges[0, :3], [49.99, 79.5, np.inf])
    assert recording.lidar.range_max == 80.0
    assert SlamConfig().usable(*recording.lidars) == 80.0
    assert SlamConfig(usable_range_m=12.0).usable(*recording.lidars) == 12.0


def test_short_range_lidar_shows_its_no_return_value_as_a_spike():
    rng = np.random.default_rng(0)
    readings = rng.uniform(0.5, 5.0, (100, 180))
    readings[:, :20] = 5.6
    assert no_return_value(readings) == 5.6
    assert no_return_value(rng.uniform(0.5, 5.0, (100, 180))) == math.inf


def test_file_order_survives_stamps_that_go_back(tmp_path):
    text = "".join(flaser(np.ones(180), stamp=s) for s in ("3.0", "1.0", "2.0"))
    recording = load_recording(write(tmp_path, text))
    assert recording.stamps_ns.tolist() == [3 * 10**9, 10**9, 2 * 10**9]
    assert any("go back" in note for note in recording.notes)


def drive(readings=1.0, poses=1.0, stamp=lambda k: f"{k}.000000"):
    ranges = np.linspace(1.0, 2.5, 180)
    lines = [flaser(ranges * readings, *2 * [(0.2 * k * poses, 0.0, 0.1)], stamp(k)) for k in range(9)]
    return "".join(lines)


@pytest.mark.parametrize(
    ("changes", "note"),
    [
        ({"readings": 1000.0}, "the readings exceed any lidar's range; read as millimetres"),
        ({"poses": 1000.0}, "the robot would be implausibly fast; its poses read as millimetres"),
    ],
)
def test_millimetres_are_told_and_made_metres(tmp_path, changes, note):
    good = load_recording(write(tmp_path, drive()))
    found = load_recording(write(tmp_path, drive(**changes)))
    assert found.notes == (*good.notes, note)
    np.testing.assert_allclose(found.ranges, good.ranges, atol=0.006)
    np.testing.assert_allclose(found.T_odom_base.xyt, good.T_odom_base.xyt, atol=1e-9)
    assert found.lidar.range_max == good.lidar.range_max


def test_a_clock_that_stands_is_told(tmp_path):
    found = load_recording(write(tmp_path, drive(stamp=lambda k: "0.0")))
    assert found.notes == ("every stamp is 0.000000; only the order of the file is known",)


def test_a_pose_beyond_the_earth_is_damage(tmp_path):
    text = drive() + flaser(np.ones(180), (1e12, 0.0, 0.0), (1e12, 0.0, 0.0), "9.0")
    found = load_recording(write(tmp_path, text))
    assert len(found) == 9
    assert "1 damaged line skipped, the first is line 10" in found.notes


def test_damaged_lines_are_skipped_and_counted(tmp_path):
    good = flaser(np.ones(180))
    bad = [
        good[:300] + "\n",
        good.replace("1.00", "x.yz", 1),
        "FLASER many 1 2\n",
        good.replace("nohost", ""),
    ]
    bad.append(flaser(np.ones(180), robot=(math.nan, 0.0, 0.0)))
    recording = load_recording(write(tmp_path, good + "".join(bad) + good + flaser(np.ones(90))))
    assert len(recording) == 2
    assert any(note.startswith("5 damaged lines skipped, the first is line 2") for note in recording.notes)
    assert any("other than 180 beams" in note for note in recording.notes)


def test_parameter_places_the_laser_when_the_poses_do_not(tmp_path):
    text = "PARAM robot_frontlaser_offset -0.04 0 h 0\n" + flaser(np.ones(180))
    np.testing.assert_allclose(load_recording(write(tmp_path, text)).T_base_lidar.xyt, [-0.04, 0.0, 0.0])


@pytest.mark.slow
@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress])
def test_packed_logs_read_the_same_and_cut_ones_up_to_the_cut(tmp_path, pack):
    rng = np.random.default_rng(1)
    text = "".join(flaser(rng.uniform(1, 9, 180), stamp=f"{k}.5") for k in range(2000))
    plain = load_recording(write(tmp_path, text))
    packed = pack(text.encode())
    path = tmp_path / "a.clf.packed"
    path.write_bytes(packed)
    whole = load_recording(path)
    np.testing.assert_array_equal(plain.ranges, whole.ranges)
    path.write_bytes(packed[: len(packed) * 2 // 3])
    cut = load_recording(path)
    assert any("ends early" in note for note in cut.notes)
    assert 0 < len(cut) < 2000
    np.testing.assert_array_equal(cut.ranges, plain.ranges[: len(cut)])


@pytest.mark.parametrize("kind", ["cut", "flip", "swap"])
def test_random_damage_ends_in_scans_or_one_clear_line(tmp_path, kind):
    rng = np.random.default_rng(3)
    good = "".join(flaser(rng.uniform(1, 9, 20), stamp=f"{k}.5") for k in range(30)).encode()
    for _ in range(60):
        damaged = bytearray(good)
        if kind == "cut":
            del damaged[int(rng.integers(1, len(good))) :]
        elif kind == "flip":
            for place in rng.integers(0, len(good), 5):
                damaged[place] = int(rng.integers(256))
        else:
            a, b = np.sort(rng.integers(0, len(good), 2))
            damaged[a:b] = damaged[a:b][::-1]
        path = tmp_path / "a.clf"
        path.write_bytes(damaged)
        try:
            recording = load_recording(path)
        except InputError:
            continue
        assert recording.ranges.shape == (len(recording), recording.lidar.n_beams)
        assert np.isfinite(recording.T_odom_base.xyt).all()
        assert np.isfinite(recording.lidar.range_max)
        assert np.isfinite(recording.T_base_lidar.xyt).all()


@pytest.mark.parametrize("stamp", ["1e400", "9" * 30, "nan", "-", "1.5.5", "-3.5"])
def test_impossible_stamps_are_damage(tmp_path, stamp):
    text = flaser(np.ones(180)) + flaser(np.ones(180), stamp=stamp)
    recording = load_recording(write(tmp_path, text))
    assert len(recording) == 1
    assert any("1 damaged line" in note for note in recording.notes)


def test_relations_are_read(tmp_path):
    path = write(tmp_path, "# comment\n1.5 2.5 0.1 0.2 0 0 0 -0.3\n", "a.relations")
    relations = load_relations(path)
    assert relations.stamps_a_ns.tolist() == [1_500_000_000]
    np.testing.assert_allclose(relations.T_a_b.xyt, [[0.1, 0.2, -0.3]])


@pytest.mark.slow
@radish
@pytest.mark.parametrize(
    ("name", "scans", "beams", "offset"), [("fr079", 4934, 360, -0.04), ("mit-csail", 1988, 361, 0.0)]
)
def test_public_logs(name, scans, beams, offset):
    recording = load_recording(RADISH / f"{name}.clf.bz2")
    assert recording.ranges.shape == (scans, beams)
    assert recording.T_base_lidar.xyt.tolist() == [offset, 0.0, 0.0]
    relations = load_relations(RADISH / f"{name}.relations")
    # The relations of CSAIL carry five decimals, its log six.
    nearest = np.abs(relations.stamps_a_ns[:, None] - recording.stamps_ns).min(axis=1)
    assert nearest.max() <= 10_000


def test_scans_of_a_rear_laser_are_counted_and_nothing_else_is_called_one(tmp_path):
    front, rear = flaser(np.ones(5)), flaser(np.ones(5)).replace("FLASER", "RLASER")
    notes = load_recording(write(tmp_path, f"ODOM 0 0 0 0 0 0 1.0 host 1.0\n{front}{rear}{rear}")).notes
    assert any(note.startswith("2 ") and "rear" in note.lower() for note in notes)
    notes = load_recording(write(tmp_path, f"ODOM 0 0 0 0 0 0 1.0 host 1.0\n{front}", "b.clf")).notes
    assert not any("rear" in note.lower() for note in notes)


def robotlaser(ranges, first, stamp):
    readings = " ".join(f"{r:.2f}" for r in ranges)
    head = (
        f"ROBOTLASER1 0 {first:.6f} 3.141593 {math.radians(1.0):.6f} 81.9 0.01 0 {len(ranges)} {readings} 0 "
    )
    return head + f"0.0 0.0 0.0 0.0 0.0 0.0 0.2 0.3 0.1 0.1 0.5 {stamp} host 1.0\n"


def test_interlaced_scans_of_several_geometries_are_all_kept_at_their_own_angles(tmp_path):
    """Four start angles a quarter of a degree apart, 181 beams and 180, as SICKs interlace."""
    starts = -math.pi / 2 + math.radians(0.25) * np.array([0, 1, 2, 3] * 5)
    lines, walls = [], []
    for k, first in enumerate(starts):
        angles = first + math.radians(1.0) * np.arange(181 if k % 4 == 0 else 180)
        walls.append(2.0 + 0.5 * np.sin(3.0 * angles) + 0.01 * k)
        lines.append(robotlaser(walls[-1], first, stamp=k + 0.5))
    path = write(tmp_path, "".join(lines))
    found = load_recording(path)
    assert found.stamps_ns.tolist() == [round((k + 0.5) * 1e9) for k in range(20)]
    for k, (row, wall) in enumerate(zip(found.ranges, walls, strict=True)):
        angles, measured = found.lidar.angles[np.isfinite(row)], row[np.isfinite(row)]
        np.testing.assert_allclose(measured, wall, atol=0.006)
        np.testing.assert_allclose(measured, 2.0 + 0.5 * np.sin(3.0 * angles) + 0.01 * k, atol=0.006)
    carmen_to_mcap(found, tmp_path / "bag")
    again = load_recording(tmp_path / "bag")
    np.testing.assert_array_equal(again.ranges, found.ranges)
    np.testing.assert_allclose(again.lidar.angles, found.lidar.angles, atol=1e-5)
    np.testing.assert_allclose(again.T_odom_base.xyt, found.T_odom_base.xyt, atol=1e-9)


@pytest.mark.parametrize("first", [math.nan, 1e300])
def test_scans_without_directions_are_damage(tmp_path, first):
    good = "".join(robotlaser(np.ones(5), -1.0, k) for k in (1.0, 2.0))
    found = load_recording(write(tmp_path, good + robotlaser(np.ones(5), first, 3.0)))
    assert len(found) == 2
    assert "1 damaged line skipped, the first is line 3" in found.notes
    with pytest.raises(InputError, match="only damaged scan lines"):
        load_recording(write(tmp_path, robotlaser(np.ones(5), first, 3.0)))


def test_half_circles_of_both_resolutions_are_all_kept(tmp_path):
    text = "".join(flaser(np.linspace(1.0, 2.0, n), stamp=f"{n}.5") for n in (180, 361, 180))
    found = load_recording(write(tmp_path, text))
    # the last of 361 beams lies beyond the view of the others
    assert np.isfinite(found.ranges).sum(axis=1).tolist() == [180, 360, 180]


def test_fields_may_be_parted_by_tabs(tmp_path):
    spaces = flaser(np.linspace(1.0, 2.0, 180), robot=(1.0, 2.0, 0.5))
    found = load_recording(write(tmp_path, spaces.replace(" ", "\t") * 2))
    expected = load_recording(write(tmp_path, spaces * 2, "b.clf"))
    np.testing.assert_array_equal(found.ranges, expected.ranges)
    np.testing.assert_array_equal(found.T_odom_base.xyt, expected.T_odom_base.xyt)


@pytest.mark.parametrize(("stated", "beyond"), [(26.0, True), (3.0, False)])
def test_a_reading_at_the_stated_maximum_is_no_return_unless_most_are_longer(tmp_path, stated, beyond):
    ranges = np.linspace(4.0, 26.0, 180)
    lines = [robotlaser(ranges, -math.pi / 2, k + 0.5).replace(" 81.9 ", f" {stated} ") for k in range(3)]
    found = load_recording(write(tmp_path, "".join(lines))).ranges
    assert np.isposinf(found[:, -1]).all() == beyond
    assert np.isfinite(found[:, :-1]).all()


def test_a_sick_that_sees_eighty_metres_may_see_them(tmp_path):
    ranges = np.linspace(1.0, 81.8, 180)
    found = load_recording(write(tmp_path, "".join(flaser(ranges, stamp=f"{k}.5") for k in range(3))))
    assert np.isfinite(found.ranges).all()
    assert found.lidar.range_max > 81.8
