"""Somebody else's program as a stage of a campaign."""

import json
import sys

import numpy as np
import pytest

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.trajectories import save_tum
from turtlebag.datasets.types import Trajectory
from turtlebag.pipeline.campaign.campaign_file import load_campaign
from turtlebag.pipeline.campaign.cases import cases
from turtlebag.pipeline.campaign.store import Store
from turtlebag.pipeline.campaign.sweep import sweep
from turtlebag.pipeline.campaign.table import query
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.stages.requests.program import ProgramRequest
from turtlebag.pipeline.stages.run import run

DRIFTS = """
import sys, time
truth, out, metres = sys.argv[1], sys.argv[2], float(sys.argv[3])
rows = [line.split() for line in open(truth + "/trajectory.tum") if not line.startswith("#")]
with open(out + "/poses.tum", "w") as file:
    for k, row in enumerate(rows):
        row[2] = str(float(row[2]) + metres * (k % 2))
        print(*row, file=file)
"""
CAMPAIGN = """
name: others
factors: {{metres: [0.0, 0.1]}}
stages:
  slam: {{command: [{python}, {script}, "{truth}", "{{out}}", "{{metres}}"], trajectory: poses.tum,
         odometry: poses.tum, truth: "{truth}", time_limit_s: 30}}
results: {{ate: "slam:ate_m.rmse", drift: "slam:front_end.rpe.trans_m", cpu: "slam:cpu_s",
          mb: "slam:memory_mb"}}
"""


@pytest.fixture
def truth(tmp_path):
    folder = tmp_path / "truth"
    folder.mkdir()
    stamps = np.arange(50) * 10**8
    x = np.linspace(0.0, 5.0, 50)
    save_tum(Trajectory(stamps, SE2.from_xyt(x, np.sin(x), 0.1 * x)), folder / "trajectory.tum")
    return folder


@pytest.fixture
def campaign(tmp_path, truth):
    script = tmp_path / "drifts.py"
    script.write_text(DRIFTS)
    file = tmp_path / "others.yaml"
    file.write_text(CAMPAIGN.format(python=sys.executable, script=script, truth=truth))
    return file


def test_a_program_is_measured_as_ours_is_and_so_is_what_it_takes(tmp_path, campaign):
    out = Output(tmp_path / "out")
    assert sweep(str(campaign), out, scheduler="threads", allow_commands=True) == 0
    _, rows = query(Store(str(out.folder)), "SELECT ate, drift, cpu, mb FROM runs ORDER BY metres")
    assert rows[0][0] == pytest.approx(0.0, abs=1e-6)
    assert rows[1][0] == pytest.approx(np.sqrt(0.5) * 0.1, rel=1e-3)
    assert rows[0][1] == pytest.approx(0.0, abs=1e-6)
    assert rows[1][1] > 0.01
    assert all(cpu > 0.0 and 1.0 < mb < 1000.0 for _, _, cpu, mb in rows)


LEVELS = """
name: others
factors: {{system: {{first: "run --on {{record}} -o {{out}}", second: "{second}"}}}}
stages:
  record: "record --world empty"
  slam: {{command: ["{{system}}", "--last"]}}
results: {{cpu: "slam:cpu_s"}}
"""


def test_the_text_of_a_level_is_several_words_of_a_program_and_names_earlier_stages(tmp_path):
    file = tmp_path / "others.yaml"
    file.write_text(LEVELS.format(second="walk '{record}/a b'"))
    first, second = (case.requests["slam"].command for case in cases(load_campaign(str(file))))
    assert first == ("run", "--on", "{record}", "-o", "{out}", "--last")
    assert second == ("walk", "{record}/a b", "--last")
    file.write_text(LEVELS.format(second="walk {slam}"))
    with pytest.raises(InputError, match=r"stages\.slam: \{slam\} is not an earlier stage"):
        cases(load_campaign(str(file)))


