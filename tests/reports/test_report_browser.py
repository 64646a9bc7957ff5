"""The page in a real browser: nothing overflows, every picture is there, the map answers the mouse."""

import shutil
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

from tests.helpers.browser import Browser, find_browser
from tests.helpers.report_fakes import fake_map, undrawn
from turtlebag.datasets.other_systems import SystemFiles
from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.stages.command_line import read
from turtlebag.pipeline.stages.compare import compare_outputs, compare_with_systems
from turtlebag.pipeline.stages.report import make_index
from turtlebag.planners.tasks.waypoints import load_waypoints

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        find_browser() is None,
        reason="no Chromium here: `make browser` installs one, or set TURTLEBAG_CHROMIUM",
    ),
]

OVERFLOW = """[...document.querySelectorAll("body *")].filter((element) => {
  const box = element.getBoundingClientRect();
  return box.right > innerWidth + 1 && !element.closest(".scroll, .recipe, svg, details:not([open])");
}).map((element) => element.tagName + "." + element.className)"""
CENTRE = """(() => {
  document.querySelector("details.pick").open = true;
  const svg = document.querySelector(".pointer svg");
  svg.scrollIntoView({block: "center", behavior: "instant"});
  const p = (x, y) => {
    const q = new DOMPoint(x, -y).matrixTransform(svg.getScreenCTM());
    return [q.x, q.y];
  };
  return {room: p(-1.0, 1.0), right: p(0.0, 1.0), wall: p(0.0, 0.28), inside: p(0.0, 0.0)};
})()"""
CUT = """[...document.querySelectorAll(".scroll")].filter((box) => box.scrollWidth > box.clientWidth)
  .map((box) => box.closest("section").innerText)"""
COPIED = """(async () => {
  for (let k = 0; k < 100; k++) {
    if (document.querySelector(".pointer output").textContent.endsWith("copied")) return true;
    await new Promise((done) => setTimeout(done, 20));
  }
  return false;
})()"""
READOUT = 'document.querySelector(".pointer output").textContent'
ARRIVED = """(async () => {
  for (let k = 0; k < 100; k++) {
    const top = document.getElementById("word-odometry").getBoundingClientRect().top;
    if (top >= 0 && top < innerHeight) return true;
    await new Promise((done) => setTimeout(done, 20));
  }
  return false;
})()"""
UNFOLD = "for (const box of document.querySelectorAll('details')) box.open = true"


@pytest.fixture(scope="module")
def address(drawn, tmp_path_factory):
    base = tmp_path_factory.mktemp("page")
    for name in ("record", "map", "run"):
        shutil.copytree(drawn / name, base / name)
    make_index([base], Output(base / "index"))
    fake_map(base / "other", base / "record", sigma_m=0.02)
    compare_outputs([base / "map", base / "other"], Output(base / "comparison"))
    files = SystemFiles("cartographer", base / "other/trajectory.tum", base / "other/map.yaml")
    compare_with_systems(base / "map", [files], Output(base / "systems"))
    shutil.copytree(drawn / "report", base / "report")
    return (base / "report/index.html").as_uri()


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(find_browser(), tmp_path_factory.mktemp("profile")) as browser:
        yield browser


def test_tables_of_four_systems_are_not_cut(browser, address, tmp_path):
    base = Path(urlsplit(address).path).parents[1]
    names = ("cartographer", "slam_toolbox", "kiss_icp")
    files = [SystemFiles(name, base / "other/trajectory.tum", base / "other/map.yaml") for name in names]
    with undrawn():
        compare_with_systems(base / "map", files, Output(tmp_path / "systems"))
    browser.open((tmp_path / "systems/index.html").as_uri(), 1200)
    assert browser.evaluate(CUT) == []


@pytest.mark.parametrize(("width", "dark"), [(400, False), (1400, False), (1400, True)])
@pytest.mark.parametrize("unfolded", [False, True])
def test_the_page_fits_and_complains_of_nothing(browser, address, width, dark, unfolded):
    browser.open(address, width, dark=dark)
    if unfolded:
        browser.evaluate(UNFOLD)
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    assert browser.evaluate(OVERFLOW) == []
    assert browser.problems() == []
    assert browser.requests() == [address]


