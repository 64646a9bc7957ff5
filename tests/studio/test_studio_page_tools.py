"""The studio's page: what keys, mouse and fingers do on it is what the session is asked for."""

import re
import time

import numpy as np
import pytest

from tests.helpers.browser import find_browser
from tests.studio.fakes import PERIOD_NS
from tests.studio.page import FITTING, box_of, click, drag, on_screen, open_page, shown_text, until
from turtlebag.pipeline.studio.view import Stop

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        find_browser() is None,
        reason="no Chromium here: `make browser` installs one, or set TURTLEBAG_CHROMIUM",
    ),
]


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


def test_a_task_gets_the_robot_from_the_hand_that_drove_it(page, session):
    page.key("w", 5)
    until(lambda: session.asked("drive"))
    click(page, "[data-do=avoid]")
    until(lambda: session.asked("avoid"))
    time.sleep(0.5)
    assert [entry.do for _, entry in session.applied[-2:]] == ["release", "avoid"]


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
    (place,) = on_screen(page, (0.25, -0.5))
    drag(page, place)
    until(lambda: "copied" in shown_text(page, "readout"))
    assert [float(value) for value in page.clipboard().split(", ")] == pytest.approx([0.25, -0.5], abs=0.02)


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
    session.told = {"waypoints": (Stop(1.0, 2.0, 0.0, 4.0), Stop(0.0, 2.0, 0.0, None))}
    fields = "[...document.querySelectorAll('#waypoints input')].map((part) => part.value)"
    until(lambda: page.evaluate(fields) == ["1.00, 2.00, 0.00", "4", "0.00, 2.00, 0.00", ""])


def test_a_waypoint_where_the_robot_cannot_stand_is_marked_and_said(page, session):
    session.told = {"waypoints": (Stop(0.5, 0.0, 0.0, None), Stop(1.0, 1.0, 0.0, None, "off the map"))}
    until(lambda: not page.evaluate("document.getElementById('blocked').hidden"))
    assert shown_text(page, "blocked") == "Waypoint 2 is off the map: the robot cannot stop there."
    rows = "[...document.querySelectorAll('#waypoints li')].map((row) => row.classList.contains('blocked'))"
    assert page.evaluate(rows) == [False, True]
    session.told = {"waypoints": (Stop(0.5, 0.0, 0.0, None),)}
    until(lambda: page.evaluate("document.getElementById('blocked').hidden"))


def test_a_bag_gets_a_name_that_no_page_has_taken(page, session):
    session.told = {"bags": ("bag_1", "bag_2")}
    until(lambda: page.evaluate("document.querySelector('#bag input').value") == "bag_3")


def test_keep_outs_boxes_and_the_robot_are_placed_by_hand(page, session):
    corners = [[0.5, 0.5], [1.5, 0.5], [1.5, 1.5]]
    places = on_screen(page, *corners)
    page.key("k")
    for place in (*places[:2], (5 + places[0][0], places[0][1] - 60)):
        drag(page, place)
    page.key("Backspace")
    drag(page, places[2])
    page.key("Enter")
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
    session.told = {"bags": ("bag_1",)}
    until(lambda: page.evaluate("document.querySelector('#bag input').value") == "bag_2")
    click(page, "[data-do=reset]")
    time.sleep(0.2)
    assert session.asked("reset") == []
    click(page, "[data-do=reset]")
    until(lambda: session.asked("reset") == [{}])
    click(page, "[data-do=reset]")
    time.sleep(0.2)
    assert session.asked("reset") == [{}]


def test_time_can_stand_still_step_and_run(page, session):
    click(page, "#pause")
    until(lambda: shown_text(page, "factor") == "paused")
    before = session.stamp_ns
    click(page, "#step")
    until(lambda: session.stamp_ns > before)
    time.sleep(0.3)
    assert session.stamp_ns == before + PERIOD_NS
    click(page, "#pause")
    # at once: the page puts back what the session last said, unless somebody holds the field
    page.evaluate(
        "const speed = document.getElementById('speed'); speed.value = '4'; "
        "speed.dispatchEvent(new Event('change'))"
    )
    # a busy machine takes a while to come to it
    until(lambda: re.match(r"[34]\.\d", shown_text(page, "factor")), 60.0)


def test_time_stands_still_after_a_pose_was_set_until_something_is_done(page, session):
    start, tip = on_screen(page, (0.5, 1.0), (0.5, 2.0))
    for go_on, do in (
        (lambda: click(page, "[data-do=wiggle]"), "wiggle"),
        (lambda: page.key("w"), "drive"),
        (lambda: click(page, "#pause"), None),
    ):
        page.key("p")
        drag(page, start, tip)
        until(lambda: shown_text(page, "factor") == "paused")
        until(lambda: shown_text(page, "advice").startswith("Paused: does the scan lie on the walls?"))
        before = session.stamp_ns
        time.sleep(0.3)
        assert session.stamp_ns == before
        go_on()
        until(lambda: shown_text(page, "factor") != "paused")
        until(lambda before=before: session.stamp_ns > before)
        assert do is None or session.asked(do)
        page.key("x")


def test_fingers_drive_with_the_pad_and_pinch_the_map(browser, session, served):
    open_page(browser, served, 844, 390, touch=True)
    x, y, size, _ = box_of(browser, "#pad")
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


def test_the_list_of_waypoints_is_worked_by_keyboard_alone(page, session):
    focus = "document.activeElement.ariaLabel"
    page.key("n")
    for text in ("1, 0, 0", "2, 0, 0"):
        page.evaluate("document.getElementById('typed').focus()")
        page.call("Input.insertText", text=text)
        page.key("Enter")
    page.evaluate("document.querySelector('#waypoints input').select()")
    page.call("Input.insertText", text="1.5, 0.5, 1")
    page.key("Tab")
    assert page.evaluate(focus) == "Waypoint 1: wait in seconds"
    page.call("Input.insertText", text="four")
    page.key("Tab", 2)
    until(lambda: shown_text(page, "error") == 'waypoint 1: a wait is a number of seconds, not "four"')
    assert page.evaluate(focus) == "Delete waypoint 1"
    page.evaluate("document.querySelector('[aria-label=\"Move waypoint 1 down\"]').focus()")
    page.key("Enter")
    assert page.evaluate(focus) == "Delete waypoint 2"
    page.evaluate("document.querySelector('[aria-label=\"Delete waypoint 1\"]').focus()")
    page.key("Enter")
    assert page.evaluate(focus) == "Delete waypoint 1"
    page.evaluate("document.getElementById('patrol').focus()")
    page.key("Enter")
    (asked,) = until(lambda: session.asked("patrol"))
    assert asked["waypoints"] == [{"pose": [1.5, 0.5, 1.0], "wait": None}]
