"""The page of a bag that is played: the time bar, its loops, and what is said of them."""

import numpy as np
import pytest

from tests.helpers.browser import find_browser
from tests.studio.fakes import Served
from tests.studio.page import click, drag, on_screen, open_page, shown_text, until
from tests.studio.room_bag import LAST, LOG, WITH_LOOPS, write_bag
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.slam.graph.edits import load_edits
from turtlebag.pipeline.studio.session import Session
from turtlebag.pipeline.studio.setup import BagSetup

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        find_browser() is None,
        reason="no Chromium here: `make browser` installs one, or set TURTLEBAG_CHROMIUM",
    ),
]


@pytest.fixture
def playback(tmp_path):
    bag = write_bag(tmp_path / "bag")
    with Session(BagSetup(bag, WITH_LOOPS), tmp_path, lambda line: None) as playback:
        yield playback


@pytest.fixture
def bag_page(browser, playback):
    with Served(playback) as served:
        open_page(browser, served)
        yield browser
        problems = browser.problems()
        browser.leave()
    assert problems == []
    assert served.failure is None


def seek(page, to_s):
    bar = "document.getElementById('time')"
    page.evaluate(f"{bar}.value = {to_s}, {bar}.dispatchEvent(new Event('change'))")


def visible(page, selector):
    return page.evaluate(f"document.querySelector({selector!r}).checkVisibility()")


def test_a_bag_has_a_time_bar_and_no_robot(bag_page, playback):
    until(lambda: visible(bag_page, "#player"))
    for selector in ("#pad", "#patrol", "[data-tool=goal]", "[data-tool=box]"):
        assert not visible(bag_page, selector)
    seek(bag_page, 29.0)
    until(lambda: playback.view().bag.position_s >= 29.0)
    until(lambda: "29." in shown_text(bag_page, "when"))
    assert shown_text(bag_page, "when").endswith("of 29.8 s")


def test_a_loop_is_looked_at_rejected_and_made_by_hand(bag_page, playback, tmp_path):
    click(bag_page, "[data-do=map_build]")
    until(lambda: playback.view().graph is not None, 60.0)
    until(lambda: bag_page.evaluate("import('./scene.js').then(m => m.scene.blobs.graph_keys?.length > 0)"))
    view = playback.view()
    nodes, keys = view.graph.nodes, view.bag.keys
    i, j, _ = next(edge for edge in view.graph.edges.tolist() if edge[2] == 1)
    click(bag_page, "#tools [data-tool=loop]")
    middle = 0.5 * (nodes[i, :2] + nodes[j, :2])
    drag(bag_page, *on_screen(bag_page, middle.tolist()))
    until(lambda: playback.view().bag.loop is not None)
    loop = playback.view().bag.loop
    until(lambda: f"Scan {loop.scan} on scan {loop.place}" in shown_text(bag_page, "told"))
    click(bag_page, "#reject")
    until(lambda: playback.view().bag.edits == (("reject", loop.scan, loop.place),))
    until(lambda: "are kept apart" in shown_text(bag_page, "edits"))

    click(bag_page, "#tools [data-tool=join]")
    last, first = len(keys) - 1, 2
    start, end = on_screen(bag_page, nodes[last, :2].tolist(), nodes[first, :2].tolist())
    drag(bag_page, start, end)
    until(lambda: len(playback.view().bag.edits) == 2)
    added = load_edits(tmp_path / "edits.yaml").add[0]
    assert (added.scan, added.place) == (int(keys[last]), int(keys[first]))
    turn = (SE2(nodes[first]).inverse() @ SE2(nodes[last])).yaw
    np.testing.assert_allclose(added.pose, [0.0, 0.0, float(turn)], atol=0.06)
    assert max(added.scan, added.place) <= LAST == len(LOG) - 1


def test_a_wall_is_drawn_erased_and_undone_with_the_mouse(bag_page, playback, tmp_path):
    click(bag_page, "[data-do=map_build]")
    until(lambda: playback.view().graph is not None, 60.0)
    until(lambda: bag_page.evaluate("import('./scene.js').then(m => m.scene.blobs.graph_keys?.length > 0)"))
    bare = playback.view().map
    x, y = playback.view().graph.nodes[4, :2].tolist()
    click(bag_page, "#tools [data-tool=wall]")
    start, end = on_screen(bag_page, [x - 0.5, y], [x + 0.5, y])
    drag(bag_page, start, end)
    until(lambda: playback.view().map is not bare)
    (wall,) = load_edits(tmp_path / "edits.yaml").walls
    np.testing.assert_allclose(wall.points, [[x - 0.5, y], [x + 0.5, y]], atol=0.05)
    assert playback.view().map.grid.value_at(np.array([x, y])) == 100
    click(bag_page, "#tools [data-tool=erase]")
    drag(bag_page, *on_screen(bag_page, [x, y]))
    until(lambda: playback.view().map.grid.value_at(np.array([x, y])) == 0)
    until(lambda: "Walls are erased near scan" in shown_text(bag_page, "edits"))
    click(bag_page, "#undo")
    until(lambda: playback.view().map.grid.value_at(np.array([x, y])) == 100)
    assert "Walls are erased" not in (tmp_path / "edits.yaml").read_text()
