"""A bag that is played: where it stands, what is mapped, and what a person says of its loops."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from tests.studio.room_bag import LAST, LOG, WITH_LOOPS, write_bag
from turtlebag.datasets.bags.footprint import footprint_text
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.slam.graph.edits import Edits, RejectedLoop, WallEdit, load_edits
from turtlebag.pipeline.slam.mapper import SlamConfig, run_slam
from turtlebag.pipeline.slam.scans.clouds import make_clouds
from turtlebag.pipeline.stages.map import build_map
from turtlebag.pipeline.stages.requests.maps import MapRequest
from turtlebag.pipeline.stages.studio import replay, studio_output
from turtlebag.pipeline.studio import inputs
from turtlebag.pipeline.studio.loops_shown import points_of
from turtlebag.pipeline.studio.session import Session
from turtlebag.pipeline.studio.setup import BagSetup
from turtlebag.sim.robots import load_robot


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("bags") / "bag")


@pytest.fixture
def played(bag, tmp_path):
    with Session(BagSetup(bag), tmp_path, lambda line: None) as one:
        yield one


@pytest.fixture
def with_loops(bag, tmp_path):
    with Session(BagSetup(bag, WITH_LOOPS), tmp_path, lambda line: None) as one:
        yield one


def run(played, seconds):
    for _ in range(round(30 * seconds)):
        played.tick()


@pytest.mark.parametrize("custom", [{}, {"footprint": "round"}, {"footprint": "[[0, 0], [1, 1], [1e9, 0]]"}])
def test_the_robot_of_a_bag_has_the_shape_that_the_bag_states_or_is_a_disc(tmp_path, custom):
    model = load_robot("waffle_pi").model
    stated = write_bag(tmp_path / "stated", **footprint_text(model.footprint))
    np.testing.assert_allclose(BagSetup(stated).scene().outline, model.footprint, atol=1e-4)
    radii = np.hypot(*BagSetup(write_bag(tmp_path / "bag", **custom)).scene().outline.T)
    np.testing.assert_allclose(radii, 0.2)


def test_time_passes_scan_by_scan_and_seeking_goes_anywhere(played):
    assert played.view().bag.duration_s == pytest.approx(0.2 * LAST)
    run(played, 2.05)
    view = played.view()
    assert view.bag.position_s == pytest.approx(2.05, abs=0.05)
    np.testing.assert_allclose(view.T_odom_base.xyt, LOG.T_odom_base[10].xyt, atol=1e-9)
    played.apply(inputs.Seek(t=20.01))
    np.testing.assert_allclose(played.view().T_odom_base.xyt, LOG.T_odom_base[100].xyt, atol=1e-9)
    played.apply(inputs.Seek(t=1.0))
    assert played.view().bag.position_s == 1.0
    assert played.stamp_ns * 1e-9 == pytest.approx(2.05, abs=0.05)


def test_time_stands_still_at_the_end(played):
    played.apply(inputs.Seek(t=29.5))
    run(played, 2.0)
    assert played.idle
    assert played.view().events[-1].text == "the bag is at its end"
    assert played.stamp_ns * 1e-9 < 0.5
    played.apply(inputs.Seek(t=0.0))
    assert not played.idle


@pytest.mark.slow
def test_the_online_mapper_maps_from_where_the_bag_stands(played):
    played.apply(inputs.Seek(t=4.0))
    played.apply(inputs.Plain(do="map_start"))
    run(played, 12.0)
    view = played.view()
    assert view.mapping
    assert view.map is not None
    assert view.bag.keys[0] == 21
    assert len(view.graph.nodes) == len(view.bag.keys) > 8
    assert view.sure > 0.9
    played.apply(inputs.Seek(t=0.0))
    assert not played.view().mapping


@pytest.mark.slow
def test_a_rejected_loop_is_gone_from_the_map_and_the_same_bytes_come_by_command(bag, with_loops, tmp_path):
    played = with_loops
    assert "good map of 150 scans" in played.apply(inputs.Plain(do="map_build"))
    view = played.view()
    loops = view.graph.edges[view.graph.edges[:, 2] == 1]
    assert len(loops)
    scan, place = (int(view.bag.keys[key]) for key in loops[0, :2])
    played.apply(inputs.Scans(do="loop_show", scan=scan, place=place))
    loop = played.view().bag.loop
    assert "found by distance" in loop.told
    assert "deg residual" in loop.told
    near = np.linalg.norm(loop.scan_points[:, None] - loop.place_points[None], axis=2).min(axis=1)
    assert np.quantile(near, 0.5) < 0.06
    played.apply(inputs.Scans(do="loop_reject", scan=scan, place=place))
    played.apply(inputs.Save(do="map_save", name="parted"))
    after = played.view()
    assert len(after.graph.edges[after.graph.edges[:, 2] == 1]) < len(loops)
    assert after.bag.edits == (("reject", scan, place),)
    assert load_edits(tmp_path / "edits.yaml").reject[0].scan == scan
    edits = tmp_path / "edits.yaml"
    edited = MapRequest(source=bag, edits=edits, settings={"loops.held_m": 0.0})
    assert build_map(edited, Output(tmp_path / "map")) == 0
    for kind in ("pgm", "yaml"):
        mine, theirs = (tmp_path / "maps" / f"parted.{kind}", tmp_path / "map" / f"map.{kind}")
        assert mine.read_bytes().replace(b"parted", b"map") == theirs.read_bytes()


@pytest.mark.slow
def test_walls_are_drawn_and_erased_at_once_and_the_command_line_draws_the_same(bag, played, tmp_path):
    with pytest.raises(InputError, match=r"^wall_draw: map the whole bag first$"):
        played.apply(inputs.Wall(do="wall_draw", points=[(0.0, 0.0)]))
    played.apply(inputs.Plain(do="map_build"))
    bare = played.view()
    at = bare.graph.nodes[len(bare.graph.nodes) // 2, :2]
    ends = [(float(at[0]) - 0.3, float(at[1])), (float(at[0]) + 0.3, float(at[1]))]
    cells = np.argwhere(bare.map.cells == 100)
    post = bare.map.grid.center_of(cells[len(cells) // 2])
    assert played.apply(inputs.Wall(do="wall_draw", points=ends)) == "wall drawn"
    played.apply(inputs.Wall(do="wall_erase", points=[tuple(post.tolist())], width=0.3))
    played.apply(inputs.Wall(do="wall_erase", points=ends, width=0.3))
    played.apply(inputs.Plain(do="wall_undo"))
    view = played.view()
    assert [edit.kind for edit in view.bag.edits] == ["draw", "erase"]
    assert view.graph is bare.graph
    line = np.linspace(*ends, 50)
    assert (bare.map.grid.value_at(line) == 0).all()
    assert (view.map.grid.value_at(line) == 100).all()
    assert view.map.grid.value_at(post) == 0
    played.apply(inputs.Save(do="map_save", name="mended"))
    saved = (tmp_path / "maps" / "mended.pgm").read_bytes()
    played.apply(inputs.Plain(do="map_start"))
    assert "good map" in played.apply(inputs.Plain(do="map_build"))
    played.apply(inputs.Save(do="map_save", name="again"))
    edited = MapRequest(source=bag, edits=tmp_path / "edits.yaml")
    assert build_map(edited, Output(tmp_path / "map")) == 0
    for file in (tmp_path / "maps" / "again.pgm", tmp_path / "map" / "map.pgm"):
        assert file.read_bytes() == saved
    played.apply(inputs.Plain(do="edits_clear"))
    assert np.array_equal(played.view().map.cells, bare.map.cells)
    with pytest.raises(InputError, match=r"^wall_undo: no wall"):
        played.apply(inputs.Plain(do="wall_undo"))


@pytest.mark.slow
def test_a_session_goes_on_with_the_edits_of_an_earlier_one(bag, tmp_path):
    wall = WallEdit(do="draw", points=((3.0, 1.0), (3.4, 1.0)), scan=LAST, pose=(5.1, 3.0, 1.57))
    earlier = Edits(walls=(wall,), reject=(RejectedLoop(scan=LAST, place=0),))
    setup = BagSetup(bag, edits=earlier)
    with studio_output(setup, Output(tmp_path / "one"), say=lambda line: None) as session:
        assert [edit.kind for edit in session.view().bag.edits] == ["reject", "draw"]
        session.apply(inputs.Plain(do="map_build"))
        session.apply(inputs.Wall(do="wall_erase", points=[(3.1, 1.0)], width=0.2))
        session.apply(inputs.Save(do="map_save", name="mended"))
    (kept, more) = load_edits(tmp_path / "one/edits.yaml").walls
    assert kept == wall
    assert more.do == "erase"
    assert replay(tmp_path / "one/session.yaml", Output(tmp_path / "two"), say=lambda line: None) == 0
    for name in ("session.yaml", "edits.yaml", "maps/mended.pgm"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    late = Edits(walls=(wall.model_copy(update={"scan": 150}),))
    with pytest.raises(InputError, match=r"^--edits: walls 1: .* has no scan 150"):
        Session(BagSetup(bag, edits=late), tmp_path, lambda line: None)


@pytest.mark.slow
def test_a_wall_follows_its_scan_when_a_loop_is_rejected(bag, tmp_path):
    """Without the loop nothing corrects the wheels' drift, and what was drawn at the end lies elsewhere."""
    off = {"refine": {"rounds": 0}, "place_recognition": {"enabled": False}}
    drifting = SlamConfig.model_validate({"front_end": "wheels", "loops": {"held_m": 0.0}, **off})
    with Session(BagSetup(bag, drifting), tmp_path, lambda line: None) as played:
        played.apply(inputs.Plain(do="map_build"))
        before = played.view()
        x, y = before.graph.nodes[-1, :2].tolist()
        ends = [(x, y - 0.4), (x, y + 0.4)]
        played.apply(inputs.Wall(do="wall_draw", points=ends))
        i, j, _ = next(edge for edge in before.graph.edges.tolist() if edge[2] == 1)
        scan, place = (int(before.bag.keys[key]) for key in (i, j))
        played.apply(inputs.Scans(do="loop_reject", scan=scan, place=place))
        played.apply(inputs.Plain(do="map_build"))
        after = played.view()
    key = int(np.searchsorted(before.bag.keys, after.bag.edits[-1].scan))
    line = np.linspace(*ends, 50)
    moved = SE2(after.graph.nodes[key]) @ SE2(before.graph.nodes[key]).inverse() @ line
    assert np.linalg.norm(moved - line, axis=1).min() > 0.08
    assert (after.map.grid.value_at(moved) == 100).all()
    assert not (after.map.grid.value_at(line) == 100).all()


