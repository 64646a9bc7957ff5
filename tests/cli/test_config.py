"""Configuration is typed: a typo is an error that names the key."""

from typing import ClassVar

import pytest
from pydantic import BaseModel, ConfigDict, Field

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.yaml_files import config_text, read_mapping
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.navigation.config import NavigateConfig
from turtlebag.pipeline.slam.mapper import SlamConfig
from turtlebag.pipeline.stages.settings import load_config


class Inner(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)
    voxel: float = Field(0.2, gt=0)


class Outer(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)
    inner: Inner = Inner()
    name: str = "a"


BEYOND = (
    *("sequence.initial_wait", "sequence.timeout", "sequence.pause", "relocalise.look", "relocalise.roam"),
    *("relocalise.disambiguate", "recovery.stuck_time", "goal_checker.hold", "amcl.likelihood_max_dist"),
    "sim.faults.command_delay",
)
"""Times and lengths that no run could have."""
WRONG = {
    Outer: {
        "inner.voxle=1": "inner.voxle: unknown key",
        "inner.voxel=-1": "inner.voxel: ",
        "inner.voxel": "expected key=value",
        "name.x.y=1": "name",
        "inner.voxel=[": "not valid YAML",
    },
    NavigateConfig: {
        **{f"{key}=1e300": f"--set: {key}: " for key in BEYOND},
        "recovery.ladder=[{kind: wait, amount: 1e300}]": "--set: recovery.ladder.0.amount: ",
        "recovery.back_up_v=1e-300": "--set: recovery.back_up_v: ",
        "amcl.likelihood_max_dist=.inf": "--set: amcl.likelihood_max_dist: ",
        "amcl.laser_min_range=.nan": "--set: amcl.laser_min_range: ",
        "sim.faults.kidnap=3": "sim.faults.kidnap: expected a list ([seconds, x, y, yaw] for each)",
        "sim.faults.kidnap=[3, 1, 1, 0]": "kidnap.0: expected a list ([seconds, x, y, yaw] for each)",
        "sim.faults.kidnap=[[3, 1, 1]]": "kidnap.0.3: is missing ([seconds, x, y, yaw] for each)",
        "sim.faults.imu_silent=4": "--set: sim.faults.imu_silent: expected a list ([start, end] for each)",
        "sim.faults.slip=4": "slip: expected a list ([start, end, left share, right share] for each)",
        "sim.lidar.sigma=-1": "--set: sim.lidar.sigma: must be greater than or equal to 0",
        "sim.lidar.sigma=wide": "--set: sim.lidar.sigma: must be a valid number",
        "sim.lidar.noise=wide": "sim.lidar.noise: must be 'sensor', 'gazebo', 'datasheet' or 'none'",
        "teleop_override.monitor=3": "--set: teleop_override.monitor: must be a valid boolean",
        "relocalise.restarts=1.5": "relocalise.restarts: must be a valid integer, got a number with a",
        "teleop_override.script=[{begin: 2, end: 1}]": (
            "--set: teleop_override.script.0: an interval must end after it begins: 2 to 1"
        ),
        "relocalise=3": "--set: relocalise: expected keys and values",
    },
}


@pytest.mark.parametrize(
    ("model", "setting"), [(model, setting) for model in WRONG for setting in WRONG[model]]
)
def test_a_wrong_setting_is_one_line_that_names_its_key(model, setting):
    with pytest.raises(InputError) as caught:
        load_config(model, settings=[setting])
    assert WRONG[model][setting] in str(caught.value)
    assert "\n" not in str(caught.value)


def test_settings_override_the_file_and_the_file_the_defaults(tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text("inner: {voxel: 0.3}\nname: b\n")
    assert load_config(Outer) == Outer()
    assert load_config(Outer, path).inner.voxel == 0.3
    assert load_config(Outer, path, ["inner.voxel=0.4"]) == Outer(inner=Inner(voxel=0.4), name="b")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: [", "line 1: not valid YAML"),
        ("- 1", "found a list"),
        ("# 1", "the file is empty"),
        ("x: 1", "x: unknown key"),
    ],
)
def test_a_wrong_file_names_itself(tmp_path, text, message):
    path = tmp_path / "c.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        load_config(Outer, path)
    assert str(path) in str(caught.value)
    with pytest.raises(InputError, match=r": is a folder; give a file$"):
        load_config(Outer, tmp_path)


@pytest.mark.parametrize(
    ("model", "old", "new"),
    [
        (NavigateConfig, "takeover.monitor=false", "takeover: is now called teleop_override"),
        (NavigateConfig, "relocalise.tell_apart=9", "relocalise.tell_apart: is now called disambiguate"),
        (SlamConfig, "loops.inflation=9", "loops.inflation: is now called covariance_scale"),
        (SlamConfig, "recall.enabled=false", "recall: is now called place_recognition"),
    ],
)
def test_a_former_key_names_the_present_one(model, old, new):
    with pytest.raises(InputError) as caught:
        load_config(model, settings=[old])
    assert str(caught.value) == f"--set: {new}"


class Former(Settings):
    REMOVED: ClassVar = {"braille": "the studio shows the map"}
    steps: int = 3


class Former2(Settings):
    REMOVED: ClassVar = {"old": "every scan is placed as well without it"}
    former: Former = Former()


def test_a_removed_key_is_left_out_with_a_note_whatever_it_holds(tmp_path, caplog):
    path = tmp_path / "c.yaml"
    path.write_text("former: {braille: {wide: .nan}, steps: 5}\nold: [1, 2]\n")
    config = load_config(Former2, path)
    assert config == Former2(former=Former(steps=5))
    assert caplog.messages == [
        f"note: {path}: former.braille: left out: the studio shows the map",
        f"note: {path}: old: left out: every scan is placed as well without it",
    ]
    assert load_config(Former2, settings=["former.braille=true"]) == Former2()
    with pytest.raises(InputError, match=r"--set: former.brail: unknown key \(known: steps\)"):
        load_config(Former2, settings=["former.braille=true", "former.brail=true"])


def test_resolved_configuration_reads_back(tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text(config_text(Outer(name="z")))
    assert load_config(Outer, path) == Outer(name="z")
    assert read_mapping(path)["name"] == "z"


def test_a_wrong_option_in_a_sweep_is_told_before_any_case_runs(tmp_path, capsys):
    text = "name: a\nquestion: b\nfactors: {seed: [1]}\nresults: {s: 'r:scans'}\n"
    text += "stages: {r: '%s --seed {seed}'}\n"
    for command, said in (
        ("record --world empty --telop tour", "did you mean --teleop"),
        ("recrod", "choice: 'recrod'"),
    ):
        (tmp_path / "mine.yaml").write_text(text % command)
        assert main(["sweep", str(tmp_path / "mine.yaml"), "--out", str(tmp_path / "out")]) == 2
        told = capsys.readouterr().err
        assert "mine.yaml: stages.r: " in told
        assert said in told
        assert told.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["mine.yaml"]
