"""The doctor's checks one by one, on surveys made by hand, at their limits."""

import inspect
import math
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.helpers.foreign_bags import ODOMETRY, SCAN, STORE, TF, S, laser_scan
from turtlebag.datasets.bags import doctor
from turtlebag.datasets.bags import survey as survey_module
from turtlebag.datasets.bags.decode import Cursor, RawTransform
from turtlebag.datasets.bags.message import Topic, full_type
from turtlebag.datasets.bags.survey import ScanSurvey, Survey, TopicSurvey

IMU = "sensor_msgs/msg/Imu"


def topic(name, msgtype, stamps=(), *, logged=None, frames=(), children=(), places=(), qos="", bad=0):
    return TopicSurvey(
        Topic(name, msgtype, qos=qos), list(stamps if logged is None else logged), list(stamps), list(places),
        Counter(frames), Counter(children), bad,
    )  # fmt: skip


def survey(*topics, scans=None, links=(), parents=None, link_stamps=None, notes=()):
    found = Survey(Path("x"), "mcap", {t.topic.name: t for t in topics}, scans or {}, notes=list(notes))
    for parent, child, xyz, static in links:
        values = {"parent": parent, "child": child, "xyz": xyz, "quaternion": (0.0, 0.0, 0.0, 1.0)}
        for field in inspect.signature(RawTransform).parameters:
            values.setdefault(field, 0)
        found.frames.add(RawTransform(**values), static=static)
    found.parents |= parents or {}
    found.link_stamps |= link_stamps or {}
    return found


def told(findings):
    return [(f.severity, f.check, f.what) for f in findings]


def test_notes_of_the_reader_are_missing_metadata_or_damage():
    notes = ["metadata.yaml is missing: x", "a.mcap: damaged at byte 7", "a.mcap: read up to there; y"]
    assert [f[1] for f in told(doctor._file(survey(notes=notes)))] == ["missing metadata", "damaged file"]


def test_what_a_map_needs_is_missing():
    nothing = told(doctor._missing_topics(survey(topic("/x", "a/msg/B", bad=3))))
    assert [f[1] for f in nothing] == ["no scans", "no odometry", "damaged messages"]
    assert nothing[2][2] == "/x: 3 messages cannot be decoded"
    moving = survey(topic("/scan", SCAN), link_stamps={("odom", "base"): [1]})
    assert told(doctor._missing_topics(moving)) == []
    other = survey(topic("/scan", SCAN), link_stamps={("map", "odom"): [1]})
    assert [f[1] for f in told(doctor._missing_topics(other))] == ["no odometry"]
    assert told(doctor._missing_topics(survey(topic("/scan", SCAN), topic("/odom", ODOMETRY)))) == []


