"""Broken inputs to every command: exit 0, 1 or 2, one line of complaint, and nothing left behind."""

import json
import os
import random
import re
import shutil
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.helpers.fuzz_cases import CASES, ROOM, SDF
from tests.helpers.fuzz_inputs import Unbroken, attempt, complaint, outcome, with_output
from tests.helpers.report_fakes import unrendered
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.kernels import njit
from turtlebag.datasets.relations import load_relations
from turtlebag.datasets.trajectories import load_tum
from turtlebag.datasets.yaml_files import parsed
from turtlebag.reports.g2o import read_loops
from turtlebag.sim.worlds import load_world

TRIES = 4
"""Variants of a case. `make bench-bags` tries many more."""


@pytest.fixture(autouse=True)
def figures_are_composed():
    """And not drawn, which takes nine tenths of a report's time."""
    with unrendered():
        yield


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_broken_inputs_end_with_exit_0_1_or_2(chain, case):
    tries = int(os.environ.get("TURTLEBAG_TRIES", TRIES))
    found = [attempt(case, CASES[case], chain, seed) for seed in range(tries)]
    assert not any(found), "\n".join(filter(None, found))


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    [
        "world",
        "robot",
        "teleop",
        "waypoints",
        "bag to map",
        "log",
        "relations",
        "truth",
        "sweep",
        "teleop override",
        "keepout",
        "session to drive again",
    ],
)
def test_what_is_not_broken_is_accepted(chain, tmp_path, case):
    """Else the variants above might all be refused for something that nobody broke."""
    (tmp_path / "in").mkdir()
    words = with_output(CASES[case](Unbroken(1), chain, tmp_path / "in"), tmp_path)
    code, said = outcome(words)
    assert code in (0, 1), said


@pytest.mark.slow
@pytest.mark.parametrize("what", [lambda: None, lambda: time.sleep(0.1)], ids=["computes", "waits"])
def test_a_command_that_does_not_end_in_time_is_no_success(tmp_path, what):
    def endless(words):
        while True:
            what()

    found = complaint(["map", "x"], tmp_path, seconds=0.05, command=endless, waiting=5)
    assert "more than 0.05 s" in found


@pytest.mark.slow
def test_compiling_is_not_counted_and_what_follows_is(tmp_path):
    @njit(cache=False)
    def kernel(values):
        return (values * 2.0).sum()

    def compiles(words):
        assert kernel(np.ones(3)) == 6.0
        while words[0] == "endless":
            pass
        return 0

    how = {"seconds": 0.05, "command": compiles, "waiting": 1200}
    begin = time.process_time()
    assert complaint(["short"], tmp_path, **how) == ""
    assert time.process_time() - begin > 0.05
    assert "more than 0.05 s" in complaint(["endless"], tmp_path, **how)


def refusal(read, given):
    """What reading says when it refuses; empty when it does not."""
    try:
        read(given)
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.slow
@settings(max_examples=60)
@given(data=st.text(max_size=60), name=st.sampled_from(["tum", "relations"]))
def test_text_files_are_read_or_refused_in_one_line(tmp_path_factory, data, name):
    path = tmp_path_factory.getbasetemp() / f"any.{name}"
    path.write_text(data, encoding="utf-8", errors="surrogatepass", newline="")
    assert "\n" not in refusal(load_tum if name == "tum" else load_relations, path)


@settings(max_examples=60)
@given(
    words=st.lists(
        st.sampled_from(["nan", "inf", "1e400", "1e300", "-1", "0", "1e18", "9" * 30, "1.5"]),
        min_size=8,
        max_size=8,
    )
)
def test_trajectories_of_wild_numbers_are_finite_or_refused(tmp_path_factory, words):
    path = tmp_path_factory.getbasetemp() / "wild.tum"
    path.write_text(" ".join(words) + "\n")
    try:
        found = load_tum(path)
    except InputError:
        return
    assert abs(int(found.stamps_ns[0])) < 2**62
    assert abs(found.poses.xyt).max() < 1e100


