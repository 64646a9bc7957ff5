"""Other systems beside ours: whatever their frame, clock and rate, and what is wrong with them is said."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from tests.helpers.report_fakes import (
    ellipse,
    fake_localise,
    fake_map,
    fake_record,
    mapped_room,
    noisy,
    true_room,
    unrendered,
)
from turtlebag.datasets.grid import FREE, OCCUPIED, OccupancyGrid
from turtlebag.datasets.maps import save_map
from turtlebag.datasets.other_systems import System, SystemFiles
from turtlebag.datasets.relations import Relations
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.trajectories import load_tum, save_tum
from turtlebag.datasets.trajectories_3d import Trajectory3D
from turtlebag.datasets.types import Trajectory
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.stages.compare import compare_with_systems
from turtlebag.pipeline.stages.verify import verify
from turtlebag.reports.figures.album import Album
from turtlebag.reports.metrics.map import map_metrics, walls
from turtlebag.reports.metrics.map_alignment import place
from turtlebag.reports.metrics.relations import relations_metrics
from turtlebag.reports.metrics.systems import References, measure
from turtlebag.reports.system_comparison import compare_systems

ELSEWHERE = SE2.from_xyt(5.0, 3.0, 2.0)


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    """A record, a map of ours, and another system's trajectory and map in another frame."""
    base = tmp_path_factory.mktemp("systems")
    record = fake_record(base / "record")
    fake_map(base / "map", record)
    poses = noisy(load_tum(record / "truth/trajectory.tum"), 0.03)
    save_tum(Trajectory(poses.stamps_ns, ELSEWHERE @ poses.poses), base / "carto.tum")
    grid = mapped_room()
    save_map(replace(grid, T_map_grid=ELSEWHERE @ grid.T_map_grid), base, "carto")
    return base


def carto(tree, **changes):
    return SystemFiles(**{"name": "carto", "trajectory": tree / "carto.tum", **changes})


def test_another_system_in_another_frame_is_measured_by_the_same_numbers_as_ours(tree):
    found = compare_with_systems(tree / "map", [carto(tree, map=tree / "carto.yaml")])
    told = json.loads((tree / "map/metrics.json").read_text())
    ours, other = (found.metrics["systems"][name] for name in ("TurtleBag", "carto"))
    assert ours["ate_m"]["rmse"] == pytest.approx(told["ate_m"]["rmse"], rel=1e-6)
    assert ours["ate_aligned_m"]["rmse"] == pytest.approx(told["ate_aligned_m"]["rmse"], rel=1e-6)
    assert ours["rpe"] == pytest.approx(told["rpe"], rel=1e-6)
    assert other["ate_m"]["rmse"] > 3.0
    assert other["ate_aligned_m"]["rmse"] == pytest.approx(0.03 * np.sqrt(2.0), rel=0.1)
    assert other["ate_aligned_3d_m"]["rmse"] == pytest.approx(other["ate_aligned_m"]["rmse"], rel=1e-6)
    assert other["map"]["occupied_error_m"]["within_one_cell"] > 0.96
    assert other["map_moved"] == pytest.approx(ELSEWHERE.inverse().xyt.tolist(), abs=0.02)
    assert re.search(r"map was moved by .* m and turned by \S+° to align", str(found.notes))
    assert "TurtleBag 0.7" in found.sentence
    best = {row.spec.path: [text == row.best for text in row.texts] for row in found.rows}
    assert best["ate_aligned_m.rmse"] == [True, False]
    assert best["poses"] == [False, False]


def test_missing_stretches_other_stamps_and_poses_past_the_end_are_said(tree, tmp_path):
    whole = load_tum(tree / "carto.tum")
    kept = np.ones(len(whole), dtype=bool)
    kept[60:85] = kept[:10] = False
    late = Trajectory(whole.stamps_ns[kept] + 60_000_000, whole.poses[kept])
    save_tum(late, tmp_path / "late.tum")
    found = compare_with_systems(tree / "map", [SystemFiles("late", tmp_path / "late.tum")])
    notes = " ".join(note for _, note in found.notes)
    assert "no poses for 2.1 s at the start, 1 stretch in between (up to 5.2 s)" in notes
    assert "the reference was interpolated" in notes
    assert "1 of its 115 poses lies outside" in notes
    numbers = found.metrics["systems"]["late"]
    assert numbers["coverage"] == pytest.approx((29.8 - 2.06 - 5.2) / 29.8, abs=0.01)
    assert numbers["ours_there"]["paired"] < found.metrics["systems"]["TurtleBag"]["paired"]


