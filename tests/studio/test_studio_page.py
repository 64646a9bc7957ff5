"""The studio's page in a real browser, on the real server, with a session that notes what it is asked."""

import asyncio
import json
import time

import numpy as np
import pytest
from browser import Browser, find_browser
from studio_fakes import SCENE, FakeSession, Served, view
from tornado.websocket import websocket_connect

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.studio.inputs import Drive, MapLoad
from turtlebag.pipeline.studio.view import Event, GoalMark, MapLayer, SectorMarks

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        find_browser() is None, reason="no Chromium here: `make browser` installs one, or set TURTLEBAG_CHROMIUM"
    ),
]
SIZES = [(1280, 720, False), (1920, 1080, False), (844, 390, True)]
KEEP_SOCKET = """
window.WebSocket = class extends WebSocket { constructor(url) { super(url); window.socket = this; } };
"""
ENABLED = "!document.getElementById('controls').disabled"
FOCUSABLE = """[...document.querySelectorAll("button, input, select, summary, [tabindex]")]
  .filter((part) => part.checkVisibility() && !part.matches(":disabled"))"""
SAY_FOCUS = f"({FOCUSABLE}).indexOf(document.activeElement)"
OVERFLOW = """[...document.querySelectorAll("body *")].filter((part) => {
  const box = part.getBoundingClientRect(), cut = part.closest("#panel, #lines, #layers ul, svg, header p, #tools span");
  return part.checkVisibility() && box.width && (box.right > innerWidth + 1 || box.bottom > innerHeight + 1) && !cut;
}).map((part) => part.outerHTML.slice(0, 80))"""
CLIPPED = """[...document.querySelectorAll("button, summary, label, #panel p")].filter((part) =>
  part.checkVisibility() && part.scrollWidth > part.clientWidth + 1).map((part) => part.outerHTML)"""
FITTING = "import('./view.js').then(({ view }) => [view.x, view.y, view.scale])"


class PageSession(FakeSession):
    """Notes everything; `told` is what its view says beyond the ordinary. Maps cannot be loaded."""

    def __init__(self):
        cells = np.full((120, 80), -1, dtype=np.int8)
        cells[20:100, 20:60] = 0
        cells[20:100, 20] = 100
        super().__init__()
        self._map = MapLayer(OccupancyGrid(cells, 0.05, SE2.from_xyt(-1.0, -2.0, 0.0)))
        self.told = {}

    def apply(self, entry):
        if isinstance(entry, MapLoad):
            raise InputError("map_load: no map 'nowhere' in this session: save one first")
        self.applied.append((self.stamp_ns, entry))
        self._drive = entry if isinstance(entry, Drive) else Drive()
        self._events.append(Event(len(self._events) + 1, self.stamp_ns * 1e-9, entry.do, "info"))
        return entry.do

    def view(self):
        known = {"map": self._map, "map_name": "", "maps": ("",), "localised": True, "sure": 0.9}
        given = {"stamp_ns": self.stamp_ns, "events": tuple(self._events), "command": (self._drive.v, 0.0)}
        return view(**known | given | self.told)

    def asked(self, do):
        """Inputs of that kind so far, as plain values."""
        entries = [entry.model_dump(exclude={"do"}) for _, entry in self.applied if entry.do == do]
        return json.loads(json.dumps(entries))


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(find_browser(), tmp_path_factory.mktemp("profile")) as browser:
        browser.call("Page.addScriptToEvaluateOnNewDocument", source=KEEP_SOCKET)
        browser.call("Browser.grantPermissions", permissions=["clipboardReadWrite", "clipboardSanitizedWrite"])
        browser.call("Emulation.setFocusEmulationEnabled", enabled=True)
        yield browser


@pytest.fixture
def session():
    return PageSession()


@pytest.fixture
def served(session):
    with Served(session) as server:
        yield server
    assert server.failure is None


@pytest.fixture
def page(browser, served):
    open_page(browser, served)
    yield browser
    assert browser.problems() == []
    assert all(address.startswith(served.place) for address in browser.requests())


