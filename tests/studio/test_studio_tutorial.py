"""The tutorial through the page: drive and map, save, load, pose, wiggle, goal, patrol, avoid."""

import math
import subprocess
import sys
import time
from contextlib import contextmanager

import numpy as np
import pytest

from tests.helpers.browser import find_browser
from tests.studio.page import ENABLED, click, drag, on_screen, shown_text, until
from tests.studio.walk import ROOM, files

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        find_browser() is None,
        reason="no Chromium here: `make browser` installs one, or set TURTLEBAG_CHROMIUM",
    ),
]
# The page is sent ten frames a second: asking more often keeps three processes busy.
FRAME_S = 0.1
SCENE = "import('./scene.js').then(({ scene }) => "
KNOWN = f"{SCENE}scene.grids.map?.cells.reduce((count, cell) => count + (cell !== 255), 0) ?? 0)"
PARTICLES_STD = f"""{SCENE}{{
  const cloud = scene.blobs.particles ?? [], n = cloud.length / 3;
  const sum = (value) => cloud.reduce((all, here, at) => all + value(here, at % 3), 0);
  const middle = [0, 1].map((k) => sum((here, column) => (column === k ? here : 0)) / n);
  return Math.sqrt(sum((here, column) => (column < 2 ? (here - middle[column]) ** 2 : 0)) / n);
}})"""


class Person:
    """Somebody at the page, who sees what it shows."""

    def __init__(self, browser):
        self.browser = browser

    @property
    def head(self):
        return self.browser.evaluate(f"{SCENE}scene.head)")

    def speed(self, factor):
        choose = "document.getElementById('speed')"
        self.browser.evaluate(f"{choose}.value = '{factor}', {choose}.dispatchEvent(new Event('change'))")

    def drive(self, x, y, v=18):
        """To a place by W, A, S, D: `v` steps ahead, or turning when it lies aside."""
        steps, turns, end = 0, 0, time.monotonic() + 600.0
        while True:
            assert time.monotonic() < end, f"never came to {x}, {y}"
            px, py, yaw = self.head["pose"]
            if math.hypot(x - px, y - py) < 0.25:
                break
            aside = math.remainder(math.atan2(y - py, x - px) - yaw, 2.0 * math.pi)
            ahead, turn = v if abs(aside) < 0.4 else 0, max(-8, min(8, round(8.0 * aside)))
            self.browser.key("w" if ahead > steps else "s", abs(ahead - steps))
            self.browser.key("a" if turn > turns else "d", abs(turn - turns))
            steps, turns = ahead, turn
            time.sleep(FRAME_S)
        self.browser.key(" ")

    def arrow(self, tool, x, y, yaw):
        """Press, drag, release with a tool."""
        self.browser.key(tool)
        (start,) = on_screen(self.browser, (x, y))
        drag(self.browser, start, (start[0] + 60 * math.cos(yaw), start[1] - 60 * math.sin(yaw)))

    def task(self, task, timeout_s):
        """Wait until it has begun and is over."""
        until(lambda: self.head["task"] == task, 60.0)
        until(lambda: self.head["task"] == "", timeout_s, FRAME_S)

    def shift(self):
        """How far the robot is from where it takes itself to be [m]."""
        return float(np.hypot(*np.subtract(self.head["pose"], self.head["true_pose"])[:2]))


