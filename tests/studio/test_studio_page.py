"""The studio's page: it fits, can be worked by keyboard, says what is going on, and comes back."""

import asyncio
import io
import time
from functools import partial

import numpy as np
import pytest
from PIL import Image
from tornado.websocket import websocket_connect

from tests.helpers.browser import find_browser
from tests.studio.fakes import SCENE, Served
from tests.studio.page import (
    ENABLED,
    FITTING,
    HERE,
    box_of,
    click,
    drag,
    on_screen,
    open_page,
    shown_text,
    until,
)
from turtlebag.pipeline.studio.view import GoalMark, SectorMarks

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        find_browser() is None,
        reason="no Chromium here: `make browser` installs one, or set TURTLEBAG_CHROMIUM",
    ),
]
SIZES = [(1280, 720, False), (1920, 1080, False), (844, 390, True)]
FOCUSABLE = """[...document.querySelectorAll("button, input, select, summary, [tabindex]")]
  .filter((part) => part.checkVisibility() && !part.matches(":disabled"))"""
SAY_FOCUS = f"({FOCUSABLE}).indexOf(document.activeElement)"
OVERFLOW = """[...document.querySelectorAll("body *")].filter((part) => {
  const { right, bottom, width } = part.getBoundingClientRect();
  const cut = part.closest("#panel, #lines, #layers ul, svg, header p, #tools span");
  return part.checkVisibility() && width && (right > innerWidth + 1 || bottom > innerHeight + 1) && !cut;
}).map((part) => part.outerHTML.slice(0, 80))"""
CLIPPED = """[...document.querySelectorAll("button, summary, label, #panel p")].filter((part) =>
  part.checkVisibility() && part.scrollWidth > part.clientWidth + 1).map((part) => part.outerHTML)"""


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize(("width", "height", "touch"), SIZES)
def test_the_page_fits_and_complains_of_nothing(browser, session, served, width, height, touch, dark):
    session.told = {
        "task": "patrol",
        "state": "to waypoint 2 of 3, which is a rather long word for what goes on",
        "recording": "bag_with_a_long_name",
        "sectors": SectorMarks(1.0, 0.5, np.inf, "turn left"),
        "goals": (GoalMark(0.5, 0.5, 0.0, "reached"), GoalMark(1.0, 1.0, 0.0, "active")),
        "goal_index": 1,
        "particles": np.zeros((10, 3)),
        "keepout": (np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]),),
    }
    open_page(browser, served, width, height, dark=dark, touch=touch)
    until(lambda: shown_text(browser, "state").startswith("Patrol: to waypoint 2"))
    click(browser, "#tools [data-tool=goal]")
    browser.evaluate("document.getElementById('layers').open = true")
    assert browser.evaluate(OVERFLOW) == []
    assert browser.evaluate(CLIPPED) == []
    assert browser.problems() == []
    assert all(address.startswith(HERE) for address in browser.requests())


@pytest.mark.parametrize(("width", "height"), [(844, 390), (800, 900), (360, 740)])
def test_the_drive_pad_of_a_small_window_leaves_the_scale_bar_in_sight(
    browser, session, served, width, height
):
    open_page(browser, served, width, height, touch=True)
    bottom = "document.getElementById({!r}).getBoundingClientRect().bottom"
    assert browser.evaluate(f"{bottom.format('stage')} - {bottom.format('pad')}") >= 54  # its label's top


@pytest.mark.parametrize("width", [320, 390])
def test_on_a_phone_the_panel_can_be_opened_whatever_the_header_tells(browser, session, served, width):
    session.told = {
        "mapping": True,
        "recording": "bag_with_a_long_name",
        "lost": "scans disagree with the map",
    }
    open_page(browser, served, width, 844, touch=True)
    until(lambda: browser.evaluate("document.getElementById('pills').childElementCount") == 3)
    left, top, wide, high = box_of(browser, "#fold")
    assert left >= 0
    assert left + wide <= width
    bottom = browser.evaluate("document.querySelector('header').getBoundingClientRect().bottom")
    assert top + high <= bottom
    left, top, wide, high = box_of(browser, "#stage")
    assert top >= bottom - 1
    assert high > 400


def test_a_window_made_narrow_folds_the_panel_and_one_made_wide_shows_it(browser, session, served):
    open_page(browser, served)
    seen = "document.getElementById('panel').checkVisibility({visibilityProperty: true})"
    told = "document.getElementById('fold').ariaExpanded"
    for width, wanted in ((400, f"!{seen} && {told} === 'false'"), (1280, f"{seen} && {told} === 'true'")):
        size = {"width": width, "height": 720, "deviceScaleFactor": 1, "mobile": False}
        browser.call("Emulation.setDeviceMetricsOverride", **size)
        until(partial(browser.evaluate, wanted))