def open_page(browser, served, width=1280, height=720, **how):
    browser.open(served.url, width, height, **how)
    browser.evaluate("sessionStorage.clear(), localStorage.clear()")
    until(lambda: browser.evaluate(ENABLED) or browser.evaluate("!document.getElementById('watching').hidden"))


def until(condition, timeout_s=10.0):
    end = time.monotonic() + timeout_s
    while not (found := condition()):
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.03)
    return found


def click(browser, selector):
    """A click of the mouse in the middle of an element."""
    place = f"document.querySelector({selector!r})"
    browser.evaluate(f"{place}.scrollIntoView({{block: 'nearest', behavior: 'instant'}})")
    x, y = browser.evaluate(f"(({{left, top, width, height}}) => [left + width / 2, top + height / 2])({place}.getBoundingClientRect())")
    drag(browser, (x, y))


def drag(browser, *places):
    browser.mouse("mouseMoved", *places[0])
    browser.mouse("mousePressed", *places[0])
    for place in places[1:]:
        browser.mouse("mouseMoved", *place, pressed=True)
    browser.mouse("mouseReleased", *places[-1])


def on_screen(browser, *places):
    """Where places of the map frame are in the window."""
    found = f"""import('./view.js').then(({{ toScreen }}) => {{
      const box = document.getElementById('stage').getBoundingClientRect();
      return {json.dumps(places)}.map(([x, y]) => toScreen(x, y)).map(([x, y]) => [x + box.left, y + box.top]);
    }})"""
    return browser.evaluate(found)


def shown_text(browser, name):
    return browser.evaluate(f"document.getElementById({name!r}).textContent.trim()")


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
    assert all(address.startswith(served.place) for address in browser.requests())


@pytest.mark.parametrize(("width", "height", "touch"), [SIZES[0], SIZES[2]])
def test_every_control_has_a_name_and_is_reached_by_tab(browser, session, served, width, height, touch):
    session.told = {"task": "goal", "waypoint_files": ("mine",)}
    open_page(browser, served, width, height, touch=touch)
    browser.key("k")
    browser.evaluate("document.getElementById('layers').open = true")
    nodes = browser.call("Accessibility.getFullAXTree")["nodes"]
    roles = ("button", "textbox", "combobox", "checkbox", "spinbutton", "application", "meter", "DisclosureTriangle")
    found = [node for node in nodes if not node["ignored"] and node["role"]["value"] in roles]
    assert len(found) > 60
    assert [node for node in found if not node.get("name", {}).get("value", "").strip()] == []
    count = browser.evaluate(f"({FOCUSABLE}).length")
    browser.evaluate("document.activeElement.blur()")
    reached = set()
    for _ in range(count + 5):
        browser.key("Tab")
        reached.add(browser.evaluate(SAY_FOCUS))
    missing = browser.evaluate(f"({FOCUSABLE}).filter((_, k) => !{sorted(reached)}.includes(k)).map((part) => part.outerHTML)")
    assert missing == []


def test_keys_drive_in_the_steps_of_the_terminal_and_a_heartbeat_keeps_it_up(page, session):
    page.key("w", 3)
    page.key("a")
    until(lambda: session.asked("drive")[-1:] == [{"v": 0.03, "w": 0.1}])
    assert shown_text(page, "cmd") == "0.03 m/s, 0.1 rad/s"
    time.sleep(1.2)
    assert session.asked("stop") == []
    page.key("S", 4)
    until(lambda: session.asked("drive")[-1] == {"v": -0.01, "w": 0.1})
    page.key(" ")
    until(lambda: session.asked("stop") == [{}])
    page.key("w", 40)
    until(lambda: session.asked("drive")[-1]["v"] == 0.22)
    page.key("q")
    until(lambda: session.asked("release") == [{}])


def test_a_page_that_nobody_looks_at_stops_the_robot(page, session):
    page.key("w", 2)
    until(lambda: session.asked("drive"))
    page.evaluate("dispatchEvent(new Event('blur'))")
    until(lambda: session.asked("stop") == [{}], 0.4)


