import numpy as np
import pytest

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.stages.requests.drives import ON_A_MAP, TAKEN_BY, TASKS, NavigateRequest
from turtlebag.planners.tasks.patrol import GoalSequence, SequenceConfig
from turtlebag.planners.tasks.waypoints import Waypoint, load_waypoints, tutorial_patrol

S = 10**9


def waypoints(count):
    return [Waypoint(SE2.from_xyt(float(k), 0.0, 0.0)) for k in range(count)]


def test_the_tutorial_patrol_is_the_eight_waypoints_in_order():
    found = tutorial_patrol()
    expected = [(1.5, 1.5), (0, 2), (-1.5, 1.5), (-2, 0), (-1.5, -1.5), (0, -2), (1.5, -1.5), (2, 0)]
    assert [w.T_map_goal.xyt.tolist() for w in found.waypoints] == [[x, y, 0.0] for x, y in expected]
    np.testing.assert_array_equal(np.abs(found.keepout[0]), np.full((4, 2), 1.1))


GIVEN = {
    "map": "--map=m.yaml",
    "initial_pose": "--initial-pose=start",
    "wiggle": "--wiggle",
    "keepout": "--keepout=none",
    "timeout": "--timeout=5",
    "goal": "--goal=1,0,0",
    "waypoints": "--waypoints=w.yaml",
    "laps": "--laps=2",
    "duration": "--duration=3",
    "mode": "--mode=tutorial",
}
WITH_EVERY_TASK = {
    "world",
    "robot",
    "task",
    "seed",
    "start",
    "teleop_override",
    "config",
    "settings",
}


def refusal(capsys, *words):
    """The line that a command line to an unknown world is refused with."""
    assert main(["navigate", "--world", "moon", "--out", "nowhere", *words]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    return error


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("name", GIVEN)
def test_an_option_that_the_task_does_not_use_is_refused_by_name(capsys, task, name):
    needed = ["--map=m.yaml"] if task in TAKEN_BY["map"] else []
    error = refusal(capsys, "--task", task, *needed, GIVEN[name])
    if task in TAKEN_BY[name]:
        assert "unknown world 'moon'" in error
    else:
        assert f"{GIVEN[name].split('=')[0]}: not for --task {task}" in error


@pytest.mark.parametrize("name", ON_A_MAP)
def test_a_goal_without_a_map_refuses_what_only_a_map_gives_sense(capsys, name):
    option = GIVEN[name].split("=")[0]
    assert f"{option}: needs a map" in refusal(capsys, "--task", "goal", "--goal=1,0,0", GIVEN[name])


def test_every_option_is_said_to_go_with_every_task_or_with_some():
    options = set(NavigateRequest.model_fields)
    assert options == WITH_EVERY_TASK | set(TAKEN_BY) == WITH_EVERY_TASK | set(GIVEN)


def test_waits_before_the_first_and_pauses_after_each_reached():
    sequence = GoalSequence(waypoints(2), SequenceConfig())
    assert sequence.update(0) is None
    assert sequence.update(3 * S - 1) is None
    assert float(sequence.update(3 * S).x) == 0.0
    sequence.close("reached", "", 10 * S)
    assert sequence.update(11 * S - 1) is None
    assert float(sequence.update(11 * S).x) == 1.0
    sequence.close("reached", "", 20 * S)
    assert sequence.finished
    assert [o.time_s for o in sequence.outcomes] == [7.0, 9.0]


def test_a_goal_not_reached_in_time_is_logged_and_not_retried():
    sequence = GoalSequence(waypoints(2), SequenceConfig(initial_wait=0.0))
    sequence.update(0)
    assert float(sequence.update(60 * S - 1).x) == 0.0
    # No pause after a missed one: the next starts in the same tick.
    assert float(sequence.update(60 * S).x) == 1.0
    sequence.close("reached", "", 70 * S)
    assert [o.status for o in sequence.outcomes] == ["timeout", "reached"]
    assert sequence.update(80 * S) is None
    assert sequence.finished


def test_bad_entries_are_rejected_and_the_patrol_goes_on():
    entries = [Waypoint(None, "yaw is not a finite number"), *waypoints(1), Waypoint(None, "no")]
    sequence = GoalSequence(entries, SequenceConfig(initial_wait=0.0, pause=0.0))
    assert sequence.update(0) is not None
    sequence.close("reached", "", S)
    sequence.update(S)
    assert [o.status for o in sequence.outcomes] == ["rejected", "reached", "rejected"]
    assert sequence.finished


def test_a_run_that_ends_closes_the_goals_still_open_as_timeouts():
    entries = [*waypoints(2), Waypoint(None, "yaw is not a finite number")]
    sequence = GoalSequence(entries, SequenceConfig(initial_wait=0.0))
    sequence.update(0)
    sequence.close_all("timeout", "the run ended", 5 * S)
    assert [o.status for o in sequence.outcomes] == ["timeout", "timeout", "rejected"]
    assert sequence.finished


def test_laps_closed_laps_and_retries():
    def visited(config, miss=()):
        sequence = GoalSequence(waypoints(3), config)
        found, now = [], 0
        while not sequence.finished:
            goal = sequence.update(now)
            now += S
            if goal is not None:
                found.append(int(goal.x))
                sequence.close("unreachable" if len(found) in miss else "reached", "", now)
        return found

    quick = {"initial_wait": 0.0, "pause": 0.0}
    assert visited(SequenceConfig(laps=2, **quick)) == [0, 1, 2, 0, 1, 2]
    assert visited(SequenceConfig(laps=2, closed=True, **quick)) == [0, 1, 2, 0, 1, 2, 0]
    assert visited(SequenceConfig(retry_missed=True, **quick), miss=(2,)) == [0, 1, 2, 1]
    assert visited(SequenceConfig(retry_missed=True, **quick), miss=(2, 4)) == [0, 1, 2, 1]


@pytest.mark.parametrize(
    "text",
    ["", "7", "waypoints: []", "waypoints: [[1, 2, 0]]\nkeepuot: []", "a: [", "keepout: [[[0, 0], [1, 1]]]"],
)
def test_bad_files_are_input_errors(tmp_path, text):
    path = tmp_path / "w.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"w\.yaml"):
        load_waypoints(path)