@pytest.mark.parametrize("width", [390, 820])
def test_the_state_is_not_cut_on_small_screens(browser, session, served, width):
    session.told = {"task": "patrol", "state": "to waypoint 2 of 3, replanning around an obstacle"}
    open_page(browser, served, width, 844, touch=True)
    until(lambda: shown_text(browser, "state").startswith("Patrol"))
    assert (
        browser.evaluate(
            "(({ scrollWidth, clientWidth }) => scrollWidth - clientWidth)(document.getElementById('state'))"
        )
        <= 0
    )


def test_the_log_follows_its_end_and_the_keys_are_listed(page, session):
    for _ in range(20):
        click(page, "#pause")
        click(page, "[data-do=avoid]")
    until(lambda: len(session.asked("avoid")) == 20)
    page.evaluate("document.getElementById('lines').style.height = '60px'")
    below = "(({ scrollHeight, scrollTop, clientHeight }) => scrollHeight - scrollTop - clientHeight)"
    until(lambda: page.evaluate(f"{below}(document.getElementById('lines'))") < 8)
    click(page, "#help summary")
    assert "hand back to the task" in page.evaluate("document.getElementById('help').innerText")


def test_the_speed_of_a_task_is_shown(page, session):
    session.told = {"task": "avoid", "command": (0.15, -0.5)}
    until(lambda: shown_text(page, "cmd") == "0.15 m/s, -0.5 rad/s")


@pytest.mark.parametrize(("width", "height", "touch"), [SIZES[0], SIZES[2]])
def test_every_control_has_a_name_and_is_reached_by_tab(browser, session, served, width, height, touch):
    session.told = {"task": "goal", "waypoint_files": ("mine",)}
    open_page(browser, served, width, height, touch=touch)
    browser.key("k")
    browser.evaluate("document.getElementById('layers').open = true")
    nodes = browser.call("Accessibility.getFullAXTree")["nodes"]
    roles = (
        "button",
        "textbox",
        "combobox",
        "checkbox",
        "spinbutton",
        "application",
        "meter",
        "DisclosureTriangle",
    )
    found = [node for node in nodes if not node["ignored"] and node["role"]["value"] in roles]
    assert len(found) > 60
    assert [node for node in found if not node.get("name", {}).get("value", "").strip()] == []
    count = browser.evaluate(f"({FOCUSABLE}).length")
    browser.evaluate("document.activeElement.blur()")
    reached = set()
    for _ in range(count + 5):
        browser.key("Tab")
        reached.add(browser.evaluate(SAY_FOCUS))
    missing = browser.evaluate(
        f"({FOCUSABLE}).filter((_, k) => !{sorted(reached)}.includes(k)).map((part) => part.outerHTML)"
    )
    assert missing == []


def test_the_cursor_reads_place_and_cell(page):
    for place, word in (((1.0, 1.0), "free"), ((0.02, 1.0), "occupied 100"), ((-0.2, 1.0), "unknown")):
        (at,) = on_screen(page, place)
        page.mouse("mouseMoved", *at)
        until(lambda word=word: shown_text(page, "readout").endswith(word))


def test_what_is_refused_is_said_where_one_looks_until_the_next_input(page):
    click(page, "[data-do=map_load] button")
    until(lambda: shown_text(page, "error").startswith("map_load: no map 'nowhere'"))
    click(page, "[data-do=avoid]")
    until(lambda: page.evaluate("document.getElementById('error').hidden"))


def test_what_takes_long_is_named_while_it_does(page, session):
    quick = session.tick
    session.tick = lambda: time.sleep(1.5) or quick()
    until(lambda: "Computing" in shown_text(page, "pills"))
    session.tick = quick
    until(lambda: "Computing" not in shown_text(page, "pills"))


def test_the_ghost_s_world_moves(page, session):
    at, elsewhere = on_screen(page, (0.63, 1.26), (1.37, 1.26))
    page.evaluate("document.querySelector('[name=layer-ghost]').click()")

    def shade(place):
        picture = Image.open(io.BytesIO(page.picture())).convert("RGB")
        return picture.getpixel(tuple(round(value) for value in place))

    before = shade(at)
    for x, there, gone in ((0.63, at, elsewhere), (1.37, elsewhere, at)):
        session.told = {"mover_circles": np.array([[x, 1.26, 0.2]])}
        until(lambda there=there, gone=gone: shade(there) != before and shade(gone) == before)