def test_the_outcome_is_one_screen_and_each_stage_a_verdict_and_one_picture(browser, address):
    browser.open(address, 1280)
    assert browser.evaluate("document.querySelector('main').getBoundingClientRect().top") < 720
    assert browser.evaluate("document.documentElement.scrollHeight") < 1600
    seen = """[...document.querySelectorAll(".stage")].map((stage) =>
      [...stage.querySelectorAll("h3, .verdict, .drawing, .animation, .section, figcaption")]
        .filter((part) => part.checkVisibility()).map((part) => part.className || part.tagName))"""
    assert [parts[0::2] for parts in browser.evaluate(seen)] == [["H3", "drawing"]] * 3


def test_a_link_unfolds_what_it_leads_to(browser, address):
    for anchor, part in (
        ("room-patrol", ".section"),
        ("room/map:ate_m.max", ".value"),
        ("word-odometry", "dd"),
    ):
        browser.open(address, 1400)
        browser.evaluate(f"location.hash = {anchor!r}")
        shown = f"document.getElementById({anchor!r}).querySelector({part!r}).checkVisibility()"
        browser.evaluate("new Promise((done) => setTimeout(done, 50))")
        assert browser.evaluate(shown) is True
    assert browser.evaluate(ARRIVED) is True


def test_one_button_unfolds_every_stage_and_folds_it_again(browser, address):
    browser.open(address, 1400)
    count = "document.querySelectorAll('.rest[open]').length"
    press = "document.querySelector('button.unfold').click()"
    found = [browser.evaluate(count)]
    for _ in range(2):
        browser.evaluate(press)
        found.append(browser.evaluate(count))
    assert found == [0, 3, 0]


def test_paper_has_every_stage_unfolded_and_the_screen_has_not_afterwards(browser, address):
    browser.open(address, 1400)
    count = "document.querySelectorAll('.rest[open]').length"
    browser.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert browser.evaluate(count) == 3
    browser.evaluate("dispatchEvent(new Event('afterprint'))")
    assert browser.evaluate(count) == 0


def test_every_picture_is_there(browser, address):
    browser.open(address, 1400)
    browser.evaluate(UNFOLD)
    drawn = '[...document.querySelectorAll(".drawing svg, .pointer svg")]'
    sizes = browser.evaluate(drawn + ".map((svg) => svg.getBoundingClientRect().height)")
    assert len(sizes) == 11
    assert min(sizes) > 100
    loaded = """Promise.all([...document.querySelectorAll("image, img")].map(async (element) => {
      const image = new Image();
      image.src = element.getAttribute("href") ?? element.getAttribute("xlink:href") ?? element.src;
      await image.decode();
      return image.naturalWidth;
    }))"""
    widths = browser.evaluate(loaded)
    assert len(widths) > 8
    assert min(widths) > 0


def test_the_animation_of_a_tall_map_is_no_higher_than_a_screen(browser, address):
    browser.open(address, 1400)
    browser.evaluate(UNFOLD)
    tall = """(async () => {
      const image = document.querySelector(".animation");
      image.src = "data:image/svg+xml,<svg xmlns='http://www.w3.org/2000/svg' width='125' height='400'/>";
      await image.decode();
      return image.getBoundingClientRect().height;
    })()"""
    assert 100 < browser.evaluate(tall) <= 560


def test_dark_and_light_are_both_readable(browser, address):
    colours = []
    for dark in (False, True):
        browser.open(address, 1400, dark=dark)
        colours.append(
            browser.evaluate(
                "[getComputedStyle(document.body).color, getComputedStyle(document.body).backgroundColor]"
            )
        )
    brightness = [[sum(int(n) for n in c[4:-1].split(",")) for c in pair] for pair in colours]
    assert brightness[0][1] - brightness[0][0] > 400
    assert brightness[1][0] - brightness[1][1] > 400