@contextmanager
def studio(browser, world, out):
    """Somebody at the page of `turtlebag studio`, until that ends by itself."""
    command = [sys.executable, "-m", "turtlebag", "studio", "--world", str(world), "--seed", "1"]
    process = subprocess.Popen(
        [*command, "--no-browser", "--out", str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        browser.open(process.stdout.readline().strip(), 1280, 720)
        until(lambda: browser.evaluate(ENABLED), 60.0)
        yield Person(browser)
        for _ in range(2):
            click(browser, "[data-do=end]")
        _, complaints = process.communicate(timeout=60)
        assert process.returncode == 0, complaints
        said = until(lambda: shown_text(browser, "over"))
        assert said.startswith(f"The session has ended.Its files are in {out}")
        assert f"turtlebag studio --replay {out}/session.yaml --out {out}-again" in said
        assert browser.evaluate("document.getElementById('broken').hidden")
        assert browser.problems() == []
        browser.leave()
    finally:
        process.kill()


@pytest.mark.longest
def test_the_tutorial_in_the_window(browser, tmp_path):
    (tmp_path / "room.yaml").write_text(ROOM)
    with studio(browser, tmp_path / "room.yaml", tmp_path / "live") as person:
        assert shown_text(browser, "advice") == "No map yet. Start mapping, then drive with W A S D."
        click(browser, "#bag button")
        click(browser, "#mapping")
        person.speed(1)
        person.drive(-1.2, -0.35)
        before = browser.evaluate(KNOWN)
        person.speed(4)
        click(browser, "[data-do=explore]")
        person.task("explore", 240.0)
        assert browser.evaluate(KNOWN) > 1.05 * before > 1000
        click(browser, "#bag button")
        click(browser, "[data-do=map_save] button")
        until(lambda: person.head["maps"] == ["map_room"], 60.0)
        click(browser, "[data-do=map_load] button")
        until(lambda: shown_text(browser, "advice").startswith("Where is the robot?"), 60.0)
        person.speed(4)  # at most speed, a task may be over between two frames of the page

        x, y, yaw = person.head["true_pose"]
        person.arrow("p", x + 0.2, y + 0.22, yaw + math.radians(20))
        until(lambda: person.head["localised"], 60.0)
        wide = until(lambda: browser.evaluate(PARTICLES_STD))
        until(lambda: person.head["paused"])
        off = person.shift()
        assert off > 0.2
        click(browser, "[data-do=wiggle]")
        person.task("wiggle", 60.0)
        # How sure and how right it is differs by when somebody clicked; in simulated time: test_session_walk.
        until(lambda: browser.evaluate(PARTICLES_STD) < 0.5 * wide)
        assert person.shift() < 0.35 * off

        person.arrow("g", 1.2, -0.8, 0.0)
        person.task("goal", 120.0)
        assert [goal["status"] for goal in person.head["goals"]] == ["reached"]
        x, y, yaw = person.head["true_pose"]
        assert math.hypot(x - 1.2, y + 0.8) < 0.1
        assert abs(yaw) < 0.2

        for place in ((1.2, 0.6), (0.4, 1.0)):
            person.arrow("n", *place, 0.0)
        until(lambda: browser.evaluate("document.querySelectorAll('#waypoints li').length") == 2)
        click(browser, "#patrol")
        person.task("patrol", 240.0)
        assert [goal["status"] for goal in person.head["goals"]] == ["reached"] * 2
        lines = browser.evaluate("document.getElementById('lines').innerText")
        assert "2 of 2 goals reached, no collisions" in lines

    # that a session which came over the socket leads to the same bytes again, test_studio_command holds
    assert {"bags/bag_1/metadata.yaml", "session.yaml"} <= set(map(str, files(tmp_path / "live")))


def test_avoiding_in_the_house_shows_the_sectors_and_the_decision(browser, tmp_path):
    with studio(browser, "turtlebot3_house", tmp_path / "live") as person:
        click(browser, "[data-do=avoid]")
        until(lambda: person.head["task"] == "avoid", 60.0)
        start = person.head["true_pose"]
        until(lambda: shown_text(browser, "sectors").startswith("Left "))
        person.speed(4)
        until(lambda: math.dist(person.head["true_pose"][:2], start[:2]) > 1.0, 60.0)
        until(lambda: "veer" in shown_text(browser, "sectors"), 60.0)
        browser.key("w", 3)
        until(lambda: shown_text(browser, "state") == "Avoid: teleop")
        browser.key("q")
        until(lambda: person.head["owner"] == "navigation")
        click(browser, "#cancel")
        until(lambda: person.head["task"] == "")