def test_the_points_of_a_scan_lie_where_the_mapper_takes_them_to_be():
    """Of a lidar that turns while the robot does."""
    log = replace(LOG, lidar=replace(LOG.lidar, time_increment=0.15 / LOG.lidar.n_beams))
    knots = np.linspace(0.0, 1.0, 9)[1:, None] * [0.1, 0.02, 0.4]
    motion = SE2(np.broadcast_to(knots, (len(log), *knots.shape)))
    seen = points_of(log, 40, motion)
    expected = make_clouds(log, log.lidar.range_max, motion, scans=np.array([40])).points
    np.testing.assert_allclose(seen, expected, atol=1e-6)
    assert np.linalg.norm(seen - points_of(log, 40), axis=1).max() > 0.1


@pytest.mark.slow
def test_after_the_whole_bag_is_mapped_a_scan_is_shown_as_the_mapper_saw_it(tmp_path):
    """With the motion during its sweep, and with corrected sensors."""
    lidar = replace(LOG.lidar, time_increment=0.15 / LOG.lidar.n_beams)
    bag = write_bag(tmp_path / "bag", replace(LOG, lidar=lidar))
    mapped = run_slam(load_recording(bag), SlamConfig())
    with Session(BagSetup(bag), tmp_path, lambda line: None) as played:
        played.apply(inputs.Plain(do="map_build"))
        played.apply(inputs.Seek(t=14.0))
        view = played.view()
    of, scan = mapped.session, round(14.0 / 0.2)
    expected = view.T_map_base @ points_of(of.recording, scan, of.motion)
    np.testing.assert_allclose(view.scan, expected, atol=1e-6)
    raw = view.T_map_base @ points_of(load_recording(bag), scan)
    assert np.linalg.norm(view.scan - raw, axis=1).max() > 1e-4


