"""Loops that the user rejects or adds."""

import numpy as np
import pytest

from tests.helpers.slam_rooms import ROOM, around_the_room, drifted, recording
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.slam.graph.edits import BESIDE, AddedLoop, Edits, KeyEdits, RejectedLoop, load_edits
from turtlebag.pipeline.slam.mapper import SlamConfig, run_slam

TRUE = around_the_room(150)
LOG = recording(ROOM, TRUE, odometry=drifted(TRUE))
LAST = len(LOG) - 1


@pytest.fixture(scope="module")
def usual():
    """The log as it is mapped when nobody says anything of its loops."""
    return run_slam(LOG, SlamConfig())


def closing(result):
    """Constraints of the final graph between the end and the start of the log."""
    last = len(result.keys) - 1
    return [c for c in result.constraints if min(c.i, c.j) <= BESIDE and max(c.i, c.j) >= last - BESIDE]


@pytest.mark.slow
def test_a_rejected_loop_joins_neither_loops_nor_refinement(usual):
    edits = Edits(reject=(RejectedLoop(scan=LAST, place=0),))
    parted = run_slam(LOG, SlamConfig(), edits=edits)
    assert closing(usual)
    assert not closing(parted)


@pytest.mark.slow
@pytest.mark.parametrize("swapped", [False, True])
def test_an_added_loop_is_aligned_and_judged_like_all(swapped):
    T_place_scan = SE2(TRUE[0]).inverse() @ SE2(TRUE[LAST])
    rough = T_place_scan @ SE2.from_xyt(0.2, -0.15, 0.1)
    pose, scan, place = rough, LAST, 0
    if swapped:
        pose, scan, place = rough.inverse(), 0, LAST
    added = AddedLoop(scan=scan, place=place, pose=tuple(pose.xyt))
    result = run_slam(LOG, SlamConfig(), edits=Edits(add=(added,)))
    loop = result.loops[0]
    keys = result.keys
    assert loop.accepted
    true = (SE2(TRUE[keys[loop.j]]).inverse() @ SE2(TRUE[keys[loop.i]])).xyt
    assert np.abs(loop.T_j_i - true).max() < 0.03


@pytest.mark.slow
def test_a_loop_that_a_person_adds_wrongly_is_not_believed(usual):
    wrong = AddedLoop(scan=LAST, place=LAST // 3, pose=(1.0, 1.0, 0.8))
    result = run_slam(LOG, SlamConfig(), edits=Edits(add=(wrong,)))
    assert not result.loops[0].accepted
    np.testing.assert_array_equal(result.trajectory.poses.xyt, usual.trajectory.poses.xyt)


def test_what_is_said_of_two_scans_holds_of_those_beside_them():
    keys = np.arange(0, 400, 4)
    edits = KeyEdits.of(Edits(reject=(RejectedLoop(scan=42, place=361),)), keys, 400)
    assert edits.rejects(90, np.array([3, 4, 10, 16, 17])).tolist() == [False, True, True, True, False]
    assert edits.rejects(np.array([97, 10]), np.array([10, 96])).tolist() == [False, True]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("rejects: []", "rejects: unknown key"),
        ("reject: [{scan: -1, place: 2}]", "reject.0.scan"),
        ("reject: [{scan: true, place: 2}]", "reject.0.scan"),
        ("add: [{scan: 40, place: 2}]", "add.0.pose"),
        ("add: [{scan: 40, place: 2, pose: [.nan, 0, 0]}]", "add.0.pose.0"),
        ("walls: [{do: paint, points: [[0, 0]]}]", "walls.0.do"),
        ("walls: [{do: draw, points: []}]", "walls.0.points"),
        ("walls: [{do: draw, points: [[0, .nan]]}]", "walls.0.points.0.1"),
        ("walls: [{do: draw, points: [[0, 1e9]]}]", "walls.0.points.0.1"),
        ("walls: [{do: draw, points: [[0, 0]], width: -1}]", "walls.0.width"),
        ("walls: [{do: draw, points: [[0, 0]], scan: 3}]", "scan and pose belong together"),
        ("version: 2", "version"),
        ("- 1", "expected keys and values"),
    ],
)
def test_a_bad_edits_file_is_named_with_its_key(tmp_path, text, complaint):
    file = tmp_path / "edits.yaml"
    file.write_text(text)
    with pytest.raises(InputError, match=complaint):
        load_edits(file)
