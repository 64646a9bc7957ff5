"""Numbers in files and options that would take hours or gigabytes are refused at the door, by their type."""

from itertools import repeat

import pytest

from tests.helpers.bag_samples import write_drive
from turtlebag.datasets.bags.reader import bag_info
from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.stages.record import Scene, record_drive

WORLD = ["--world", "turtlebot3_world"]


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("amcl.max_particles=100000000", "less than or equal to 100000"),
        ("amcl.min_particles=100001", "less than or equal to 100000"),
        ("amcl.max_beams=1000000", "less than or equal to 10000"),
        ("sequence.timeout=1e6", "less than or equal to 86400"),
        ("sequence.laps=100000", "less than or equal to 1000"),
        ("plan.ompl.iterations=1000000000", "less than or equal to 1000000"),
        ("recovery.total=1000000000", "less than or equal to 10000"),
        ("sim.faults.scan_delay=1e9", "less than or equal to 600"),
    ],
)
def test_a_setting_beyond_all_use_is_refused(tmp_path, capsys, setting, says):
    words = [*WORLD, "--task", "avoid", "--set", setting, "--out", str(tmp_path / "out")]
    assert main(["navigate", *words]) == 2
    said = capsys.readouterr().err
    assert says in said
    assert setting.partition("=")[0] in said


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("refine.rounds=1000000", "less than or equal to 100"),
        ("loops.reach_m=1e6", "less than or equal to 50"),
        ("grid.margin_m=1e9", "less than or equal to 100"),
        ("grid.resolution_m=1e-9", "greater than or equal to 0.001"),
        ("tracking.key_distance_m=1e-9", "greater than or equal to 0.001"),
    ],
)
def test_so_is_one_of_the_mapper(tmp_path, capsys, setting, says):
    write_drive(tmp_path / "bag", seconds=1.0)
    words = ["map", str(tmp_path / "bag"), "--set", setting, "--out", str(tmp_path / "out")]
    assert main(words) == 2
    assert says in capsys.readouterr().err


@pytest.mark.parametrize(
    "step",
    [
        "{wait: 1.0e+6}", "{drive: 1.0e+300}", "{turn_deg: .inf}", "{spin: 1.0e+9}", "{wall_follow: 1.0e+6}",
        "{random_walk: 1.0e+9}", "{repeat: 1000000000, steps: [{wait: 1}]}",
    ],
)  # fmt: skip
def test_a_step_of_a_teleop_script_ends(tmp_path, capsys, step):
    (tmp_path / "a.yaml").write_text(f"name: a\nsteps:\n- {step}\n")
    words = ["record", *WORLD, "--teleop", str(tmp_path / "a.yaml"), "--out", str(tmp_path / "out")]
    assert main(words) == 2
    assert "a.yaml: steps.0." in capsys.readouterr().err


@pytest.mark.parametrize("entry", ["{at: 1.0e+6, do: end}", "{begin: 0, end: 1.0e+6}", "{at: 86401}"])
def test_a_session_lasts_a_day_at_most(tmp_path, capsys, entry):
    path = tmp_path / "session.yaml"
    path.write_text(f"version: 1\nworld: empty\nrobot: burger\nseed: 1\ninputs:\n- {entry}\n")
    assert main(["studio", "--replay", str(path), "--out", str(tmp_path / "out")]) == 2
    assert "86400" in capsys.readouterr().err


def test_a_drive_of_recorded_commands_lasts_a_day_at_most(tmp_path, capsys):
    with BagWriter(tmp_path / "bag", custom={}) as bag:
        for stamp_s in (0, 10**6):
            bag.command(stamp_s * 10**9, Twist(0.1, 0.0))
    words = ["record", *WORLD, "--teleop", str(tmp_path / "bag"), "--out", str(tmp_path / "out")]
    assert main(words) == 2
    assert "spans 1e+06 s; at most 86400 s are simulated" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "value"), [("--timeout", "1e5"), ("--duration", "1e5"), ("--laps", "1001")]
)
def test_so_does_a_run(tmp_path, capsys, true_map, option, value):
    task = "avoid" if option == "--duration" else "patrol"
    on = [] if task == "avoid" else ["--map", str(true_map)]
    words = ["navigate", *WORLD, "--task", task, *on, option, value, "--out", str(tmp_path / "out")]
    assert main(words) == 2
    assert f"{option} " in (said := capsys.readouterr().err)
    assert "at most" in said


@pytest.mark.parametrize(
    ("factors", "says"),
    [
        ("{a: {first: 1, last: 1000000000}}", "of 100000 values at most"),
        ("{a: {first: 1, last: 1000}, b: {first: 1, last: 1000}}", "make 1000000 cases; at most 100000"),
    ],
)
def test_a_campaign_has_a_countable_number_of_cases(tmp_path, capsys, factors, says):
    seed = "{b}" if "b:" in factors else "1"
    (tmp_path / "c.yaml").write_text(
        f"name: c\nfactors: {factors}\nresults: {{t: 'r:time_s'}}\n"
        f"stages: {{r: 'record --world maze:{{a}} --teleop tour --seed {seed}'}}\n"
    )
    assert main(["sweep", str(tmp_path / "c.yaml"), "--out", str(tmp_path / "out")]) == 2
    assert says in capsys.readouterr().err


def test_a_drive_that_goes_on_after_that_is_ended_and_kept(tmp_path, caplog):
    driver, out = repeat(Twist()), Output(tmp_path / "out")
    assert (
        record_drive(Scene.load("empty"), (command for command in driver), "still", out, longest_s=2.0) == 1
    )
    assert "the drive ended early: no more than 2 s are simulated" in caplog.messages
    assert bag_info(tmp_path / "out").duration() == pytest.approx(2.0, abs=0.05)