def test_a_campaign_with_a_program_is_refused_unless_that_is_allowed(tmp_path, campaign, capsys):
    assert main(["sweep", str(campaign), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.strip()
    assert len(said.splitlines()) == 1
    assert f"stages.slam runs `{sys.executable} " in said
    assert said.endswith("--allow-commands allows it")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("import sys; print('no bag'); sys.exit(3)", "exit code 3: no bag"),
        ("raise SystemExit(4)", "exit code 4: it said nothing"),
        ("pass", "the program left no poses.tum"),
        ("import time; time.sleep(60)", "ran longer than 0.5 s"),
        ("open('{out}/poses.tum', 'w').write('1 2 3')", "poses.tum"),
        ("import os; os.kill(0, 9)", "was killed"),
    ],
)
def test_a_program_that_fails_says_why_in_one_line_and_leaves_nothing(tmp_path, code, reason):
    out = tmp_path / "out"
    limit_s = 0.5 if "sleep" in code else 30.0
    asked = ProgramRequest(command=(sys.executable, "-c", code), trajectory="poses.tum", time_limit_s=limit_s)
    with pytest.raises(InputError) as failed:
        run(asked, Output(out, command=asked.command))
    assert reason in str(failed.value)
    assert len(str(failed.value).splitlines()) == 1
    assert not out.exists()


SHARED = """
name: links
factors: {{seed: [1, 2]}}
stages:
  leaves: {{command: [bash, -c, "{leave}"]}}
  looks: {{command: [ls, "{{leaves}}", "{{seed}}"]}}
shared: [leaves]
results: {{cpu: "looks:cpu_s"}}
"""


@pytest.mark.parametrize("leave", ["ln -s /etc/passwd {out}/it", "mkfifo {out}/it"])
def test_links_and_pipes_of_a_shared_program_fail_all_its_cases_with_the_reason(tmp_path, leave):
    (tmp_path / "links.yaml").write_text(SHARED.format(leave=leave))
    out = Output(tmp_path / "out")
    assert sweep(str(tmp_path / "links.yaml"), out, scheduler="threads", allow_commands=True) == 1
    _, rows = query(Store(str(out.folder)), "SELECT error FROM runs")
    assert len(rows) == 2
    assert all("leaves: cannot be shared: './it' is a" in error for (error,) in rows)


def test_a_word_of_a_program_may_be_longer_than_any_files_name(tmp_path, campaign):
    script = "# words " * 40
    campaign.write_text(campaign.read_text().replace('"{metres}"]', f'"{{metres}}", "{script}"]'))
    assert sweep(str(campaign), Output(tmp_path / "out"), scheduler="threads", allow_commands=True) == 0


def test_a_program_that_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match="/no/such/program: cannot be started"):
        run(ProgramRequest(command=("/no/such/program",)), Output(tmp_path / "out", command=["none"]))


def test_what_a_program_said_is_kept_and_its_command_recorded(tmp_path):
    out = tmp_path / "out"
    code = "open(__import__('sys').argv[1] + '/note.txt', 'w').write('x'); print('hello')"
    command = (sys.executable, "-c", code, "{out}")
    assert run(ProgramRequest(command=command), Output(out, command=["mine"])) == 0
    assert (out / "program.log").read_text() == "hello\n"
    assert (out / "note.txt").is_file()
    manifest = json.loads((out / "manifest.json").read_text())
    assert manifest["request"]["command"] == list(command)


@pytest.mark.parametrize("name", ["../poses.tum", "/etc/passwd", "a/../../b"])
def test_what_a_program_leaves_lies_in_its_folder(name):
    with pytest.raises(ValueError, match="trajectory"):
        ProgramRequest(command=("true",), trajectory=name)


def test_a_mistake_in_a_program_is_named_by_its_key(tmp_path, campaign):
    campaign.write_text(campaign.read_text().replace("trajectory: poses.tum", "trajectory: ../poses.tum"))
    with pytest.raises(InputError, match=r"stages\.slam\.program\.trajectory: "):
        load_campaign(str(campaign))


def test_what_a_program_is_measured_by_is_an_input_of_its_campaign(tmp_path, campaign, truth):
    out = tmp_path / "out"
    assert sweep(str(campaign), Output(out), scheduler="threads", allow_commands=True) == 0
    inputs = json.loads((out / "manifest.json").read_text())["inputs"]
    assert str(truth) in inputs