def test_space_stops_the_robot_and_does_not_press_the_button_clicked_before(page, session):
    click(page, "#mapping")
    until(lambda: session.asked("map_start"))
    page.key("w")
    page.key(" ")
    until(lambda: session.asked("stop"))
    assert len(session.asked("map_start")) == 1


def test_what_is_typed_into_a_field_does_not_drive(page, session):
    page.evaluate("document.querySelector('[data-do=map_save] input').select()")
    for key in "wasd x":
        page.key(key)
    page.key("Enter")
    time.sleep(0.3)
    assert session.asked("drive") == session.asked("stop") == []
    page.evaluate("document.querySelector('[data-do=map_save] input').value = 'map_world'")
    page.key("Enter")
    until(lambda: {"name": "map_world"} in session.asked("map_save"))


def test_pose_and_goal_are_drawn_by_press_drag_release(page, session):
    start, tip = on_screen(page, (0.5, 1.0), (0.5, 2.0))
    for key, do in (("p", "pose_estimate"), ("g", "goal")):
        page.key(key)
        drag(page, start, (start[0] + 5, start[1]), tip)
        (asked,) = until(lambda do=do: session.asked(do))
        assert asked["pose"] == pytest.approx([0.5, 1.0, np.pi / 2], abs=0.02)
    assert page.evaluate("document.getElementById('stage').dataset.tool") == "view"


def test_poses_can_be_typed(page, session):
    for key, do, text in (
        ("p", "pose_estimate", "1, 2, 0.5"),
        ("g", "goal", "1 2 0.5"),
        ("r", "kidnap", "1,2,.5"),
    ):
        page.evaluate("document.getElementById('stage').focus()")
        page.key(key)
        page.key("Enter")
        page.call("Input.insertText", text=text)
        page.key("Enter")
        until(lambda do=do: session.asked(do) == [{"pose": [1.0, 2.0, 0.5]}])
    page.key("Escape")
    page.key("b")
    page.key("Enter")
    page.call("Input.insertText", text="here")
    page.key("Enter")
    until(lambda: shown_text(page, "error") == '"here" is not x, y')


def test_a_click_copies_a_point(page):
    page.key("c")
    (place,) = on_screen(page, (0.25, -1.5))
    drag(page, place)
    until(lambda: "copied" in shown_text(page, "readout"))
    assert [float(value) for value in page.clipboard().split(", ")] == pytest.approx([0.25, -1.5], abs=0.02)


def test_the_cursor_reads_place_and_cell(page):
    for place, word in (((1.0, 1.0), "free"), ((0.02, 1.0), "occupied 100"), ((-0.5, -1.5), "unknown")):
        (at,) = on_screen(page, place)
        page.mouse("mouseMoved", *at)
        until(lambda word=word: shown_text(page, "readout").endswith(word))


def test_waypoints_are_clicked_moved_turned_ordered_and_patrolled(page, session):
    page.key("n")
    one, two, there, tip = on_screen(page, (0.5, 0.0), (1.5, 0.0), (0.5, -1.0), (1.5, 1.0))
    drag(page, one, (one[0] + 60, one[1]))
    drag(page, two, tip)
    drag(page, one, there)
    click(page, "#waypoints li:nth-child(2) [aria-label$=up]")
    page.evaluate("document.querySelector('#waypoints li:nth-child(1) [aria-label*=wait]').select()")
    page.call("Input.insertText", text="2.5")
    page.key("Enter")
    page.evaluate("document.getElementById('laps').value = 3")
    click(page, "#patrol")
    (asked,) = until(lambda: session.asked("patrol"))
    assert asked["laps"] == 3
    assert [place["wait"] for place in asked["waypoints"]] == [2.5, None]
    assert asked["waypoints"][0]["pose"] == pytest.approx([1.5, 0.0, np.pi / 2], abs=0.02)
    assert asked["waypoints"][1]["pose"] == pytest.approx([0.5, -1.0, 0.0], abs=0.02)
    page.key("n")
    tip = (there[0] + 26, there[1])
    drag(page, tip, (there[0], there[1] - 40))
    click(page, "#waypoints li:nth-child(1) [aria-label^=Delete]")
    click(page, "#waypoints_save button")
    (saved,) = until(lambda: session.asked("waypoints_save"))
    assert saved["name"] == "my_patrol"
    assert len(saved["waypoints"]) == 1
    assert saved["waypoints"][0]["pose"] == pytest.approx([0.5, -1.0, np.pi / 2], abs=0.02)
    page.call("Page.reload")
    until(lambda: page.evaluate("document.querySelectorAll('#waypoints input').length") == 2)


