"""The self-check names each thing that is wrong, and nothing where all is well."""

from dataclasses import replace

import numpy as np
import pytest

from datasets.se2 import SE2
from pipeline.slam.clouds import Clouds, make_clouds
from pipeline.slam.occupancy import Certainty
from pipeline.slam.selfcheck import SelfCheckConfig, check_map
from pipeline.slam.track import Track
from tests.slam_rooms import ROOM, around_the_room, dead_reckoning, recording

NONE = np.zeros(0, dtype=np.int64)
SURE = Certainty(0.1, 0.9)


@pytest.fixture(scope="module")
def drive() -> tuple[Clouds, Track]:
    """A lap round the room, at the true poses, every scan fitting."""
    poses = around_the_room(60)
    log = recording(ROOM, poses, odometry=poses)
    clouds = make_clouds(log, 30.0)
    track = dead_reckoning(log, clouds)
    return clouds, replace(track, overlap=np.ones(60), information=np.tile(np.eye(3), (60, 1, 1)))


def reasons(drive, breaks=NONE, certainty=SURE, **changes):
    clouds, track = drive
    T_map_keys = track.T_track_base[track.keys]
    return check_map(
        clouds, replace(track, **changes), T_map_keys, SelfCheckConfig(), breaks, certainty
    ).reasons


def test_a_good_map_has_nothing_against_it(drive):
    assert reasons(drive) == ()


def test_scans_that_fit_nothing_are_counted(drive):
    overlap = np.ones(60)
    overlap[20:40] = 0.05
    assert reasons(drive, overlap=overlap) == ("20 scans do not fit the map (first: scan 20)",)


def test_scans_without_surfaces_are_counted(drive):
    assert reasons(drive, usable=np.arange(60) >= 5) == ()
    assert reasons(drive, usable=np.arange(60) >= 7) == ("7 scans see no surface",)


def test_breaks_that_nothing_mends_are_named(drive):
    (reason,) = reasons(drive, breaks=np.array([12, 30]))
    assert reason.startswith("2 breaks where scans are missing")
    assert "before scan 12" in reason


def test_walls_that_beams_pass_through_are_told(drive):
    (reason,) = reasons(drive, certainty=Certainty(0.6, 0.25))
    assert reason == "beams pass through the walls: they return 25% of those that meet them"


@pytest.mark.parametrize(("shift", "doubled"), [(0.0, False), (0.8, True)])
def test_a_room_drawn_twice_contradicts_itself(shift, doubled):
    poses = around_the_room(120, laps=2)
    log = recording(ROOM, poses, odometry=poses)
    clouds = make_clouds(log, 30.0)
    track = replace(dead_reckoning(log, clouds), overlap=np.ones(120))
    drawn = track.T_track_base[track.keys].xyt.copy()
    drawn[len(drawn) // 2 :] += [shift, 0.0, 0.0]
    found = check_map(clouds, track, SE2(drawn), SelfCheckConfig(apart_keys=10), NONE, SURE)
    assert found.revisits > 20
    assert any("contradict each other" in reason for reason in found.reasons) == doubled