def test_stamps_that_go_back_or_repeat_are_counted():
    found = told(
        doctor._backwards(
            survey(
                topic("/a", SCAN, [0, 2 * S, S, 3 * S, S // 2]),
                topic("/b", SCAN, [0, S, S, 2 * S, 2 * S]),
                topic("/c", SCAN, [5, 5, 5]),
                topic("/d", SCAN, [1, 2, 3]),
                topic("/tf", TF, [3, 2, 1]),
                link_stamps={("a", "b"): [1, 3, 2, 1], ("c", "d"): [1, 1, 2]},
            )
        )
    )
    assert found == [
        ("error", "time goes backwards", "/a: stamps go back 2 times, by up to 2.500 s"),
        ("warning", "repeated stamps", "/b: 2 messages with the stamp of the one before"),
        ("error", "time goes backwards", "/tf: a -> b goes back in time 2 times"),
    ]


def test_clocks_are_mixed_when_a_topics_lag_is_a_second_off_the_others():
    def lagging(name, lag):
        return topic(name, SCAN, [S, 2 * S, 3 * S], logged=[S + lag, 2 * S + lag, 9 * S + lag])

    for lag, odd in ((S, 0), (S + 1, 1), (-S - 8, 1)):
        found = told(doctor._clocks(survey(lagging("/a", 0), lagging("/b", 7), lagging("/c", lag + 7))))
        assert len(found) == odd
        assert all(what.startswith("/c: its stamps are 1.0 s off") for _, _, what in found)
    assert told(doctor._clocks(survey(lagging("/a", 0)))) == []
    stands = topic("/c", SCAN, [5, 5, 5], logged=[9 * S, 10 * S, 11 * S])
    assert told(doctor._clocks(survey(lagging("/a", 0), lagging("/b", 7), stands))) == []


def test_a_gap_is_five_usual_steps_and_three_tenths_of_a_second():
    for usual, longest, gaps in (
        (10**8, 5 * 10**8, 1),
        (10**8, 5 * 10**8 - 1, 0),
        (10**7, 3 * 10**8, 1),
        (10**7, 299_999_999, 0),
    ):
        times = np.cumsum([0, *[usual] * 6, longest, usual]).tolist()
        found = told(doctor._gap("/x", times[::-1], "y"))
        assert len(found) == gaps
        if gaps:
            what = f"/x: 1 gap, the longest {longest * 1e-9:.2f} s (usually {usual * 1e-9:.3f} s)"
            assert found == [("warning", "gaps", what)]
    assert told(doctor._gap("/x", [0, 1, 10 * S], "y")) == []
    many = np.cumsum([0, *[10**8] * 9, S, S, 2 * S]).tolist()
    assert "3 gaps, the longest 2.00 s" in told(doctor._gap("/x", many, "y"))[0][2]
    both = survey(
        topic("/scan", SCAN, many), topic("/imu", IMU, many), topic("/other", "a/msg/B", many),
        links=[("odom", "base", (0.0, 0.0, 0.0), False), ("map", "odom", (0.0, 0.0, 0.0), False)],
        link_stamps={("odom", "base"): many, ("map", "odom"): many, ("base", "arm"): many},
    )  # fmt: skip
    assert [w.split(":")[0] for _, _, w in told(doctor._gaps(both))] == ["/scan", "/imu", "/tf"]


AT = (0.0, 0.0, 0.0)


def test_frames_that_do_not_connect_are_named():
    scan, odom = topic("/scan", SCAN, frames=["laser"]), topic("/odom", ODOMETRY, children=["base"])
    assert [f[1] for f in told(doctor._connections(survey(scan)))] == ["no static transforms"]
    good = survey(scan, odom, links=[("base", "laser", AT, True)])
    assert told(doctor._connections(good)) == []
    lone = survey(scan, odom, topic("/tf_static", TF), links=[("base", "arm", AT, True)])
    assert [w for _, _, w in told(doctor._connections(lone))] == [
        "/scan: its frame 'laser' is not connected to 'base'"
    ]
    other = survey(odom, topic("/ground_truth/odom", ODOMETRY, children=["x"]), links=[("a", "b", AT, True)])
    assert [w for _, _, w in told(doctor._connections(other))] == [
        "/odom: its child frame 'base' is not in /tf"
    ]
    two = survey(parents={"b": {"z", "a"}, "c": {"b"}})
    assert [w for _, _, w in told(doctor._connections(two))] == ["frame 'b' has several parents: a, z"]
    assert survey(topic("/odom", ODOMETRY, children=["base"])).base() == "base"
    assert survey().base() == "base_footprint"
    assert survey(odom, links=[("base_link", "x", AT, True)]).base() == "base_link"
    assert (
        survey(topic("/o", ODOMETRY, children=["base"]), links=[("base", "x", AT, True)]).base()
        == "base_footprint"
    )


def scanned(n=11, angles=(0.0, 1.0, 0.1), times=(0.0, 0.1), limits=(0.1, 8.0), **counts):
    geometry = (*angles, *times, *limits)
    values = {"readings": 10 * n, **counts}
    return ScanSurvey(Counter({(geometry, n): 10}), **values)


@pytest.mark.parametrize(
    ("made", "says"),
    [
        (scanned(), []),
        (scanned(angles=(0.0, 1.0, 0.0)), []),
        (scanned(angles=(-0.4, 0.4, 0.0)), []),
        (scanned(angles=(0.0, 1.049, 0.1)), []),
        (
            scanned(angles=(0.0, 1.051, 0.1)),
            ["11 readings, but angle_min, angle_max and the increment imply 12"],
        ),
        (scanned(angles=(math.nan, 1.0, 0.1)), ["11 readings from nan rad on, 0.1 rad apart"]),
        (scanned(limits=(8.0, 8.0)), ["valid ranges 8..8 m"]),
        (scanned(limits=(-0.1, 8.0)), ["valid ranges -0.1..8 m"]),
        (scanned(limits=(0.0, math.inf)), ["valid ranges 0..inf m"]),
        (
            scanned(all_nan=3, no_return=2),
            ["3 of 10 scans are NaN only", "2 of 10 scans have no return at all"],
        ),
        (scanned(zeros=1), []),
        (scanned(zeros=2), ["1.8 % of the readings are 0"]),
    ],
)
def test_scans_are_judged_by_their_usual_geometry(made, says):
    found = told(doctor._scans(survey(topic("/scan", SCAN, [0, S]), scans={"/scan": made})))
    assert [what for _, _, what in found] == [f"/scan: {text}" for text in says]


def test_scans_without_a_number_or_without_a_return_are_counted_once_each():
    found, scan_topic, nan, inf = survey(), topic("/scan", SCAN), math.nan, math.inf
    for ranges in ([nan, nan], [inf, 0.0], [1.0, nan], [0.0, 2.0]):
        data = bytes(STORE.serialize_cdr(laser_scan(S, np.array(ranges)), SCAN))
        survey_module._scan(found, scan_topic, SimpleNamespace(cursor=Cursor), data)
    counted = found.scans["/scan"]
    assert (counted.readings, counted.zeros, counted.all_nan, counted.no_return) == (8, 2, 1, 1)
    assert scan_topic.stamps == [S] * 4


def test_sizes_that_vary_and_sweeps_that_overlap_are_named():
    varied = scanned()
    varied.geometries[next(iter(varied.geometries))[0], 9] = 2
    found = told(doctor._scans(survey(topic("/scan", SCAN, [0, S]), scans={"/scan": varied})))
    assert [what for _, _, what in found] == ["/scan: the number of readings varies (9..11)"]
    for increment, long in ((0.0119, 0), (0.0121, 1)):
        made = scanned(times=(increment, 0.1))
        stamps = [0, S // 10, 2 * S // 10, S]
        assert len(told(doctor._scans(survey(topic("/scan", SCAN, stamps), scans={"/scan": made})))) == long
    assert told(doctor._sweep_time("/scan", topic("/scan", SCAN, [5]), 9.0)) == []
    assert told(doctor._sweep_time("/scan", topic("/scan", SCAN, [5, 5]), 9.0)) == []


def test_quality_of_service_rotations_and_truth():
    for qos, volatile in (("durability: volatile", 1), ("durability: transient_local", 0), ("", 0)):
        found = survey(topic("/tf_static", TF, qos=qos), topic("/other", TF, qos="durability: volatile"))
        assert len(told(doctor._quality_of_service(found))) == volatile
    bad = survey()
    bad.bad_rotations["/tf"] = 4
    assert [w for _, _, w in told(doctor._rotations(bad))] == [
        "/tf: 4 quaternions are zero, not normalised or not finite"
    ]
    leak = {"odom": {"world"}, "base": {"odom"}}
    assert [
        w for _, _, w in told(doctor._truth(survey(parents=leak, link_stamps={("world", "odom"): [1]})))
    ] == ["/tf links 'world' to odom"]
    assert told(doctor._truth(survey(parents=leak))) == []


# what cannot be


def test_clocks_that_stand_and_frames_that_are_mixed():
    found = survey(
        topic("/scan", SCAN, [5 * S, 5 * S]), topic("/one", SCAN, [5]), topic("/tf", TF, [5, 5]),
        links=[("odom", "base", AT, False), ("base", "laser", AT, True)],
        link_stamps={("odom", "base"): [7 * S, 7 * S], ("base", "laser"): [7, 7]},
    )  # fmt: skip
    assert [w for _, _, w in told(doctor._still_clocks(found))] == [
        "/scan: all 2 stamps are 5 s",
        "/tf: odom -> base: all 2 stamps are 7 s",
    ]
    mixed = survey(
        topic("/scan", SCAN, frames=["a", "b", "b"]),
        topic("/odom", ODOMETRY, children=["c", "d", "d"], frames=["x"]),
    )
    assert [w for _, _, w in told(doctor._mixed_frames(mixed))] == [
        "/scan: messages of 2 frames: 'b' (2), 'a' (1)",
        "/odom: messages of 2 frames: 'd' (2), 'c' (1)",
    ]


def test_places_beyond_the_earth_and_lasers_beyond_their_robot():
    found = survey(
        topic("/odom", ODOMETRY, places=[(0.0, 2e8), (1.0, 1.0), (math.nan, 0.0)]),
        links=[("base", "far", (2e8, 0.0, 0.0), True)],
    )
    assert [w for _, _, w in told(doctor._places(found))] == [
        "/tf or /tf_static: base -> far is implausibly far away",
        "/odom: 2 poses are implausibly far away",
    ]
    for arm, named in ((30.0, 0), (30.5, 1)):
        scan = topic("/scan", SCAN, frames=["laser"])
        found = survey(scan, links=[("base_link", "laser", (arm, 0.0, 0.0), True)])
        what = [f"/scan: its frame 'laser' lies {arm:.4g} m from 'base_link'"] * named
        assert [w for _, _, w in told(doctor._units(found))] == what


def test_readings_and_drives_in_millimetres_are_named():
    long = scanned(some=[np.linspace(600.0, 4000.0, 40), np.linspace(600.0, 4000.0, 40)])
    stamps = [k * S for k in range(20)]
    fast, slow = [(200.0 * k, 0.0) for k in range(20)], [(0.2 * k, 0.0) for k in range(20)]
    found = survey(
        topic("/odom", ODOMETRY, stamps, places=[*fast[:5], (2e9, 0.0), *fast[6:]]),
        topic("/slow", ODOMETRY, stamps, places=slow),
        topic("/still", ODOMETRY, [7] * 20, logged=stamps, places=fast),
        scans={"/scan": long},
    )
    for k in range(20):
        found.frames.add(_moved(k * S, 300.0 * k), static=False)
    assert [w.split(": the")[0] for _, _, w in told(doctor._units(found))] == [
        "/scan", "/odom", "/still", "/tf: odom -> base",
    ]  # fmt: skip


def _moved(stamp, x):
    values = {
        "parent": "odom",
        "child": "base",
        "xyz": (x, 0.0, 0.0),
        "quaternion": (0.0, 0.0, 0.0, 1.0),
        "stamp_ns": stamp,
    }
    for field in inspect.signature(RawTransform).parameters:
        values.setdefault(field, 0)
    return RawTransform(**values)


def test_a_type_name_gets_the_middle_part_that_ros_1_leaves_out():
    assert [full_type(t) for t in ("a/B", "a/msg/B", "B")] == ["a/msg/B", "a/msg/B", "B"]
