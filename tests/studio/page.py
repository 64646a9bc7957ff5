"""The studio's page in a browser, on the real server, with a session that notes what it is asked."""

import json
import time

import numpy as np

from tests.studio.fakes import FakeSession, view
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.studio.access import LOOPBACK
from turtlebag.pipeline.studio.inputs import Drive
from turtlebag.pipeline.studio.view import Event, MapLayer, Stop

HERE = f"http://{LOOPBACK}:"
ENABLED = "!document.getElementById('controls').disabled"
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
        self._waypoints = ()

    def apply(self, entry):
        if entry.do == "map_load":
            raise InputError("map_load: no map 'nowhere' in this session: save one first")
        self.applied.append((self.stamp_ns, entry))
        self._drive = entry if isinstance(entry, Drive) else Drive()
        if entry.do == "waypoints":
            self._waypoints = tuple(Stop(*stop.pose, stop.wait) for stop in entry.waypoints)
        self._events.append(Event(len(self._events) + 1, self.stamp_ns * 1e-9, entry.do, "info"))
        return entry.do

    def view(self):
        known = {
            "map": self._map,
            "map_name": "",
            "maps": ("",),
            "localised": True,
            "sure": 0.9,
            "waypoints": self._waypoints,
        }
        given = {"stamp_ns": self.stamp_ns, "events": tuple(self._events), "command": (self._drive.v, 0.0)}
        return view(**known | given | self.told)

    def asked(self, do):
        """Inputs of that kind so far, as plain values."""
        entries = [entry.model_dump(exclude={"do"}) for _, entry in self.applied if entry.do == do]
        return json.loads(json.dumps(entries))


def open_page(browser, served, width=1280, height=720, **how):
    browser.open(served.url, width, height, **how)
    browser.evaluate("sessionStorage.clear(), localStorage.clear()")
    until(
        lambda: browser.evaluate(ENABLED) or browser.evaluate("!document.getElementById('watching').hidden")
    )


def until(condition, timeout_s=10.0, pause_s=0.03):
    end = time.monotonic() + timeout_s
    while not (found := condition()):
        assert time.monotonic() < end, "it did not happen"
        time.sleep(pause_s)
    return found


def click(browser, selector):
    """A click of the mouse in the middle of an element."""
    place = f"document.querySelector({selector!r})"
    browser.evaluate(f"{place}.scrollIntoView({{block: 'nearest', behavior: 'instant'}})")
    left, top, width, height = box_of(browser, selector)
    drag(browser, (left + width / 2, top + height / 2))


def box_of(browser, selector):
    """Left, top, width and height of an element, in the window."""
    box = f"document.querySelector({selector!r}).getBoundingClientRect()"
    return browser.evaluate(f"(({{left, top, width, height}}) => [left, top, width, height])({box})")


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
      const pixels = {json.dumps(places)}.map(([x, y]) => toScreen(x, y));
      return pixels.map(([x, y]) => [x + box.left, y + box.top]);
    }})"""
    return browser.evaluate(found)


def shown_text(browser, name):
    return browser.evaluate(f"document.getElementById({name!r}).textContent.trim()")