def test_layers_are_turned_off_and_on_and_remembered(page, served):
    (wall,) = on_screen(page, (0.02, 1.5))

    def shade():
        return Image.open(io.BytesIO(page.picture())).convert("L").getpixel((round(wall[0]), round(wall[1])))

    until(lambda: shade() < 30)
    page.evaluate("document.getElementById('layers').open = true")
    click(page, "[name=layer-grid]")
    click(page, "[name=layer-map]")
    until(lambda: shade() > 190)
    page.call("Page.reload")
    until(lambda: page.evaluate("document.querySelector('[name=layer-map]')?.checked === false"))
    assert page.evaluate("document.querySelector('[name=layer-scan]').checked")


def test_the_wheel_zooms_about_the_mouse_and_a_drag_pans(page):
    page.key("0")
    place = on_screen(page, (1.0, 1.0))[0]
    before = page.evaluate(FITTING)
    page.call("Input.dispatchMouseEvent", type="mouseWheel", x=place[0], y=place[1], deltaX=0, deltaY=-300)
    until(lambda: page.evaluate(FITTING)[2] > 1.4 * before[2])
    assert on_screen(page, (1.0, 1.0))[0] == pytest.approx(place, abs=1.0)
    drag(page, place, (place[0] + 30, place[1] - 20))
    assert on_screen(page, (1.0, 1.0))[0] == pytest.approx([place[0] + 30, place[1] - 20], abs=1.0)
    page.key("0")
    until(lambda: page.evaluate(FITTING) == pytest.approx(before))


def test_a_second_page_watches_until_it_takes_control(browser, session, served):
    address = served.url.replace("http:", "ws:").replace("/?", "/socket?")

    async def watch():
        first = await websocket_connect(address)
        await first.read_message()
        await asyncio.to_thread(look)
        await first.write_message('{"do": "take_control"}')
        await asyncio.to_thread(look_on)
        first.close()

    def look():
        open_page(browser, served)
        assert shown_text(browser, "watching").startswith("Another page has the controls.")
        assert not browser.evaluate(ENABLED)
        browser.key("w")
        browser.key("g")
        time.sleep(0.3)
        assert session.applied == []
        click(browser, "#take")
        until(lambda: browser.evaluate(ENABLED))
        browser.key("w")
        until(lambda: session.asked("drive") == [{"v": 0.01, "w": 0.0}])

    def look_on():
        until(lambda: not browser.evaluate(ENABLED))
        until(lambda: shown_text(browser, "cmd") == "0.00 m/s, 0.0 rad/s")
        until(lambda: session.asked("stop"))

    asyncio.run(watch())


def test_a_lost_connection_is_said_and_comes_back_by_itself(page, session):
    page.key("w", 5)
    until(lambda: session.asked("drive"))
    page.evaluate("socket.close()")
    until(lambda: "Connection lost. The robot is stopped." in shown_text(page, "broken"))
    until(lambda: session.asked("stop"))
    until(lambda: page.evaluate("document.getElementById('broken').hidden"))
    until(lambda: page.evaluate(ENABLED))
    assert shown_text(page, "cmd") == "0.00 m/s, 0.0 rad/s"


def test_the_end_of_the_studio_is_said_with_its_reason(browser, session):
    with Served(session) as server:
        open_page(browser, server)
    until(lambda: "Closed: the studio was stopped" in shown_text(browser, "broken"))
    assert not browser.evaluate("document.getElementById('again').hidden")
    assert browser.evaluate("document.querySelector('#tools [data-tool=goal]').disabled")
    browser.key("w")
    assert shown_text(browser, "cmd") == "0.00 m/s, 0.0 rad/s"
    browser.leave()


def test_a_session_that_was_ended_says_where_its_files_are(browser, session):
    lines = ["Its files are in /here", "turtlebag studio --replay here/session.yaml --out there"]
    with Served(session, after=lambda: lines) as server:
        open_page(browser, server)
    until(lambda: shown_text(browser, "over").startswith("The studio was stopped.Its files are in /here"))
    assert browser.evaluate("document.getElementById('broken').hidden")
    assert lines[1] in shown_text(browser, "over")
    browser.leave()


def test_an_empty_session_says_what_to_do_first(browser, session, served):
    session.told = {"map": None, "map_name": None, "maps": (), "localised": False}
    open_page(browser, served)
    until(lambda: shown_text(browser, "advice") == "No map yet. Start mapping, then drive with W A S D.")
    assert shown_text(browser, "maps") == "none saved yet"
    assert shown_text(browser, "where") == f"{SCENE.world} · burger · seed 3"
