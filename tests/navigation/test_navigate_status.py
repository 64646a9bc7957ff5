"""Status lines during a run, and a verdict and an exit code by ground truth."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Joints, LidarSpec, Observation, Odometry, Scan, Twist
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.navigation.avoid_driver import AvoidDriver
from turtlebag.pipeline.navigation.status_lines import News, verdict
from turtlebag.pipeline.terminal.messages import length
from turtlebag.planners.tasks.patrol import GoalSequence, SequenceConfig
from turtlebag.planners.tasks.sector_rule import AvoidConfig, Sectors, in_words
from turtlebag.planners.tasks.waypoints import Waypoint, parse_waypoint
from turtlebag.reports.numbers import shown
from turtlebag.sim.robots import load_robot
from turtlebag.sim.simulator import Truth

WORLD = "turtlebot3_world"
S = 10**9


@pytest.mark.slow
def test_a_goal_that_only_the_robot_believes_reached_is_a_failure(true_map, tmp_path, capfd):
    words = ["navigate", "--world", WORLD, "--task", "goal", "--map", str(true_map), "--seed", "1"]
    # The arena's mirror image: the scans fit there as well.
    words += ["--goal=0,2,0", "--initial-pose=2,0.5,3.14", "--out", str(tmp_path / "run")]
    assert main(words) == 1
    metrics = json.loads((tmp_path / "run/metrics.json").read_text())
    assert (metrics["success"], metrics["true_success"]) == (True, False)
    assert metrics["goals"][0]["status"] == "reached"
    said = capfd.readouterr().err
    assert re.search(
        r"^goal 1 of 1: reported as reached after .* the robot is 4\.0\d m away from it$", said, re.M
    )
    assert "failed: 0 of 1 goals reached (the robot reported 1), no collisions" in said
    assert not re.search(r": reached|succeeded", said)


class Owner:
    owner, state = "navigation", "follow"


def told(sequence, *ticks):
    """The lines after each tick: (seconds, what happens, true x, contact)."""
    lines: list[str] = []
    news = News("opening", lines.append, lambda stamp_ns, doing: None)
    after = []
    for seconds, happens, x, contact in ticks:
        happens(round(seconds * S))
        truth = Truth(round(seconds * S), SE2.from_xyt(x, 0.0, 0.0), Twist(), contact, False)
        news.tick(round(seconds * S), Owner(), sequence, truth)
        after.append(list(lines))
        lines.clear()
    return after


def test_a_line_comes_when_a_goal_is_set_and_when_it_ends():
    goals = [Waypoint(SE2.from_xyt(x, 0.0, 0.0), "", (x, 0.0, 0.0)) for x in (1.0, 2.0)]
    bad = parse_waypoint({"x": 1.5, "y": 0.5, "ywa": 0.0})
    sequence = GoalSequence([goals[0], bad, goals[1]], SequenceConfig(initial_wait=3.0, pause=1.0))
    after = told(
        sequence,
        (0.0, sequence.update, 0.0, False),
        (3.0, sequence.update, 0.0, False),
        (9.0, lambda now: sequence.close("reached", "", now), 1.02, False),
        (9.5, sequence.update, 1.02, False),
        (10.0, sequence.update, 1.02, False),
        (11.0, sequence.update, 1.02, True),
        (20.0, lambda now: sequence.close("unreachable", "no way", now), 1.02, False),
    )
    assert after == [
        ["opening"],
        ["goal 1 of 3: heading to (1, 0)"],
        ["goal 1 of 3: reached after 6.0 s, 2.00 cm off"],
        [],
        [
            "goal 2 of 3: rejected: unknown key ywa (known: x, y, yaw, quaternion, wait)",
            "goal 3 of 3: heading to (2, 0)",
        ],
        [],
        ["goal 3 of 3: collided after 10.0 s: no way"],
    ]


def test_goals_that_end_together_share_a_line():
    goals = [Waypoint(SE2.from_xyt(1.0, 0.0, 0.0), "", (1.0, 0.0, 0.0))] * 4
    untold, cut = (GoalSequence(goals, SequenceConfig(initial_wait=0.0)) for _ in range(2))
    (after,) = told(
        untold, (0.0, lambda now: untold.close_all("rejected", "no initial pose", now), 0.0, False)
    )
    assert after == ["opening", "goals 1 to 4 of 4: rejected: no initial pose"]
    after = told(
        cut,
        (0.0, cut.update, 0.0, False),
        (2.0, lambda now: cut.close_all("timeout", "the end", now), 0.0, False),
    )
    assert after[1] == ["goal 1 of 4: timeout after 2.0 s: the end", "goals 2 to 4 of 4: timeout: the end"]


def test_a_bad_entry_keeps_what_was_written_and_names_the_key():
    assert parse_waypoint({"x": 1.5, "y": 0.5, "ywa": 0.0}).written[:2] == (1.5, 0.5)
    missing = parse_waypoint({"y": 0.5})
    assert (missing.T_map_goal, missing.reason) == (None, "x is missing")


def test_the_verdict_is_by_the_truth():
    goal = {"status": "reached", "error_m": 0.01}
    far = {"status": "reached", "error_m": 0.26}
    run = {"collisions": {"visible": 0, "low": 0}, "distance_m": 3.0, "time_s": 20.0}
    good = verdict({**run, "true_success": True, "goals": [goal, goal]})
    assert good == "succeeded: 2 of 2 goals reached, no collisions, 3.00 m in 20.0 simulated seconds"
    bad = verdict(
        {**run, "true_success": False, "goals": [goal, far], "collisions": {"visible": 2, "low": 1}}
    )
    assert bad.startswith(
        "failed: 1 of 2 goals reached (the robot reported 2), 3 collisions (2 visible to the lidar, 1"
    )
    # As a report rounds them.
    for metres in (0.0045, 0.0123, 0.1, 0.456, 0.999, 1.0, 3.9968, 42.676):
        assert length(metres) == shown(metres, "cm").replace("\u202f", " ")


def test_avoiding_says_what_it_decides_when_it_decides_something_else():
    fronts = [2.0, 2.0, 0.9, 0.8, 0.4, 0.3, 2.0]
    sweep = SimpleNamespace(sectors=None)
    sensing = SimpleNamespace(observe=lambda seen: None, sweep=sweep, blind=False)
    lines = []
    driver = AvoidDriver(
        AvoidConfig(mode="tutorial"), load_robot("burger").model, sensing, 60.0, lines.append
    )
    states = []
    for k, front in enumerate(fronts):
        sweep.sectors = Sectors(1.0, front, 0.5)
        scan = Scan(k * S, np.ones(4, dtype=np.float32), LidarSpec(4, 0.0, np.pi / 2, 0.12, 3.5))
        odometry = Odometry(k * S, SE2.identity(), Twist())
        driver.step(Observation(k * S, odometry, Joints(k * S, (0.0, 0.0), (0.0, 0.0)), scan))
        states.append(in_words(driver.state))
    assert states == ["straight"] * 2 + ["slow, veer left"] * 2 + ["stop, turn left"] * 2 + ["straight"]
    assert [line.split("  ")[-1] for line in lines] == [states[k] for k in (0, 2, 4, 6)]
