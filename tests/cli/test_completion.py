"""The completion scripts know verbs, options, names and files; bash's is asked as bash asks it."""

import shlex
import subprocess

import pytest

from turtlebag.pipeline.cli.completion import SHELLS
from turtlebag.pipeline.cli.main import VERBS, main
from turtlebag.sim.robots import robot_names
from turtlebag.sim.worlds import world_names

ASK = """\
source {script}
while read -r -a COMP_WORDS; do
  [ "${{COMP_WORDS[-1]}}" = _ ] && COMP_WORDS[-1]=
  COMP_CWORD=$(( ${{#COMP_WORDS[@]}} - 1 )) COMPREPLY=()
  _shtab_turtlebag
  echo "${{COMPREPLY[*]}}"
done
"""


@pytest.fixture
def complete(tmp_path, capsys):
    """What bash offers for the last word of each line, `_` standing for an empty one."""
    assert main(["completion", "bash"]) == 0
    (tmp_path / "script").write_text(capsys.readouterr().out)
    (tmp_path / "there/folder").mkdir(parents=True)
    (tmp_path / "there/file.yaml").touch()

    def asked(*lines):
        code = ASK.format(script=shlex.quote(str(tmp_path / "script")))
        done = subprocess.run(
            ["bash", "-c", code],
            input="".join(f"turtlebag {line}\n" for line in lines),
            cwd=tmp_path / "there",
            capture_output=True,
            text=True,
            check=True,
            timeout=20,
        )
        assert done.stderr == ""
        return [line.split() for line in done.stdout.splitlines()]

    return asked


def test_bash_completes_verbs_options_names_and_files(complete):
    found = complete(
        "_",
        "na",
        "bag re",
        "record --wo",
        "record --world turtlebot3_h",
        "record --world f",
        "studio --robot _",
    )
    assert found[0] == list(VERBS)
    assert found[1:5] == [["navigate"], ["recover"], ["--world"], ["turtlebot3_house"]]
    assert sorted(found[5]) == ["file.yaml", "folder"]
    assert sorted(found[6]) == sorted([*robot_names(), "file.yaml", "folder"])
    found = complete(
        "navigate --task _",
        "map fi",
        "report f",
        "data fetch int",
        "sweep bre",
        "completion z",
        "compare there fi",
        "report there --system fi",
    )
    assert found == [
        ["goal", "patrol", "avoid", "explore"],
        ["file.yaml"],
        ["folder"],
        ["intel"],
        ["breaks"],
        ["zsh"],
        ["file.yaml"],
        ["file.yaml"],
    ]


@pytest.mark.parametrize("shell", SHELLS)
def test_each_shell_has_the_verbs_worlds_and_robots(shell, capsys):
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    for name in (*VERBS, *world_names(), *robot_names()):
        assert name in script, name
