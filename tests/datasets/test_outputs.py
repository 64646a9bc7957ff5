"""Outputs are complete or absent."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import sha256_tree, staged_output, write_json, write_manifest


def test_a_finished_output_appears_under_its_name_only(tmp_path):
    with staged_output(tmp_path / "out") as partial:
        (partial / "a.txt").write_text("a")
        assert not (tmp_path / "out").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert (tmp_path / "out" / "a.txt").read_text() == "a"


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_an_interrupted_output_leaves_nothing(tmp_path, error):
    def interrupted():
        with staged_output(tmp_path / "out") as partial:
            (partial / "a.txt").write_text("a")
            raise error

    with pytest.raises(error):
        interrupted()
    assert list(tmp_path.iterdir()) == []


def test_an_existing_output_is_refused_and_untouched_unless_forced(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "old").write_text("old")
    write_manifest(tmp_path / "out", stage="map", command=[], inputs={}, seed=None, wall_s=0.0)
    with pytest.raises(InputError, match="already exists"), staged_output(tmp_path / "out"):
        pass
    assert (tmp_path / "out" / "old").exists()
    with staged_output(tmp_path / "out", force=True) as partial:
        (partial / "new").write_text("new")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["new"]


def test_force_never_removes_what_is_no_output_of_ours(tmp_path):
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "thesis.tex").write_text("years")
    with (
        pytest.raises(InputError, match="not an output of turtlebag"),
        staged_output(tmp_path / "home", force=True),
    ):
        pass
    assert (tmp_path / "home" / "thesis.tex").read_text() == "years"


@pytest.mark.parametrize("name", ["", ".", "/", ".."])
def test_an_output_needs_a_name(name):
    with pytest.raises(InputError, match="name"), staged_output(Path(name), force=True):
        pass


def test_a_failed_forced_output_keeps_the_old_one(tmp_path):
    (tmp_path / "out").mkdir()
    with pytest.raises(ValueError), staged_output(tmp_path / "out", force=True):
        raise ValueError
    assert (tmp_path / "out").is_dir()


def test_an_output_below_a_file_is_one_clear_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be created"), staged_output(tmp_path / "file" / "out"):
        pass


def test_json_is_strict_and_plain(tmp_path):
    write_json(tmp_path / "m.json", {"a": np.float64(1.5), "b": np.arange(2), "c": math.inf, "d": (1, None)})
    assert json.loads((tmp_path / "m.json").read_text()) == {"a": 1.5, "b": [0, 1], "c": None, "d": [1, None]}


def test_manifest_hashes_inputs_and_outputs_but_not_itself(tmp_path):
    source = tmp_path / "in.txt"
    source.write_text("in")
    out = tmp_path / "out"
    out.mkdir()
    (out / "result.txt").write_text("out")
    write_manifest(out, stage="map", command=["turtlebag", "map"], inputs={"bag": source}, seed=3, wall_s=1.0)
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["outputs"] == sha256_tree(out) == {"result.txt": manifest["outputs"]["result.txt"]}
    assert manifest["inputs"]["bag"]["sha256"] == sha256_tree(source)
    assert (manifest["seed"], manifest["command"]) == (3, ["turtlebag", "map"])