def test_waypoints_that_are_loaded_replace_those_there_were(page, session):
    click(page, "[data-do=waypoints_load] button")
    until(lambda: session.asked("waypoints_load") == [{"name": ""}])
    session.told = {"loaded_waypoints": ((1.0, 2.0, 0.0, 4.0), (0.0, 2.0, 0.0, None))}
    until(lambda: page.evaluate("[...document.querySelectorAll('#waypoints input')].map((part) => part.value)")
          == ["1.00, 2.00, 0.00", "4", "0.00, 2.00, 0.00", ""])  # fmt: skip


def test_keep_outs_boxes_and_the_robot_are_placed_by_hand(page, session):
    corners = [[0.5, 0.5], [1.5, 0.5], [1.5, 1.5]]
    places = on_screen(page, *corners)
    page.key("k")
    for place in (*places[:2], (5 + places[0][0], places[0][1] - 60)):
        drag(page, place)
    page.key("Backspace")
    drag(page, places[2])
    drag(page, places[0])
    (asked,) = until(lambda: session.asked("keepout"))
    assert np.allclose(asked["outlines"], [corners], atol=0.02)
    session.told = {"keepout": (np.array(corners),)}
    until(lambda: page.evaluate("document.querySelectorAll('#keepouts button').length") == 1)
    click(page, "#keepouts button")
    until(lambda: session.asked("keepout")[1:] == [{"outlines": []}])
    page.key("b")
    drag(page, places[0])
    (box,) = until(lambda: session.asked("box"))
    assert box["xy"] == pytest.approx([0.5, 0.5], abs=0.02)
    assert box["size"] == 0.3
    page.key("r")
    drag(page, *on_screen(page, (0.0, 0.0), (0.5, 0.2), (1.0, -0.5)))
    (carried,) = until(lambda: session.asked("kidnap"))
    assert carried["pose"] == pytest.approx([1.0, -0.5, 0.0], abs=0.02)


def test_buttons_ask_for_what_they_say(page, session):
    session.told = {"task": "patrol"}
    until(lambda: page.evaluate("!document.getElementById('cancel').disabled"))
    for do in ("avoid", "explore", "wiggle", "cancel", "localise_global"):
        click(page, f"[data-do={do}]")
        until(lambda do=do: session.asked(do) == [{}])
    click(page, "#bag button")
    until(lambda: session.asked("record") == [{"name": "bag_1"}])
    session.told = {"recording": "bag_1", "mapping": True}
    until(lambda: shown_text(page, "pills") == "Rec bag_1Mapping")
    click(page, "#bag button")
    click(page, "#mapping")
    until(lambda: session.asked("record_stop") == session.asked("map_stop") == [{}])
    session.told = {}
    until(lambda: page.evaluate("document.querySelector('#bag input').value") == "bag_2")
    click(page, "[data-do=reset]")
    time.sleep(0.2)
    assert session.asked("reset") == []
    click(page, "[data-do=reset]")
    until(lambda: session.asked("reset") == [{}])


def test_time_can_stand_still_step_and_run(page, session):
    click(page, "#pause")
    until(lambda: shown_text(page, "factor") == "paused")
    before = session.stamp_ns
    click(page, "#step")
    until(lambda: session.stamp_ns > before)
    time.sleep(0.3)
    assert session.stamp_ns == before + session.period_ns
    click(page, "#pause")
    page.evaluate("document.getElementById('speed').value = '4'")
    page.evaluate("document.getElementById('speed').dispatchEvent(new Event('change'))")
    until(lambda: float(shown_text(page, "factor").rstrip("×") or 0) > 3.5)


