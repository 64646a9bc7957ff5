"""From a recording to a map: accuracy, robustness, files, and the exits of the command."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.carmen_lines import carmen_text
from tests.helpers.slam_rooms import LDS, ROOM, around_the_room, drifted, recording
from turtlebag.datasets.grid import FREE, OCCUPIED, UNKNOWN
from turtlebag.datasets.relations import Relations
from turtlebag.datasets.se2 import SE2, compose
from turtlebag.datasets.types import Trajectory
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.slam.explain import loop_record, worst_edges
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind
from turtlebag.pipeline.slam.graph.cost import mahalanobis
from turtlebag.pipeline.slam.graph.pose_graph import optimise
from turtlebag.pipeline.slam.grid import (
    Counts,
    OccupancyConfig,
    beam_lengths,
    certainty,
    classify,
    make_grid,
    trace,
)
from turtlebag.pipeline.slam.mapper import SlamConfig, run_slam
from turtlebag.reports.metrics.relations import relations_metrics
from turtlebag.reports.metrics.trajectory import ate

TRUTH = around_the_room(150, laps=1.5)


@pytest.fixture(scope="module")
def log():
    """One lap and a half of the room with drifting odometry."""
    return recording(ROOM, TRUTH, odometry=drifted(TRUTH))


@pytest.fixture(scope="module")
def result(log):
    return run_slam(log, SlamConfig())


@pytest.fixture(scope="module")
def with_loops(log):
    """The map whose loops are not left to the refinement."""
    return run_slam(log, SlamConfig.model_validate({"loops": {"held_m": 0.0}}))


@pytest.fixture(scope="module")
def by_wheels(log):
    return run_slam(log, SlamConfig(sensors="odometry"))


def error(result, log):
    return ate(result.trajectory, Trajectory(log.stamps_ns, SE2.from_array(TRUTH)), align=False)


@pytest.mark.slow
def test_every_scan_is_within_a_centimetre(log, result):
    raw = ate(
        Trajectory(log.stamps_ns, log.T_odom_base), Trajectory(log.stamps_ns, SE2.from_array(TRUTH)), False
    )
    assert raw["rmse"] > 0.2
    assert len(result.trajectory) == len(log)
    found = error(result, log)
    assert found["rmse"] < 0.008
    assert found["max"] < 0.03
    assert result.check.verdict == "good"


@pytest.mark.slow
def test_places_held_well_enough_are_left_to_the_refinement_if_there_is_one(log, result, with_loops):
    loops = sum(loop.accepted for loop in result.loops)
    for every in (with_loops, run_slam(log, SlamConfig.model_validate({"refine": {"rounds": 0}}))):
        assert sum(loop.accepted for loop in every.loops) >= loops + 3


@pytest.mark.slow
def test_same_recording_same_result(log, result):
    again = run_slam(log, SlamConfig())
    np.testing.assert_array_equal(again.trajectory.poses.xyt, result.trajectory.poses.xyt)
    np.testing.assert_array_equal(again.grid.cells, result.grid.cells)


@pytest.mark.slow
def test_odometry_that_runs_backwards_is_not_believed(log):
    lying = drifted(TRUTH)
    steps = (SE2(lying[:-1]).inverse() @ SE2(lying[1:])).xyt
    steps[60:90, 0] *= -1.0
    steps[120] += [0.0, 0.0, 1.2]
    poses = [lying[0]]
    for step in steps:
        poses.append((SE2(poses[-1]) @ SE2(step)).xyt)
    liar = replace(log, T_odom_base=SE2.from_array(np.array(poses)))
    assert error(run_slam(liar, SlamConfig()), log)["rmse"] < 0.01


@pytest.mark.slow
def test_odometry_of_another_drive_is_left_out_and_said(log, result):
    rng, poses = np.random.default_rng(0), [np.zeros(3)]
    for v, w in np.repeat(rng.uniform(-0.3, 0.3, (25, 2)), 8, axis=0)[1 : len(log)]:
        poses.append(compose(poses[-1], np.array([v, 0.0, w])))
    other = replace(log, T_odom_base=SE2.from_array(np.array(poses)))
    alone = run_slam(other, SlamConfig())
    assert alone.session.recording.T_odom_base is None
    assert any("does not turn when the scans do" in note for note in alone.session.recording.notes)
    truth = Trajectory(log.stamps_ns, SE2.from_array(TRUTH))
    assert ate(alone.trajectory, truth, align=True)["rmse"] < 0.015
    assert result.session.recording.T_odom_base is not None


@pytest.mark.slow
def test_lidar_alone_suffices_in_a_room(log):
    result = run_slam(replace(log, T_odom_base=None), SlamConfig())
    truth = Trajectory(log.stamps_ns, SE2.from_array(TRUTH))
    assert ate(result.trajectory, truth, align=True)["rmse"] < 0.015
    np.testing.assert_allclose(result.trajectory.poses.xyt[0], 0.0, atol=0.02)


@pytest.mark.slow
def test_odometry_alone_is_the_odometry(log, by_wheels):
    np.testing.assert_allclose(by_wheels.trajectory.poses.xyt, log.T_odom_base.xyt, atol=1e-9)


@pytest.mark.slow
def test_scans_without_a_return_are_carried_by_odometry(log):
    ranges = log.ranges.copy()
    ranges[:3] = np.nan
    ranges[50:58] = np.inf
    holed = run_slam(replace(log, ranges=ranges), SlamConfig())
    # the first three scans fix nothing, so the map starts where odometry carried it
    truth = Trajectory(log.stamps_ns, SE2.from_array(TRUTH))
    assert ate(holed.trajectory, truth, align=True)["rmse"] < 0.01


@pytest.mark.slow
def test_a_log_of_nothing_is_mapped_to_nothing(log):
    empty = replace(log, ranges=np.full_like(log.ranges, np.nan))
    result = run_slam(empty, SlamConfig())
    assert np.all(result.grid.cells == UNKNOWN)
    assert result.check.verdict == "doubtful"


@pytest.mark.slow
def test_map_shows_the_walls_and_clears_the_rest(result):
    grid = result.grid
    along = np.stack([np.linspace(0.5, 7.5, 100), np.full(100, 5.99)], axis=1)
    near = np.stack([grid.value_at(along + np.array([0.0, dy])) for dy in (-0.05, 0.0, 0.05)])
    assert np.mean((near == OCCUPIED).any(axis=0)) > 0.97
    assert np.all(grid.value_at(TRUTH[:, :2]) == FREE)
    occupied = grid.center_of(np.argwhere(grid.cells == OCCUPIED))
    distance = np.min(
        [np.abs(occupied[:, 0] - x) for x in (0, 8, 3, 3.5, 6, 6.4)]
        + [np.abs(occupied[:, 1] - y) for y in (0, 6, 2, 4, 1.5)],
        axis=0,
    )
    assert np.mean(distance < 0.05) > 0.99


def test_beams_follow_their_cells():
    hits, misses = np.zeros((20, 20), dtype=np.uint16), np.zeros((20, 20), dtype=np.uint16)
    direction = np.array([0.8, 0.6])
    trace(Counts(hits, misses), (2.5, 3.3), tuple(direction), 15.0, True, 0.25)
    # reference: the cells of finely spaced points on the beam, all but the last one before the end
    s = np.linspace(0.0, 14.0, 20001)
    crossed = {(int(3.3 + 0.6 * d), int(2.5 + 0.8 * d)) for d in s}
    touched = {tuple(cell) for cell in np.argwhere(misses > 0).tolist()}
    end = (int(3.3 + 0.6 * 15.0), int(2.5 + 0.8 * 15.0))
    assert crossed - {end} <= touched
    assert len(touched - crossed) <= 1
    assert hits[end] == 1
    assert hits.sum() == 1
    assert misses.max() == 1


def test_open_beams_clear_and_dropouts_do_not():
    ranges = np.array([[2.0, np.inf, 2.0, np.inf, np.inf, np.nan, 9.0, -np.inf]], dtype=np.float32)
    length, returned = beam_lengths(ranges, replace(LDS, range_min=0.1, range_max=10.0), 8.0, 5.0)
    np.testing.assert_array_equal(returned[0], [True, False, True, False, False, False, False, False])
    np.testing.assert_allclose(length[0], [2.0, 0.0, 2.0, 5.0, 5.0, 0.0, 8.0, 0.0])


def test_open_space_is_cleared_to_the_range():
    log = recording(ROOM + 100.0, np.zeros((3, 3)), LDS)
    assert np.all(np.isposinf(log.ranges))
    grid = make_grid(log, SE2.identity(3), OccupancyConfig(), 30.0)
    angle = np.linspace(0.0, 6.28, 50)[:, None]
    disc = 2.5 * np.hstack([np.cos(angle), np.sin(angle)])
    assert np.all(grid.value_at(disc) == FREE)
    assert np.any(grid.value_at(3.1 * disc) == FREE)
    assert not np.any(grid.value_at(3.4 * disc) == FREE)
    off = make_grid(log, SE2.identity(3), OccupancyConfig(no_return_m=0.0), 30.0)
    assert np.all(off.cells == UNKNOWN)


def test_grid_says_how_decided_its_cells_are():
    hits = np.array([[4, 0, 2, 0, 1]], dtype=np.uint16)
    misses = np.array([[0, 4, 2, 0, 1]], dtype=np.uint16)
    found = certainty(Counts(hits, misses), 2)
    # cells met by three beams: certain, certain, one bit
    assert found.entropy_bits == pytest.approx(1.0 / 3.0)
    assert found.wall_share == pytest.approx(0.75)
    assert np.isnan(certainty(Counts.none(1, 5), 2).entropy_bits)


@pytest.mark.slow
def test_map_drawn_along_drifting_wheels_is_called_doubtful(by_wheels, result):
    along = by_wheels.check
    assert any("contradict each other" in reason for reason in along.reasons)
    said = result.check.as_metrics()
    assert said["wall_share"] > 2.0 * along.wall_share
    assert said["map_entropy_bits"] < 0.7 * along.map_entropy_bits


def test_cells_are_what_most_beams_say():
    hits = np.array([[0, 0, 1, 2, 9, 1]], dtype=np.uint16)
    misses = np.array([[0, 3, 0, 1, 60, 9]], dtype=np.uint16)
    cells = classify(Counts(hits, misses), OccupancyConfig())
    assert cells.tolist() == [[UNKNOWN, FREE, UNKNOWN, OCCUPIED, FREE, FREE]]


def test_graph_spreads_a_square_s_error_and_shrugs_off_a_false_loop():
    leg = np.array([1.0, 0.0, np.pi / 2])
    information = np.diag([1e4, 1e4, 1e4])
    rough = [np.zeros(3)]
    for k in range(4):
        rough.append((SE2(rough[-1]) @ SE2(leg + np.array([0.02, 0.0, 0.01 * k]))).xyt)
    graph = [Constraint(k, k + 1, leg, information, Kind.STEP) for k in range(4)]
    loop = Constraint(0, 4, np.zeros(3), information, Kind.LOOP, 2.0)
    false = Constraint(1, 3, np.array([3.0, 3.0, 1.0]), information, Kind.LOOP, 2.0)
    poses = optimise(SE2.from_array(np.array(rough)), [*graph, loop, false])
    np.testing.assert_allclose(poses.xyt[2, :2], [1.0, 1.0], atol=0.02)
    np.testing.assert_allclose(poses.xyt[4, :2], [0.0, 0.0], atol=0.02)
    squared = mahalanobis(poses, [*graph, loop, false])
    assert int(np.argmax(squared)) == 5


def test_relations_by_both_definitions():
    poses = SE2.from_array([[0.0, 0.0, 0.0], [1.0, 0.0, np.pi / 2]])
    estimate = Trajectory(np.array([10**9, 2 * 10**9]), poses)
    expected = SE2.from_array([[1.0, 0.1, np.pi / 2 - 0.1]])
    relations = Relations(np.array([10**9 + 4000]), np.array([2 * 10**9]), expected)
    found = relations_metrics(estimate, relations)
    assert found["relations"]["n"] == 1
    assert found["relations"]["trans_m"]["mean"] == pytest.approx(0.1)
    assert found["relations"]["rot_deg"]["mean"] == pytest.approx(np.rad2deg(0.1))
    # (p1^-1 p2) * expected^-1: translation (1, 0) - R(0.1) (1, 0.1)
    c, s = np.cos(0.1), np.sin(0.1)
    by_hand = np.hypot(1.0 - (c - 0.1 * s), -(s + 0.1 * c))
    assert found["relations_cartographer"]["trans_m"]["mean"] == pytest.approx(by_hand)
    away = Relations(np.array([5]), np.array([2 * 10**9]), expected)
    assert relations_metrics(estimate, away)["relations"]["trans_m"]["mean"] is None


@pytest.mark.slow
def test_explanation_names_every_loop(with_loops):
    record = loop_record(with_loops)
    assert len(record["loops"]) == len(with_loops.loops) > 0
    assert all(loop["residual_m"] < 0.05 for loop in record["loops"] if loop["verdict"] == "accepted")
    edges = worst_edges(with_loops.T_map_keys, with_loops.constraints)
    assert [edge["sigmas"] for edge in edges] == sorted((edge["sigmas"] for edge in edges), reverse=True)


@pytest.mark.slow
def test_command_writes_the_contract_s_files(tmp_path, log):
    source = tmp_path / "room.clf"
    source.write_text(carmen_text(replace(log, ranges=log.ranges[:60], stamps_ns=log.stamps_ns[:60])))
    out = tmp_path / "map"
    assert main(["map", str(source), "--out", str(out), "--explain", "-q"]) == 0
    names = {path.name for path in out.iterdir()}
    assert {"map.pgm", "map.yaml", "trajectory.tum", "graph.g2o", "metrics.json", "config.yaml"} <= names
    assert {"manifest.json", "graph.json", "explain.json", "before.pgm"} <= names
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["scans"] == 60
    assert set(metrics["loops"]) == {"proposed", "accepted", "rejected"}
    assert len((out / "trajectory.tum").read_text().splitlines()) == 60
    assert main(["map", str(source), "--out", str(out), "-q"]) == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--set", "grid.resolution_m=0"], "resolution_m"),
        (["--set", "nonsense=1"], "nonsense"),
        (["--truth", "nowhere"], "truth"),
        (["--relations", "nowhere"], "relations"),
    ],
)
def test_bad_arguments_write_nothing(tmp_path, capsys, log, arguments, says):
    source = tmp_path / "room.clf"
    source.write_text(carmen_text(replace(log, ranges=log.ranges[:2], stamps_ns=log.stamps_ns[:2])))
    assert main(["map", str(source), "--out", str(tmp_path / "map"), *arguments]) == 2
    captured = capsys.readouterr().err
    assert says in captured
    assert captured.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["room.clf"]


@pytest.mark.slow
def test_relations_of_another_log_are_refused(tmp_path, capsys, log):
    source, relations, out = tmp_path / "room.clf", tmp_path / "other.relations", tmp_path / "map"
    source.write_text(carmen_text(replace(log, ranges=log.ranges[:2], stamps_ns=log.stamps_ns[:2])))
    relations.write_text("9e8 9.1e8 1 0 0 0 0 0\n")
    assert main(["map", str(source), "--relations", str(relations), "--out", str(out), "-q"]) == 2
    said = f"turtlebag: {relations}: no relation in it is between two scans of this recording\n"
    assert capsys.readouterr().err == said
    assert not out.exists()
