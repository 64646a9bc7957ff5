"""Whatever is asked for, in whatever order, only InputError is raised, and it is driven again alike."""

import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.studio.walk import at_the_studio, differences, silent
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.stages.studio import replay
from turtlebag.pipeline.studio.inputs import KNOWN, parse_input

NAMES = st.sampled_from(["a", "b", "true", "12", "a-keepout", "", "../c"])
METRES = st.one_of(st.floats(-2.5, 2.5), st.sampled_from([0.0, 40.0, float("nan"), "x"]))
POSES = st.one_of(
    st.tuples(METRES, METRES, st.floats(-4.0, 4.0)).map(list),
    st.sampled_from([[-1.5, -0.5, 0.0], [-2.0, -0.5, 0.1], [0.5, -0.5, 1.0]]),
)
FIELDS = {
    "v": st.floats(-0.3, 0.3),
    "w": st.floats(-2.0, 2.0),
    "name": NAMES,
    "pose": POSES,
    "waypoints": st.lists(st.fixed_dictionaries({"pose": POSES, "wait": st.floats(0.0, 1.0)}), max_size=2),
    "laps": st.integers(1, 3),
    "xy": st.tuples(METRES, METRES).map(list),
    "size": st.floats(0.05, 0.6),
    "outlines": st.lists(st.lists(st.tuples(METRES, METRES).map(list), min_size=3, max_size=4), max_size=2),
}
OF = {
    "drive": ("v", "w"),
    "record": ("name",),
    "map_save": ("name",),
    "map_load": ("name",),
    "pose_estimate": ("pose",),
    "goal": ("pose",),
    "patrol": ("waypoints", "laps"),
    "waypoints": ("waypoints",),
    "waypoints_save": ("name", "waypoints"),
    "waypoints_load": ("name",),
    "kidnap": ("pose",),
    "box": ("xy", "size"),
    "keepout": ("outlines",),
}
USUAL = [do for do in KNOWN if do != "end"]
ASKED = st.sampled_from([*USUAL, "goal", "map_load", "pose_estimate", "drive", "record"]).flatmap(
    lambda do: st.fixed_dictionaries({"do": st.just(do), **{key: FIELDS[key] for key in OF.get(do, ())}})
)


def answer(person, data):
    """The line that an input is answered with."""
    try:
        return person.session.apply(parse_input(data))
    except InputError as error:
        return str(error)


@pytest.mark.slow
@settings(max_examples=5)
@given(steps=st.lists(st.tuples(ASKED, st.integers(0, 40)), min_size=3, max_size=14))
def test_it_is_driven_again_to_the_same_bytes_whatever_was_asked(true_map, steps):
    with tempfile.TemporaryDirectory() as folder:
        live, again = Path(folder) / "live", Path(folder) / "again"
        with at_the_studio(live, map_path=true_map) as person:
            for data, ticks in steps:
                assert "\n" not in answer(person, data)
                person.wait(ticks / 30)
                assert person.view.stamp_ns == person.session.stamp_ns
        assert replay(live / "session.yaml", Output(again), say=silent) == 0
        assert differences(live, again) == []