def test_a_rate_of_its_own_changes_little(tree, tmp_path):
    fine = noisy(Trajectory(np.arange(0, 29 * 10**9, 10**7), SE2.identity(2900)), 0.0)
    truth = load_tum(tree / "record/truth/trajectory.tum")
    save_tum(Trajectory(fine.stamps_ns, truth.at(fine.stamps_ns)), tmp_path / "fast.tum")
    save_tum(Trajectory(truth.stamps_ns[::13], truth.poses[::13]), tmp_path / "slow.tum")
    others = [SystemFiles(name, tmp_path / f"{name}.tum") for name in ("fast", "slow")]
    systems = compare_with_systems(tree / "map", others).metrics["systems"]
    assert systems["fast"]["ate_aligned_m"]["rmse"] < 0.002
    assert systems["slow"]["ate_aligned_m"]["rmse"] < 1e-6
    assert systems["slow"]["paired"] == 12


def test_without_a_truth_the_others_are_measured_against_ours():
    path = Trajectory3D.of(Trajectory(np.arange(150, dtype=np.int64) * 200_000_000, ellipse()[::6]))
    moved = Trajectory3D(path.stamps_ns, path.T.copy())
    moved.T[:, 0, 3] += 2.0
    a, b = np.array([0, 51]), np.array([30, 141])
    poses = path.planar().poses
    pairs = Relations(path.stamps_ns[a] + 1000, path.stamps_ns[b], poses[a].inverse() @ poses[b])
    thin = moved[np.arange(150) % 3 != 0]
    ours, other = measure(
        System("TurtleBag", path, None), [System("r", thin, None)], References(relations=pairs)
    )
    assert "ate_m" not in ours.numbers
    assert other.numbers["ate_m"]["rmse"] == pytest.approx(2.0, abs=1e-6)
    assert other.numbers["ate_aligned_m"]["rmse"] < 1e-6
    # It has no poses at these stamps: they are interpolated between its own.
    assert relations_metrics(thin.planar(), pairs)["relations"]["n"] == 0
    assert other.numbers["relations"]["n"] == 1
    assert other.numbers["relations"]["trans_m"]["mean"] < 0.01
    two = [ours, other, replace(other, system=System("s", thin, None))]
    found = compare_systems(two, References(relations=pairs), Album(None), "x")
    assert found.sentence.startswith("Mean relations error: TurtleBag 0.0000")
    bare = measure(System("TurtleBag", path, None), [one.system for one in two[1:]], References())
    nothing = compare_systems(bare, References(), Album(None), "x")
    assert not any(row.best for row in nothing.rows)
    assert "the truth is not known" in nothing.sentence