@pytest.mark.slow
def test_a_build_that_is_refused_or_cancelled_changes_nothing(played):
    played.apply(inputs.Plain(do="map_start"))
    run(played, 2.0)
    played.apply(inputs.LoopAdd(do="loop_add", scan=5, place=3, pose=(0.0, 0.0, 0.0)))
    with pytest.raises(InputError, match=r"^scans 5 and 3 were taken shortly after each other"):
        played.apply(inputs.Plain(do="map_build"))
    assert played.view().mapping
    played.apply(inputs.Plain(do="edits_clear"))
    played.interrupt()
    with pytest.raises(InputError, match="cancelled"):
        played.apply(inputs.Plain(do="map_build"))
    assert played.view().mapping


@pytest.mark.slow
def test_the_scan_lies_where_the_robot_is_drawn_when_the_map_is_another(played):
    run(played, 25.0)
    played.view()
    played.apply(inputs.Plain(do="map_build"))
    view = played.view()
    true = LOG.scan(124)
    assert np.hypot(*(view.T_map_base.inverse() @ view.T_odom_base).xy) > 0.05
    ranges = np.linalg.norm(view.T_map_base.inverse() @ view.scan, axis=1)
    np.testing.assert_allclose(ranges, true.ranges[np.isfinite(true.ranges)], atol=1e-4)
    with pytest.raises(InputError, match="shortly after each other"):
        played.apply(inputs.LoopAdd(do="loop_add", scan=5, place=3, pose=(0.0, 0.0, 0.0)))
    assert "already shown" in played.apply(inputs.Plain(do="map_build"))
    assert len(played.view().slam_path.points) > 100
    played.apply(inputs.Plain(do="map_start"))
    assert len(played.view().slam_path.points) == 0, "the path is that of a map that is not shown any more"