def test_what_is_refused_is_said_where_one_looks_until_the_next_input(page):
    click(page, "[data-do=map_load] button")
    until(lambda: shown_text(page, "error").startswith("map_load: no map 'nowhere'"))
    click(page, "[data-do=avoid]")
    until(lambda: page.evaluate("document.getElementById('error').hidden"))


def test_layers_are_turned_off_and_on_and_remembered(page, served):
    (wall,) = on_screen(page, (0.02, 1.5))
    pixel = f"""(() => {{
      const stage = document.getElementById("stage"), box = stage.getBoundingClientRect();
      return [...stage.getContext("2d").getImageData({wall[0]} - box.left, {wall[1]} - box.top, 1, 1).data];
    }})()"""
    until(lambda: page.evaluate(pixel) == [0, 0, 0, 255])
    page.evaluate("document.getElementById('layers').open = true")
    click(page, "[name=layer-grid]")
    click(page, "[name=layer-map]")
    until(lambda: page.evaluate(pixel)[3] == 0)
    page.call("Page.reload")
    until(lambda: page.evaluate("document.querySelector('[name=layer-map]')?.checked === false"))
    assert page.evaluate("document.querySelector('[name=layer-scan]').checked")


def test_the_wheel_zooms_about_the_mouse_and_a_drag_pans(page):
    place = on_screen(page, (1.0, 1.0))[0]
    before = page.evaluate(FITTING)
    page.call("Input.dispatchMouseEvent", type="mouseWheel", x=place[0], y=place[1], deltaX=0, deltaY=-300)
    until(lambda: page.evaluate(FITTING)[2] > 1.4 * before[2])
    assert on_screen(page, (1.0, 1.0))[0] == pytest.approx(place, abs=1.0)
    drag(page, place, (place[0] + 30, place[1] - 20))
    assert on_screen(page, (1.0, 1.0))[0] == pytest.approx([place[0] + 30, place[1] - 20], abs=1.0)
    page.key("0")
    until(lambda: page.evaluate(FITTING)[2] < 1.4 * before[2])


def test_fingers_drive_with_the_pad_and_pinch_the_map(browser, session, served):
    open_page(browser, served, 844, 390, touch=True)
    x, y, size = browser.evaluate("(({left, top, width}) => [left, top, width])(document.getElementById('pad').getBoundingClientRect())")
    middle = (x + size / 2, y + size / 2)
    browser.touch("touchStart", middle)
    time.sleep(0.1)
    browser.touch("touchMove", (middle[0], y + 2))
    until(lambda: session.asked("drive") and session.asked("drive")[-1]["v"] > 0.15)
    assert abs(session.asked("drive")[-1]["w"]) < 0.1
    browser.touch("touchEnd")
    until(lambda: session.asked("stop"))
    before = browser.evaluate(FITTING)[2]
    browser.touch("touchStart", (300, 100))
    browser.touch("touchStart", (300, 100), (340, 100))
    for far in (60, 80, 100):
        browser.touch("touchMove", (300, 100), (300 + far, 100))
    browser.touch("touchEnd")
    until(lambda: browser.evaluate(FITTING)[2] > 2.0 * before)
    assert session.asked("pose_estimate") == []


def test_a_second_page_watches_until_it_takes_control(browser, session, served):
    address = served.url.replace("http:", "ws:").replace("/?", "/socket?")

    async def watch():
        first = await websocket_connect(address)
        await first.read_message()
        await asyncio.to_thread(look)
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


def test_an_empty_session_says_what_to_do_first(browser, session, served):
    session.told = {"map": None, "map_name": None, "maps": (), "localised": False}
    open_page(browser, served)
    until(lambda: shown_text(browser, "advice") == "No map yet. Start mapping, then drive with W A S D.")
    assert shown_text(browser, "maps") == "none saved yet"
    assert shown_text(browser, "where") == f"{SCENE.world} · burger · seed 3"