@pytest.mark.parametrize("kind", ["negate", "scale", "raw", "coarse"])
def test_maps_as_other_systems_write_them_are_laid_on_ours(tree, tmp_path, kind):
    grid = mapped_room()
    cells = grid.cells[::2, ::2] if kind == "coarse" else grid.cells
    resolution = 0.1 if kind == "coarse" else 0.05
    grey = {"raw": (0, 100, 255), "negate": (1, 255, 100), "scale": (254, 0, 180)}.get(kind, (254, 0, 205))
    pixels = np.select([cells == FREE, cells == OCCUPIED], grey[:2], grey[2]).astype(np.uint8)
    Image.fromarray(pixels[::-1]).save(tmp_path / "m.png")
    x, y, yaw = (SE2.from_xyt(-20.0, 4.0, -2.6) @ grid.T_map_grid).xyt
    mode = kind if kind in ("scale", "raw") else "trinary"
    (tmp_path / "m.yaml").write_text(
        f"image: m.png\nmode: {mode}\nresolution: {resolution}\norigin: [{x}, {y}, {yaw}]\n"
        f"negate: {int(kind == 'negate')}\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    found = compare_with_systems(tree / "map", [SystemFiles("r", map=tmp_path / "m.yaml")])
    numbers = found.metrics["systems"]["r"]["map"]
    assert numbers["occupied_error_m"]["within_one_cell"] > (0.9 if kind == "coarse" else 0.96)
    assert "turned by" in found.notes[0][1]


def test_a_map_of_another_place_is_said_to_be_one(tree, tmp_path):
    cells = (100 * (stream(5, "clutter").random((90, 140)) > 0.9)).astype(np.int8)
    save_map(OccupancyGrid(cells, 0.05), tmp_path)
    found = compare_with_systems(tree / "map", [SystemFiles("r", map=tmp_path / "map.yaml")])
    assert any("another place" in note for _, note in found.notes)


def test_a_map_of_finer_cells_is_not_another_place(tree, tmp_path):
    grid = mapped_room()
    fine = OccupancyGrid(np.kron(grid.cells, np.ones((5, 5), np.int8)), grid.resolution / 5, grid.T_map_grid)
    # Its walls are one cell thin: on the surfaces, as a map of 1 cm cells has them.
    inside = ndimage.binary_erosion(fine.cells == OCCUPIED)
    fine = replace(fine, cells=np.where(inside, -1, fine.cells).astype(np.int8))
    save_map(fine, tmp_path)
    found = compare_with_systems(tree / "map", [SystemFiles("r", map=tmp_path / "map.yaml")])
    assert not any("another place" in note for _, note in found.notes)


def test_a_map_without_walls_is_said_to_have_none(tree, tmp_path):
    save_map(OccupancyGrid(np.zeros((90, 140), np.int8), 0.05), tmp_path)
    found = compare_with_systems(tree / "map", [SystemFiles("r", map=tmp_path / "map.yaml")])
    assert ("r", "Its map has no walls.") in found.notes
    assert found.sentence == "No number of another system could be computed."


def test_maps_that_lie_well_are_not_turned_to_lie_a_little_better():
    square = OccupancyGrid(np.pad(np.zeros((60, 60), np.int8), 2, constant_values=100), 0.05)
    placed = place(square, walls(square), 0.05, [SE2.identity()])
    assert placed.share == 1.0
    assert placed.T_ref_map.xyt == pytest.approx([0, 0, 0], abs=1e-9)


def test_our_map_scores_no_worse_beside_others_than_by_itself(tree):
    grid, true_map = mapped_room(), true_room()
    rng = np.random.default_rng(3)
    cells = grid.cells.copy()
    wall = np.argwhere(cells == OCCUPIED)
    moved = wall[rng.random(len(wall)) < 0.2] + [1, 0]
    cells[moved[:, 0], moved[:, 1]] = OCCUPIED
    grid = replace(grid, cells=cells)
    (ours,) = measure(System("TurtleBag", None, grid), [], References(None, true_map))
    assert ours.numbers["map"] == map_metrics(grid, true_map)


def test_the_command_prints_a_table_and_leaves_files_for_evo(tree, tmp_path, capsys):
    files = [f"carto={tree / 'carto.tum'}", f"carto={tree / 'carto.yaml'}"]
    assert main(["compare", str(tree / "map"), *files, "--out", str(tmp_path / "out")]) == 0
    out = capsys.readouterr().out
    assert "evo_ape -a" in out
    assert out.splitlines()[-1].endswith("index.html")
    names = sorted(path.name for path in (tmp_path / "out/systems").iterdir())
    assert names == ["TurtleBag.reference.tum", "TurtleBag.tum", "carto.reference.tum", "carto.tum"]
    page = (tmp_path / "out/index.html").read_text()
    assert page.count("<figure") == 3
    metrics = json.loads((tmp_path / "out/metrics.json").read_text())
    assert metrics["reference"] == "truth"


def test_a_localisation_has_other_systems_too(tree):
    fake_localise(tree / "localise", tree / "record", tree / "map")
    systems = compare_with_systems(tree / "localise", [carto(tree)]).metrics["systems"]
    assert systems["TurtleBag"]["ate_m"]["rmse"] == pytest.approx(0.01 * np.sqrt(2.0), rel=0.1)


@pytest.mark.slow
def test_a_report_shows_other_systems_and_verify_measures_them_again(tree, tmp_path, monkeypatch):
    other = [f"--system=carto={tree / 'carto.tum'}"]
    copy = tmp_path / "carto.tum"
    copy.write_bytes((tree / "carto.tum").read_bytes())
    words = [str(tree / "map"), *other, f"--system=again={copy}", "--no-animation"]
    out = tmp_path / "report"
    with unrendered():
        assert main(["report", *words, "--out", str(out)]) == 0
    page = (out / "index.html").read_text()
    assert "Other systems" in page
    assert 'data-key="record/systems:systems.carto.ate_aligned_m.rmse"' in page
    rows = (out / "tables/numbers.csv").read_text().splitlines()
    assert sum("record,systems,systems.carto.ate_" in row for row in rows) == 4
    assert " & TurtleBag & carto & again" in (out / "tables/record-systems.tex").read_text()
    # Its files are named as seen from the report, wherever the command is run.
    (tmp_path / "elsewhere/carto.tum").mkdir(parents=True)
    (tmp_path / "elsewhere/here").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere/here")
    with unrendered():
        found = verify(out)
    assert found.problems == []
    assert any(check.key.startswith("record/systems:systems.again") for check in found.checks)
    (out / "index.html").write_text(page.replace("carto 4.", "carto 1."))
    copy.write_text("".join(f"{line}\n" for line in copy.read_text().splitlines()[:-20]))
    with unrendered():
        problems = verify(out).problems
    assert "report/index.html: changed since the report was made" in problems
    assert "report/systems/again.tum: made again, it has other content" in problems
    assert any("systems.again.poses: reported 150, computed 130" in problem for problem in problems)