def test_a_file_with_a_time_beyond_the_bags_end_is_played_to_its_end(bag, tmp_path):
    told = BagSetup(bag).header().model_dump()
    entries = [{"at": 1.0, "do": "seek", "t": 29.5}, {"at": 4.0}, {"at": 5.0, "do": "end"}]
    file = tmp_path / "session.yaml"
    file.write_text(yaml.safe_dump(told | {"inputs": entries}))
    assert replay(file, Output(tmp_path / "out"), say=lambda line: None) == 0


@pytest.mark.slow
def test_a_loop_that_is_added_wrongly_is_told_to_be_not_believed(played):
    played.apply(inputs.LoopAdd(do="loop_add", scan=LAST, place=LAST // 3, pose=(1.0, 1.0, 0.8)))
    assert played.apply(inputs.Plain(do="map_build")).endswith("1 of the added loops rejected")
    assert "not joined" in played.view().events[-2].text
    played.apply(inputs.Scans(do="loop_reject", scan=LAST, place=LAST // 3))
    assert played.view().bag.edits == ()


@pytest.mark.slow
def test_a_session_with_a_bag_is_played_again_to_the_same_bytes(bag, tmp_path):
    with studio_output(BagSetup(bag), Output(tmp_path / "one"), say=lambda line: None) as session:
        run(session, 3.0)
        session.apply(inputs.Plain(do="map_start"))
        run(session, 3.0)
        session.apply(inputs.Scans(do="loop_reject", scan=LAST, place=0))
        session.apply(inputs.Save(do="map_save", name="whole"))
    assert replay(tmp_path / "one" / "session.yaml", Output(tmp_path / "two"), say=lambda line: None) == 0
    files = sorted(path.relative_to(tmp_path / "one") for path in (tmp_path / "one").rglob("*.*"))
    assert {str(path) for path in files} >= {"session.yaml", "edits.yaml", "maps/whole.pgm", "metrics.json"}
    for path in files:
        if path.name != "manifest.json":
            assert (tmp_path / "one" / path).read_bytes() == (tmp_path / "two" / path).read_bytes(), path
    assert load_map(tmp_path / "two" / "maps" / "whole.yaml").cells.size
    text = (tmp_path / "one" / "session.yaml").read_text()
    other = tmp_path / "other.yaml"
    told = yaml.safe_load(text)
    other.write_text(yaml.safe_dump(told | {"sha256": dict.fromkeys(told["sha256"], "0" * 64)}))
    with pytest.raises(InputError, match="has changed since the session"):
        replay(other, Output(tmp_path / "three"))