def test_the_map_says_where_the_cursor_is(browser, address):
    browser.open(address, 1400)
    places = browser.evaluate(CENTRE)
    browser.mouse("mouseMoved", *places["room"])
    assert browser.evaluate(READOUT).startswith("x -1.00  y 1.00  free")
    browser.mouse("mouseMoved", *places["wall"])
    assert browser.evaluate(READOUT).endswith("occupied")
    browser.mouse("mouseMoved", *places["inside"])
    assert browser.evaluate(READOUT).endswith("unknown")


def test_a_click_gives_a_goal_and_a_drag_a_heading(browser, address):
    browser.open(address, 400)
    places = browser.evaluate(CENTRE)
    browser.mouse("mousePressed", *places["room"])
    browser.mouse("mouseReleased", *places["room"])
    assert browser.evaluate(READOUT).startswith("--goal=-1.0")
    assert browser.evaluate(READOUT).split()[0].endswith(",0.00")
    browser.mouse("mousePressed", *places["right"])
    browser.mouse("mouseMoved", *places["room"], pressed=True)
    browser.mouse("mouseReleased", *places["room"])
    x, y, yaw = (
        float(part) for part in browser.evaluate(READOUT).split()[0].removeprefix("--goal=").split(",")
    )
    assert (x, y) == pytest.approx((0.0, 1.0), abs=0.03)
    assert abs(yaw) == pytest.approx(3.14, abs=0.03)
    assert browser.problems() == []


def goal(text):
    return tuple(float(part) for part in text.split()[0].removeprefix("--goal=").split(","))


def test_what_is_clicked_is_in_the_clipboard(browser, address):
    browser.open(address, 1400)
    browser.call("Browser.grantPermissions", permissions=["clipboardReadWrite", "clipboardSanitizedWrite"])
    browser.call("Page.bringToFront")
    places = browser.evaluate(CENTRE)
    browser.mouse("mousePressed", *places["room"])
    browser.mouse("mouseReleased", *places["room"])
    assert browser.evaluate(COPIED) is True
    assert goal(browser.clipboard()) == pytest.approx((-1.0, 1.0, 0.0), abs=0.03)


def pick(browser, mode):
    browser.evaluate(f"document.querySelector('.modes input[value={mode}]').click()")


def click(browser, place):
    browser.mouse("mousePressed", *place)
    browser.mouse("mouseReleased", *place)


def test_a_click_copies_an_initial_pose_instead_when_that_is_chosen(browser, address):
    browser.open(address, 1400)
    places = browser.evaluate(CENTRE)
    pick(browser, "initial-pose")
    click(browser, places["room"])
    option = browser.evaluate(READOUT).split()[0]
    assert option.startswith("--initial-pose=")
    asked = read(["localise", "rec", "--map", "m", option])
    assert asked.initial_pose == pytest.approx([-1.0, 1.0, 0.0], abs=0.03)


WAYPOINTS = """({
  text: document.querySelector(".waypoints pre").textContent,
  file: document.querySelector(".waypoints .save").href,
  name: document.querySelector(".waypoints .save").download,
  marks: document.querySelectorAll(".picked circle").length,
  shown: document.querySelector(".waypoints").checkVisibility(),
})"""


def test_clicks_collect_into_a_waypoints_file_that_the_patrol_reads(browser, address, tmp_path):
    browser.open(address, 1400)
    assert browser.evaluate(WAYPOINTS)["shown"] is False
    pick(browser, "waypoints")
    places = browser.evaluate(CENTRE)
    click(browser, places["room"])
    browser.evaluate(
        "document.querySelector('.pointer svg').scrollIntoView({block: 'center', behavior: 'instant'})"
    )
    places = browser.evaluate(CENTRE)
    browser.mouse("mousePressed", *places["right"])
    browser.mouse("mouseMoved", *places["room"], pressed=True)
    browser.mouse("mouseReleased", *places["room"])
    click(browser, places["wall"])
    assert browser.evaluate(READOUT).startswith("not added (occupied")
    found = browser.evaluate(WAYPOINTS)
    assert (found["name"], found["marks"], found["shown"]) == ("waypoints.yaml", 2, True)
    assert unquote(found["file"]).partition(",")[2] == found["text"]
    file = tmp_path / "waypoints.yaml"
    file.write_text(found["text"])
    first, second = load_waypoints(file).waypoints
    assert first.T_map_goal.xyt.tolist() == pytest.approx([-1.0, 1.0, 0.0], abs=0.03)
    assert second.T_map_goal.xyt.tolist() == pytest.approx([0.0, 1.0, 3.14], abs=0.03)
    browser.evaluate("document.querySelector('.waypoints .undo').click()")
    assert browser.evaluate(WAYPOINTS)["marks"] == 1
    assert browser.problems() == []