@settings(max_examples=100)
@given(st.text(alphabet="[]{}:,-&*!|>'\"#%@?\n\t 0aex._~<=", max_size=40))
def test_any_text_is_yaml_or_refused_in_one_line(text):
    assert "\n" not in refusal(lambda text: parsed(text, where="--set x"), text)


@pytest.mark.slow
def test_a_variant_is_the_same_whenever_it_is_made(chain, tmp_path):
    for case in ("world", "bag to map", "truth"):
        made = []
        for name in ("a", "b"):
            scratch = tmp_path / case.replace(" ", "_") / name
            scratch.mkdir(parents=True)
            CASES[case](random.Random(f"{case} 4"), chain, scratch)
            made.append({p.relative_to(scratch): p.read_bytes() for p in scratch.rglob("*") if p.is_file()})
        assert made[0] == made[1]


@pytest.mark.parametrize(
    "bounds", ["[-1.0e+300, 1, -1, 1]", "[1, -1, -1, 1]", "[0, 1000000, 0, 1]", "[0, 0, 0, 1]"]
)
def test_a_world_that_no_map_can_hold_is_refused_before_the_drive(tmp_path, bounds):
    path = tmp_path / "room.yaml"
    path.write_text(ROOM.replace("[-1.6, 1.6, -1.6, 1.6]", bounds))
    with pytest.raises(InputError, match=r"bounds|too large"):
        load_world(str(path))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "key", "value"),
    [
        ("manifest.json", "inputs", {"run/navigate": ["x"]}),
        ("manifest.json", "folders", {"run/navigate": [1]}),
        ("manifest.json", "outputs", ["index.html"]),
    ],
)
def test_verify_refuses_a_report_whose_manifest_is_of_another_make(chain, tmp_path, file, key, value):
    shutil.copytree(chain / "report", tmp_path / "report")
    path = tmp_path / "report" / file
    path.write_text(json.dumps({**json.loads(path.read_text()), key: value}))
    code, said = outcome(["verify", tmp_path / "report"])
    assert (code, said.count("\n")) == (2, 1)
    assert key in said


@pytest.mark.slow
def test_report_refuses_goals_that_are_none(chain, tmp_path):
    shutil.copytree(chain / "run", tmp_path / "run")
    path = tmp_path / "run" / "metrics.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "goals": [True]}))
    code, said = outcome(["report", tmp_path / "run", "--out", tmp_path / "out"])
    assert (code, said.count("\n")) == (2, 1)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize("number", ["1" + "0" * 400, "1" + "0" * 9000, "1e400", "[" * 5000])
def test_numbers_beyond_floats_are_no_trouble_to_compare_and_verify(chain, tmp_path, number):
    for stage in ("run", "report"):
        shutil.copytree(chain / stage, tmp_path / stage)
    for path in (tmp_path / "run" / "metrics.json", tmp_path / "report" / "metrics.json"):
        text, found = re.subn(r'"distance_m": [0-9.]+', f'"distance_m": {number}', path.read_text())
        assert found >= 1
        path.write_text(text)
    for words in (["compare", chain / "run", tmp_path / "run"], ["verify", "--quick", tmp_path / "report"]):
        code, said = outcome(words)
        assert code in (0, 1, 2)
        assert "Traceback" not in said


@pytest.mark.parametrize("number", ["1" + "0" * 400, "1" + "0" * 9000, "[" * 100000])
def test_loops_of_numbers_beyond_floats_are_refused(tmp_path, number):
    path = tmp_path / "graph.json"
    loop = f'{{"i": 1, "j": 0, "residual_m": {number}, "verdict": "accepted"}}'
    path.write_text(f'{{"loops": [{loop}]}}')
    with pytest.raises(InputError, match="not a record of loops"):
        read_loops(path)


def test_a_saved_state_with_half_a_pose_is_refused_by_name(tmp_path):
    (tmp_path / "w.world").write_text(SDF.replace("<pose>1 1 0.25 0 0 0</pose>", "<pose>1 1 0.25 0 0</pose>"))
    with pytest.raises(InputError, match=r"model a: pose '1 1 0.25 0 0' is not six finite numbers"):
        load_world(str(tmp_path / "w.world"))
