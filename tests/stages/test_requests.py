"""Requests: every option is said once, and means the same to the command line, Python and a manifest."""

import json

import pytest

from turtlebag.datasets.errors import InputError
from turtlebag.pipeline.stages.command_line import option_of, read, words_of
from turtlebag.pipeline.stages.requests.drives import TAKEN_BY, NavigateRequest, RecordRequest
from turtlebag.pipeline.stages.requests.maps import MapRequest
from turtlebag.pipeline.stages.requests.pages import ReportRequest
from turtlebag.pipeline.stages.requests.table import REQUESTS

NEEDED = {
    "record": ["--world", "empty"],
    "teleop": ["--world", "empty"],
    "map": ["rec"],
    "localise": ["rec", "--map", "m.yaml"],
    "identify": ["rec"],
    "plan": ["--map", "m.yaml", "--start=-2,0,0", "--goal", "1,1,0"],
    "twin": ["rec"],
    "grade": ["hw2.py", "--lesson", "2"],
    "report": ["rec", "map"],
    "compare": ["a", "b"],
    "bag convert": ["rec"],
    "bag recover": ["rec"],
}
FIELDS = [(verb, name) for verb, kind in REQUESTS.items() for name in kind.model_fields]


def needed(verb, name):
    """The command line that an option can be added to."""
    if verb != "navigate":
        return [*verb.split(), *NEEDED.get(verb, [])]
    task = TAKEN_BY.get(name, ("goal",))[0]
    extra = {"goal": ["--goal", "1,0,0", "--map", "m.yaml"], "patrol": ["--map", "m.yaml"]}.get(task, [])
    return [verb, "--world", "empty", "--task", task, *extra]


@pytest.mark.parametrize(("verb", "name"), FIELDS)
def test_each_field_says_what_it_is_and_its_example_is_read_and_written(verb, name):
    field = REQUESTS[verb].model_fields[name]
    option = option_of(field)
    assert option.text
    assert option.value or option.choices or field.annotation is bool
    flag = option.name or f"--{name.replace('_', '-')}"
    typed = [] if option.positional else [flag] if field.annotation is bool else [f"{flag}={option.example}"]
    asked = read([*needed(verb, name), *typed])
    if field.annotation is bool:
        assert getattr(asked, name) is not field.default
    else:
        assert option.example
    assert read(words_of(asked)) == asked
    recorded = json.loads(json.dumps(asked.model_dump(mode="json")))
    assert type(asked).model_validate(recorded) == asked


def test_the_same_is_asked_for_by_words_and_by_values(tmp_path):
    words = "map rec --also b --also c --laser -0.1,0,0.3,upside-down --set a.b=[1,x] --set a.c=2 --explain"
    asked = MapRequest.checked(
        source=tmp_path.relative_to(tmp_path) / "rec",
        also=["b", "c"],
        laser=(-0.1, 0, 0.3, True),
        settings={"a.b": [1, "x"], "a.c": 2},
        explain=True,
    )
    assert read(words.split()) == asked
    assert read(words_of(asked)) == asked


def test_what_a_settings_file_says_is_recorded_and_stands_in_the_command(tmp_path):
    (tmp_path / "mine.yaml").write_text("loops: {enabled: false}\nrefine: {rounds: 0, reach_m: .inf}\n")
    asked = MapRequest(source="rec", config=tmp_path / "mine.yaml", settings={"refine.rounds": 2})
    recorded = {**asked.recorded()}
    assert recorded.pop("verb") == "map"
    again = MapRequest.checked(**json.loads(json.dumps(recorded)))
    assert again.config == {"loops": {"enabled": False}, "refine": {"rounds": 0, "reach_m": "inf"}}
    words = words_of(again)
    assert list(read(words).settings) == ["loops", "refine", "refine.rounds"]
    assert read(words).settings["refine.rounds"] == 2


def test_of_two_settings_of_one_name_the_later_counts_and_comes_later():
    asked = read(["record", "--world", "empty", "--set", "a=1", "--set", "b=2", "--set", "a=3"])
    assert list(asked.settings.items()) == [("b", 2), ("a", 3)]


def test_a_class_is_taken_by_its_name():
    asked = RecordRequest.checked(world=MapRequest, settings={"front_end": MapRequest})
    assert asked.world == asked.settings["front_end"] == f"{MapRequest.__module__}:MapRequest"


def test_paths_are_moved_wherever_a_request_holds_them():
    asked = ReportRequest.checked(
        folders=["a/x", "b"], system=[("other", "a/o.tum")], system_times=[("", "a/t")]
    )
    moved = asked.moved(lambda path: type(path)(str(path).replace("a/", "new/")))
    assert [str(path) for path in moved.folders] == ["new/x", "b"]
    assert [(name, str(path)) for name, path in moved.system] == [("other", "new/o.tum")]
    assert str(moved.system_times[0][1]) == "new/t"


WRONG = {
    "record --world empty --start 1,2": "--start 1,2: expected three numbers X,Y,YAW, got 2",
    "record --world empty --start a,b,c": "--start a,b,c: expected X,Y,YAW (metres and radians)",
    "record --world empty --start nan,0,0": "--start nan,0,0: x is not a finite number",
    "record --world empty --start 0,1e10,0": "--start 0,1e10,0: y is larger than any map",
    "record --world empty --set a": "--set a: expected key=value",
    "compare a x=y --system-shift soon": "--system-shift soon: expected a number of seconds",
    "report rec --index --no-animation": "--no-animation: has no effect with --index; remove it",
    "recrod --world empty": "invalid choice: 'recrod' (choose from record, ",
}


@pytest.mark.parametrize("words", WRONG)
def test_what_is_wrong_is_named_by_its_option_in_a_line(words):
    with pytest.raises(InputError) as error:
        read(words.split())
    assert str(error.value).startswith(WRONG[words])
    assert "\n" not in str(error.value)


def test_a_task_of_ones_own_takes_every_option():
    asked = NavigateRequest.checked(world="empty", task="my.tasks:Push", map="m.yaml", laps=3, duration=4.0)
    assert read(words_of(asked)) == asked