def test_a_click_into_a_wall_says_that_nobody_can_go_there(browser, address):
    browser.open(address, 1400)
    places = browser.evaluate(CENTRE)
    browser.mouse("mousePressed", *places["wall"])
    browser.mouse("mouseReleased", *places["wall"])
    assert "(occupied: not a place to go)" in browser.evaluate(READOUT)


def test_a_finger_taps_a_goal_and_drags_a_heading_up_the_page_without_moving_it(browser, address):
    browser.open(address, 400, touch=True)
    places = browser.evaluate(CENTRE)
    scrolled = browser.evaluate("scrollY")
    browser.touch("touchStart", places["room"])
    browser.touch("touchEnd")
    assert goal(browser.evaluate(READOUT)) == pytest.approx((-1.0, 1.0, 0.0), abs=0.03)
    x, y = places["right"]
    browser.touch("touchStart", (x, y))
    for step in (10, 25, 40):
        browser.touch("touchMove", (x, y - step))
    browser.touch("touchEnd")
    assert goal(browser.evaluate(READOUT)) == pytest.approx((0.0, 1.0, 1.57), abs=0.04)
    assert browser.evaluate("scrollY") == scrolled
    assert browser.problems() == []


def test_two_fingers_set_no_goal(browser, address):
    browser.open(address, 400, touch=True)
    places = browser.evaluate(CENTRE)
    before = browser.evaluate(READOUT)
    browser.touch("touchStart", places["room"])
    browser.touch("touchStart", places["room"], places["right"])
    browser.touch("touchEnd")
    assert not browser.evaluate(READOUT).startswith("--goal")
    assert before == "x, y in metres"


@pytest.mark.parametrize("name", ["index", "comparison", "systems"])
@pytest.mark.parametrize(("width", "dark"), [(400, True), (1400, False)])
def test_the_other_pages_fit_and_complain_of_nothing_too(browser, address, name, width, dark):
    browser.open(address.replace("/report/", f"/{name}/"), width, dark=dark)
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    assert browser.evaluate(OVERFLOW) == []
    assert browser.problems() == []


COLUMN = """(() => {
  const place = [...document.querySelectorAll("th")].findIndex((head) => head.textContent.startsWith("%s"));
  return [...document.querySelectorAll("tbody tr")].filter((row) => !row.hidden)
    .map((row) => row.cells[place].textContent);
})()"""
PRESS = (
    '[...document.querySelectorAll("th button")].find((head) => head.textContent.startsWith("%s")).click()'
)


def test_the_index_sorts_by_number_both_ways_and_keeps_what_is_empty_last(browser, address):
    browser.open(address.replace("/report/", "/index/"), 1400)
    unsorted = browser.evaluate(COLUMN % "distance")
    browser.evaluate(PRESS % "distance")
    up = browser.evaluate(COLUMN % "distance")
    browser.evaluate(PRESS % "distance")
    down = browser.evaluate(COLUMN % "distance")
    known = sorted((text for text in unsorted if text), key=lambda text: float(text.split("\u202f")[0]))
    assert [text for text in up if text] == known
    assert [text for text in down if text] == known[::-1]
    assert up[len(known) :] == down[len(known) :] == [""] * (len(up) - len(known))


def test_the_index_shows_the_lines_that_hold_the_words_typed(browser, address):
    browser.open(address.replace("/report/", "/index/"), 1400)
    total = len(browser.evaluate(COLUMN % "output"))
    browser.evaluate("document.querySelector('.filter').focus()")
    browser.call("Input.insertText", text="ROOM map")
    assert browser.evaluate(COLUMN % "stage") == ["map"]
    assert browser.evaluate("document.querySelector('.count').textContent") == f"1 of {total}"
